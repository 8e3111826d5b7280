"""An Updated Lagrangian body in free flight against what mechanics says of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from solids import ball, preset_material, settings

from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian

SPIN = np.array([0.3, 2.0, -0.5])  # [rad/s]
SQUEEZE = np.diag([0.4, -0.7, 0.3])  # [1/s]
SHEAR = np.array([[0.5, 0.9, -0.2], [-0.4, -0.3, 0.6], [0.1, -0.8, 0.2]])  # [1/s]


def spun(X):
    """Spin about the origin and a squeeze: rotation and vibration together."""
    return np.cross(SPIN, X) + X @ SQUEEZE


@pytest.mark.slow
@pytest.mark.parametrize(("real", "tolerance"), [(np.float32, 1e-6), (np.float64, 1e-13)])
def test_free_fall_is_exact_at_every_frame(real, tolerance):
    # Position Verlet is exact under a constant force: f32 rounds x by 6e-8 in each of 70 substeps.
    body, _ = ball(300)
    g = np.array([1.0, -9.81, 0.0])
    s = settings(frames=12, gravity=tuple(g))
    made = preset_material("rubber", body, damping_time=0.0)
    for frame in UpdatedLagrangian(body, [made], s, real=real).frames():
        fallen = 0.5 * g * frame.time**2
        assert frame.time == pytest.approx(frame.index / 24.0, rel=1e-12)
        atol = 3.0 * tolerance * max(1.0, float(np.linalg.norm(fallen)))
        np.testing.assert_allclose(
            frame.particles.x - body.X, np.broadcast_to(fallen, body.X.shape), atol=atol
        )
        speed = np.array(frame.health.momentum) / frame.health.mass
        np.testing.assert_allclose(speed, g * frame.time, atol=30.0 * tolerance)


@pytest.mark.slow
def test_a_fall_with_drag_follows_its_closed_form():
    # dv/dt = g - k v: the splitting (kick, then exp(-k dt)) is first order in k dt = 0.5 / 150.
    body, _ = ball(300)
    s = settings(frames=13, gravity=(0.0, -9.81, 0.0), drag=0.5)
    made = preset_material("rubber", body, damping_time=0.0)
    frame = list(UpdatedLagrangian(body, [made], s).frames())[-1]
    speed = 9.81 / 0.5 * (1.0 - np.exp(-0.5 * frame.time))
    assert -frame.health.momentum[1] / frame.health.mass == pytest.approx(speed, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("real", "tolerance"), [(np.float32, 1e-5), (np.float64, 1e-13)])
def test_both_momenta_are_kept_and_energy_is_only_lost(real, tolerance):
    # In the world frame APIC keeps sum x x m v with the particles' own spin, the stress is
    # symmetric, and a particle moves along its velocity: rounding of 400 substeps is left.
    body, _ = ball(300)
    made = preset_material("rubber", body, damping_time=0.0)
    solver = UpdatedLagrangian(body, [made], settings(frames=60), velocity=spun, real=real)
    health = [f.health for f in solver.frames()]
    first = health[0]
    L0, scale = np.array(first.angular_momentum), np.linalg.norm(first.angular_momentum)
    for h in health:
        assert np.linalg.norm(np.subtract(h.angular_momentum, L0)) < tolerance * scale
        drift = np.linalg.norm(np.subtract(h.momentum, first.momentum))
        assert drift < tolerance * h.mass * np.linalg.norm(SPIN)
    energies = [h.kinetic + h.elastic for h in health]
    for before, after in pairwise(energies):
        assert after < before
    assert max(h.elastic for h in health) > 0.01 * energies[0], "the ball vibrates"
    assert energies[-1] > 0.8 * energies[0], "what is left is the spin"
    assert solver.state.done == sum(h.substeps for h in health)
    assert not any(h.rollbacks for h in health)


@pytest.mark.slow
def test_a_body_at_rest_stays_at_rest():
    # F = I is the rest state of the law to the bit, so nothing moves at all.
    body, _ = ball(300)
    made = preset_material("rubber", body)
    *_, last = UpdatedLagrangian(body, [made], settings(frames=30)).frames()
    np.testing.assert_allclose(last.particles.x, body.X, atol=1e-7)  # f32 of X - center
    assert np.abs(last.particles.v).max() == 0.0
    np.testing.assert_array_equal(last.particles.F, np.broadcast_to(np.eye(3), (len(body), 3, 3)))
    assert last.health.elastic == 0.0


@pytest.mark.slow
def test_an_affine_velocity_is_an_affine_strain():
    # Splines reproduce what is affine: over one step of 1e-6 s F = I + dt A and v stays, up to
    # (dt A)^2 / 2, because the grid gets the particles half a step further on.
    body, _ = ball(300)
    made = preset_material("rubber", body, damping_time=0.0, youngs_modulus=1e-6)
    s = settings(frames=2, substeps=1, fps=1e6)
    solver = UpdatedLagrangian(body, [made], s, velocity=lambda X: X @ SHEAR.T, real=np.float64)
    *_, last = solver.frames()
    rate = (last.particles.F - np.eye(3)) / last.time
    np.testing.assert_allclose(rate, np.broadcast_to(SHEAR, rate.shape), atol=1e-5)
    np.testing.assert_allclose(last.particles.v, body.X @ SHEAR.T, atol=1e-5)


@pytest.mark.slow
def test_a_body_that_outgrows_its_grid_gets_a_larger_one():
    # The frame is done again in the larger grid: the same to the bit as where it was there before.
    body, _ = ball(300)
    soft = preset_material("rubber", body, damping_time=0.0, youngs_modulus=1e-6)
    s = settings(frames=2, substeps=24)
    solver = UpdatedLagrangian(body, [soft], s, velocity=lambda X: 60.0 * X @ SHEAR.T)
    start, capacity = solver.state.save(), solver.state.node_capacity
    seen = []
    for _ in range(2):
        solver.advance(1, 24)
        assert solver.not_finite() == (-1, "")
        seen.append(solver.state.motion())
        solver.state.load(start)
    assert solver.state.node_capacity > capacity
    for first, second in zip(*seen, strict=True):
        assert np.array_equal(first, second)
    assert np.ptp(seen[0][0], axis=0).max() > 2.0 * 2.0, "twice as large as at rest"


@pytest.mark.slow
def test_the_viscous_dissipation_is_that_of_its_formula():
    # At F = I the power is -V 2 mu tau D:D, D the symmetric rate.  Over one step of 1e-7 s the
    # elastic stress and the change of D are smaller by 1e-5 each.
    body, _ = ball(300)
    made = preset_material("rubber", body, damping_time=0.01)
    s = settings(frames=2, substeps=1, fps=1e7)
    solver = UpdatedLagrangian(body, [made], s, velocity=lambda X: X @ SHEAR.T, real=np.float64)
    before, after = (f.health for f in solver.frames())
    D = 0.5 * (SHEAR + SHEAR.T)
    power = -2.0 * made.mu * 0.01 * (D * D).sum() * body.V0.sum()
    assert (after.kinetic - before.kinetic) / 1e-7 == pytest.approx(power, rel=1e-3)
