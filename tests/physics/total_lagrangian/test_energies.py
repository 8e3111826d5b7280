"""What a frame says of itself, against a body whose motion is known."""

from __future__ import annotations

import numpy as np
import pytest
from solids import ball, preset_material, settings

from gf_usd.physics.contact.floor import HARD, STOPPING_DISTANCE
from gf_usd.physics.per_particle import strains
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

# State is kept in float32: 6e-8 of each value, and sums over the nodes average it.
SINGLE = 1e-6


@pytest.fixture(scope="module")
def body():
    return ball(300)


def first(body, *, velocity=(0.0, 0.0, 0.0), samples=None, **changes):
    """The solver and the health of its first frame."""
    particles, _ = body
    material = preset_material("rubber", particles, damping_time=0.0, law="corotated")
    solver = TotalLagrangian(
        particles, [material], settings(**changes), samples=samples, velocity=velocity
    )
    return solver, next(solver.frames()).health


def test_singular_values_are_those_of_the_svd():
    F = np.random.default_rng(0).normal(size=(300, 3, 3))
    F[0], F[1], F[2] = np.eye(3), np.zeros((3, 3)), np.diag([1.0, 1e-3, -1.0])
    F[3] = np.ones((3, 3))
    wanted = np.linalg.svd(F, compute_uv=False)[:, ::-1]
    size = np.maximum(wanted[:, 2:], 1e-30)
    # Roots of eigenvalues that carry 1e-16 of the largest: 1e-8, times a few operations.
    np.testing.assert_allclose((strains(F)[0] - wanted) / size, 0.0, atol=1e-7)


@pytest.mark.slow
def test_a_body_at_rest_has_its_weight_and_nothing_else(body):
    particles, _ = body
    m = 1100.0 * particles.V0.sum()
    _, health = first(body, gravity=(0.0, -9.81, 0.0), lift=(0.0, 7.0, 0.0))
    center = particles.X.mean(0) + [0.0, 7.0, 0.0]
    assert health.mass == pytest.approx(m, rel=1e-12)
    np.testing.assert_allclose(health.center, center, atol=1e-12)
    assert health.potential == pytest.approx(m * 9.81 * center[1], rel=1e-12)
    assert health.kinetic == health.elastic == health.contact == 0.0
    assert health.min_J == health.max_J == 1.0
    assert health.inverted == 0


def test_the_potential_is_measured_from_the_floor(body):
    _, low = first(body, gravity=(0.0, -9.81, 0.0), floor=0.0)
    _, high = first(body, gravity=(0.0, -9.81, 0.0), floor=-2.0)
    assert high.potential - low.potential == pytest.approx(2.0 * 9.81 * low.mass, rel=1e-12)


def test_translation_and_spin_carry_the_momenta_of_a_rigid_body(body):
    V, w = np.array([1.0, -2.0, 0.5]), np.array([0.3, 2.0, -1.0])
    lift = np.array([3.0, 1.0, -2.0])
    solver, health = first(body, velocity=lambda X: V + np.cross(w, X), lift=tuple(lift))
    X, m = solver.particles.X, solver.body.m
    # The nodes' mass has the inertia of the particles, to `grid.mass.RIDGE` of what lumping adds;
    # the rest is the float32 of the velocities.
    spread = 0.01 * m.sum() * solver.body.h**2 / 4.0
    np.testing.assert_allclose(
        health.momentum, m.sum() * (V + np.cross(w, m @ X / m.sum())), rtol=SINGLE
    )
    v = V + np.cross(w, X)
    L = (m[:, None] * np.cross(X + lift, v)).sum(0)
    np.testing.assert_allclose(
        health.angular_momentum, L, rtol=SINGLE, atol=2.0 * spread * np.linalg.norm(w)
    )
    kinetic = 0.5 * (m * (v * v).sum(1)).sum()
    assert health.kinetic == pytest.approx(kinetic, rel=SINGLE, abs=spread * (w @ w))


def test_a_stretched_body_holds_the_energy_of_its_strain(body):
    particles, _ = body
    solver, _ = first(body)
    u = np.zeros((solver.body.stencil.node_count, 3), np.float32)
    u[:, 1] = 0.1 * solver.body.stencil.node_X[:, 1]
    solver.state.arrays["u"].from_numpy(u.ravel())
    health = next(solver.frames()).health
    material = preset_material("rubber", particles)
    # Corotated law at diag(1, 1.1, 1): mu .01 + lam/2 .01.
    density = 0.01 * material.mu + 0.005 * material.lam
    # psi is a difference of float32 numbers near 1 squared: 6e-8 / .1, twice, times a few.
    assert health.elastic == pytest.approx(density * particles.volume, rel=1e-5)
    assert health.max_stretch == pytest.approx(1.1, abs=SINGLE)
    assert health.min_stretch == pytest.approx(1.0, abs=SINGLE)
    assert health.max_J == pytest.approx(1.1, abs=SINGLE)


def test_inverted_particles_are_counted(body):
    particles, _ = body
    solver, _ = first(body)
    u = np.zeros((solver.body.stencil.node_count, 3), np.float32)
    u[:, 1] = -1.5 * solver.body.stencil.node_X[:, 1]
    solver.state.arrays["u"].from_numpy(u.ravel())
    health = next(solver.frames()).health
    assert health.inverted == len(particles)
    assert health.min_J == pytest.approx(-0.5, abs=SINGLE)
    assert health.min_stretch == pytest.approx(0.5, abs=SINGLE)  # stretches carry no sign


def test_a_body_in_the_floor_holds_the_energy_of_its_springs(body):
    _, samples = body
    solver, health = first(
        body, samples=samples, floor=0.0, lift=(0.0, 0.9, 0.0), gravity=(0.0, -9.81, 0.0)
    )
    depth = np.maximum(0.0, -(samples.X[:, 1] + 0.9))
    assert (depth > 0.0).sum() >= 3
    spacing = solver.particles.spacing
    deeper = np.maximum(0.0, depth - STOPPING_DISTANCE * spacing)
    assert deeper.any()
    held = 0.5 * depth**2 + 0.25 * deeper**4 / (HARD * spacing) ** 2
    contact = solver.body.contact
    assert contact is not None
    assert health.contact == pytest.approx(contact.stiffness @ held, rel=1e-9)
