"""Stretches clipped, stress cut: what acts, by how much, and how often it is counted."""

from __future__ import annotations

import numpy as np
import pytest
from slow_parameters import longest_but
from solids import preset_material
from strained_ball import EXACT, INVERTED, SQUASH, body, clipped, force, made, shear_modulus, strain

from gf_usd.core.frames.frame import Health, Pose
from gf_usd.physics.frame_loop import GAIN, Guard
from gf_usd.physics.per_particle import strains
from gf_usd.physics.total_lagrangian.energies import elastic_energy, strain_energy, von_mises
from gf_usd.physics.total_lagrangian.limits import limited_particles
from gf_usd.physics.total_lagrangian.shape_correction import clip_stretches


def test_clipping_by_hand():
    F = np.stack([np.diag([0.1, 1.0, 7.0]), np.diag([0.5, 1.0, 2.0]), INVERTED])
    out, changed = clip_stretches(F, 0.2, 5.0)
    np.testing.assert_allclose(out[0], np.diag([0.2, 1.0, 5.0]), atol=EXACT)
    np.testing.assert_array_equal(out[1], F[1])
    # An inverted particle has the sign on its least stretch, which becomes the least allowed.
    np.testing.assert_allclose(out[2], np.diag([1.2, 0.9, 0.2]), atol=EXACT)
    assert changed.tolist() == [True, False, True]


@pytest.mark.slow
@pytest.mark.parametrize("A", [SQUASH, INVERTED, np.diag([0.05, 6.0, 1.0])], ids=["a", "b", "c"])
@pytest.mark.parametrize("law", longest_but(["corotated", "neoHookean"], "corotated"))
def test_the_clamp_takes_stress_and_energy_of_the_clipped_strain(A, law):
    low, high = 0.5, 1.5
    seen, bare = made(clamp=(low, high), law=law), made(law=law)
    strain(seen, A)
    strain(bare, clipped(A, low, high))
    # Taichi's SVD of float64 stops its Jacobi sweeps at about 1e-9.
    wanted = elastic_energy(bare.body, bare.state)
    assert elastic_energy(seen.body, seen.state) == pytest.approx(wanted, rel=1e-7)
    reported = strain_energy(seen.body, seen.body.law, *strains(seen.state.view().pose(0).F))
    assert reported == pytest.approx(wanted, rel=1e-7)
    wanted = force(bare)
    np.testing.assert_allclose(force(seen), wanted, atol=1e-6 * np.abs(wanted).max())
    bits = seen.state.get("touched")
    limited = limited_particles(bits, seen.body.options, seen.body.layout, seen.body.m)
    assert limited["clamped"].all()


@pytest.mark.slow
def test_a_clamp_counts_particles_once_a_frame_and_only_those():
    # Half the body is squeezed: 5 substeps see it again and again.
    solver = made(clamp=(0.8, 1.25), substeps=5)
    X = solver.body.stencil.node_X
    u = np.where(X[:, :1] > 0.0, X * [-0.5, 0.0, 0.0], 0.0)
    solver.state.arrays["u"].from_numpy(u.ravel())
    passage = solver.advance(1, 5)
    F = solver.state.view().pose(1).F
    s = np.linalg.svd(F, compute_uv=False)
    outside = ((s < 0.8) | (s > 1.25)).any(1)
    assert 0 < outside.sum() < len(body())
    assert passage.clamped == pytest.approx(int(outside.sum()), abs=2)  # it moved by a hair
    solver.state.arrays["u"].fill(0.0)
    assert solver.advance(2, 5).clamped == 0


@pytest.mark.slow  # compiles kernels of its own
def test_with_wls_the_new_f_is_clipped_and_counted():
    solver = made(wls=True, clamp=(0.8, 1.25), substeps=1, velocity=lambda X: X * [-5e4, 0.0, 0.0])
    frame = list(solver.frames())[-1]
    assert np.linalg.svd(frame.particles.F, compute_uv=False).min() == pytest.approx(0.8, abs=1e-9)
    assert frame.health.clamped == len(body())
    assert frame.health.rollbacks == 0


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.25, 0.9, 1.1])
def test_the_cap_scales_the_stress_down_to_itself(share):
    A = SQUASH
    U, _, Vt = np.linalg.svd(A)
    mu, lam, J = shear_modulus(), preset_material("rubber", body()).lam, np.linalg.det(A)
    P = 2.0 * mu * (A - U @ Vt) + lam * (J - 1.0) * J * np.linalg.inv(A).T
    size = np.linalg.norm(P)
    capped, bare = made(stress_cap=share * size), made()
    for solver in (capped, bare):
        strain(solver, A)
    shown = von_mises(capped.body, capped.state)
    np.testing.assert_allclose(shown, min(share, 1.0) * von_mises(bare.body, bare.state), rtol=1e-9)
    # The force is minus the slope of the energy, cut by the same factor: along any direction.
    f = force(capped)
    d = np.random.default_rng(1).normal(size=f.shape)
    full = np.zeros((bare.body.stencil.node_count, 3))
    full[: len(d)] = d
    full[len(d) :] = bare.body.stencil.follow @ d
    slope = []
    for step in (1e-6, -1e-6):
        strain(bare, A)
        u = bare.state.arrays["u"].to_numpy() + step * full.ravel()
        bare.state.arrays["u"].from_numpy(u)
        slope.append(elastic_energy(bare.body, bare.state))
    wanted = -min(share, 1.0) * (slope[0] - slope[1]) / 2e-6
    # Central differences of a step of 1e-6: 1e-10 of rounding over 1e-6, and the frame's motion.
    assert float((f * d).sum()) == pytest.approx(wanted, rel=1e-4)
    strain(capped, A)
    assert capped.advance(1, 3).stress_capped == (len(body()) if share < 1.0 else 0)


def test_the_guard_judges_the_integrator_alone():
    pose = Pose(x=body().X, v=0.0 * body().X, F=np.broadcast_to(np.eye(3), (len(body()), 3, 3)))
    rest, gain = Health(), 5.0 * GAIN

    def fault(**fields):
        return Guard(1.0, 1.0).judge(rest, Health(kinetic=gain, **fields), pose)[1]

    assert "energy rose" in fault()
    assert "energy rose" in fault(injected=-gain)
    for fields in ({"injected": gain}, {"clamped": 1}, {"stress_capped": 1}):
        assert fault(**fields) == ""
    lost = Health(kinetic=float("nan"), clamped=1)
    assert "energy rose" in Guard(1.0, 1.0).judge(rest, lost, pose)[1]
