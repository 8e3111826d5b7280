"""The patch test of the Updated Lagrangian solver: a uniform F is a uniform stress, in balance."""

from __future__ import annotations

import numpy as np
import pytest
from law_references import ENERGIES, A, reference_stress, von_mises
from slow_parameters import longest_but, slow_but
from solids import ball, preset_material, settings

from gf_usd.core.materials.laws import LAWS
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian


def strained(token: str, real: type, **changes):
    """A ball that is put where A takes it, at rest."""
    body, _ = ball(500)
    made = preset_material("rubber", body, law=token, damping_time=0.0)
    s = settings(frames=2, substeps=1, fps=1e6, **changes)
    solver = UpdatedLagrangian(body, [made], s, real=real)
    x = solver.state.rows("x") @ A.T
    solver.state.arrays["x"].from_numpy(x.astype(real).ravel())
    solver.state.arrays["F"].from_numpy(np.tile(A.ravel(), len(body)).astype(real))
    if LAWS[token].flows:  # F_e, of which nothing has flowed
        history = solver.state.rows("history", solver.body.law.set.history)
        history[:, :9] = A.ravel()
        solver.state.put("history", history.ravel())
    return body, made, solver


@pytest.mark.parametrize("token", slow_but(ENERGIES, "corotated"))
@pytest.mark.parametrize(
    ("real", "tolerance"),
    [(np.float32, 1e-5), pytest.param(np.float64, 1e-11, marks=pytest.mark.slow)],
)
def test_stress_is_uniform(token, real, tolerance):
    # P ~ mu (F - R) and |F - R| ~ 0.1 here, and F has rounding eps: some 3 eps of the stress, with
    # the law's own digits.
    _, made, solver = strained(token, real)
    expected = von_mises(reference_stress(token, made.mu, made.lam))
    np.testing.assert_allclose(solver.von_mises(), expected, rtol=tolerance)


@pytest.mark.slow  # compiles kernels of double precision
@pytest.mark.parametrize("token", longest_but(ENERGIES, "corotated"))
def test_forces_add_up_to_nothing_and_vanish_inside(token):
    # sum_p V0 tau grad w over a filled lattice is what a uniform stress does to a node: nothing but
    # the error of eight points a cell, against h^2 tau at the surface.
    body, _, solver = strained(token, np.float64)
    *_, last = solver.frames()
    gained = solver.body.m[:, None] * last.particles.v
    size = np.abs(gained).sum()
    assert size > 0.0
    assert np.abs(gained.sum(0)).max() < 1e-10 * size
    spin = np.array(last.health.angular_momentum)
    assert np.abs(spin).max() < 1e-10 * size * body.radius
    depth = body.radius - np.linalg.norm(body.X, axis=1)
    inner, outer = depth > 1.5 * solver.body.h, depth < 0.5 * solver.body.h
    assert inner.sum() > 5
    speed = np.linalg.norm(last.particles.v, axis=1)
    assert speed[inner].mean() < 0.2 * speed[outer].mean()
