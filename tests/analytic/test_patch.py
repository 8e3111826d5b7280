"""The affine patch test: an affine motion of the nodes is the same F in every particle."""

from __future__ import annotations

import numpy as np
import pytest
from law_references import ENERGIES, A, reference_stress, von_mises
from slow_parameters import longest_but, slow_but
from solids import ball, preset_material, settings

from gf_usd.physics.total_lagrangian import energies
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.cases.patch import stress

SHIFT = np.array([0.3, -0.2, 0.1])


def test_a_law_without_a_reference_formula_is_an_error():
    with pytest.raises(ValueError, match="ogden has no reference formula"):
        stress("ogden", A, 1.0, 1.0)


@pytest.mark.parametrize("token", slow_but(ENERGIES, "neoHookean"))
@pytest.mark.parametrize(
    ("real", "tolerance"),
    [(np.float32, 1e-6), pytest.param(np.float64, 1e-12, marks=pytest.mark.slow)],
)
def test_stress_is_uniform(token, real, tolerance):
    # P ~ mu (F - R) and |F - R| ~ 0.1 here, F has rounding eps * sum |u| |grad w| ~ 3 eps on 1:
    # f32 leaves some 3e-6 of the stress, f64 1e-14.
    body, _ = ball(500)
    made = preset_material("rubber", body, law=token, damping_time=0.0)
    solver = TotalLagrangian(body, [made], settings(), real=real)
    u = solver.body.stencil.node_X @ (A - np.eye(3)).T + SHIFT
    solver.state.arrays["u"].from_numpy(u.astype(real).ravel())
    expected = von_mises(reference_stress(token, made.mu, made.lam))
    seen = energies.von_mises(solver.body, solver.state)
    np.testing.assert_allclose(seen, expected, rtol=10 * tolerance)
    pose = next(iter(solver.frames())).particles
    np.testing.assert_allclose(pose.F, np.broadcast_to(A, pose.F.shape), atol=3 * tolerance)
    np.testing.assert_allclose(pose.x, body.X @ A.T + SHIFT, atol=3 * tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("token", longest_but(ENERGIES, "corotated", "vonMises"))
def test_forces_add_up_to_nothing(token):
    # Internal forces are pairs: their sum and their moment about any point vanish, whatever u is.
    body, _ = ball(300)
    made = preset_material("rubber", body, law=token, damping_time=0.002)
    s = settings(frames=2, substeps=1, fps=1e6)
    rng = np.random.default_rng(1)
    wave = rng.normal(size=(3, 3))

    def velocity(X):
        return 0.1 * np.sin(X @ wave)

    solver = TotalLagrangian(body, [made], s, velocity=velocity, real=np.float64)
    u = 0.02 * np.sin(2.0 * solver.body.stencil.free_X @ wave.T)
    full = np.concatenate([u, solver.body.stencil.follow @ u])
    solver.state.arrays["u"].from_numpy(full.ravel())
    before = solver.state.view().momentum
    list(solver.frames())
    change = solver.state.view().momentum - before
    size = np.abs(change).sum()
    assert size > 0.0
    assert np.abs(change.sum(0)).max() < 1e-10 * size
    x = solver.body.stencil.free_X + u
    # The moment is taken half a drift of 5e-7 s later: x has an error of v dt / 2 ~ 5e-8.
    assert np.abs(np.cross(x, change).sum(0)).max() < 1e-6 * size
