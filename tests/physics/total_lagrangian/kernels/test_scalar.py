"""Scalar kernels, SIMD kernels and sums in NumPy give the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from launching import WAYS, launched
from slow_parameters import longest_but
from solids import ball, preset_material, settings
from strained_ball import corotated

from gf_usd.core.frames.settings import CONSISTENT, LUMPED
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.physics.grid.reference.stencil import OFFSETS, weights
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

# f64: the two sum some hundred terms in different orders, over a few dozen substeps of an impact.
EXACT = {"rtol": 1e-9, "atol": 1e-10}


def drop(plain, real=np.float64, threads=2, launching=lambda solver: solver, **changes):
    """A ball that meets the floor, turned and thrown, with a filter: everything a substep has."""
    body, samples = ball(400, radius=0.1)
    options = {
        "frames": 4, "gravity": (0.0, -9.81, 0.0), "floor": -0.1, "filter_rate": 50.0, "fps": 60.0,
        "threads": threads, "substeps": 40, **changes,
    }  # fmt: skip
    law = options.pop("law", "corotated")
    solver = TotalLagrangian(
        body, [preset_material("rubber", body, law=law)], settings(**options), samples=samples,
        velocity=(0.3, -2.0, 0.1), real=real, plain=plain,
    )  # fmt: skip
    frames = list(launching(solver).frames())
    return solver, frames


def state(run):
    solver, _ = run
    now = solver.state.view()
    return np.concatenate([now.u, now.v, [now.offset]])


@pytest.mark.slow  # each compiles kernels of its own
@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, marks=pytest.mark.acceptance),
        pytest.param({"law": "neoHookean"}, marks=pytest.mark.acceptance),
        {"stress_cap": 3e3, "clamp": (0.9, 1.1), "wls": True, "procrustes": 0.02},
    ],
    ids=["corotated", "neo-Hookean", "the paper's options"],
)
def test_a_drop_is_the_same_either_way(changes):
    fast, plain = drop(False, **changes), drop(True, **changes)
    np.testing.assert_allclose(state(plain), state(fast), **EXACT)
    for a, b in zip(fast[1], plain[1], strict=True):
        assert b.health.elastic == pytest.approx(a.health.elastic, rel=1e-9, abs=1e-12)
        assert b.health.clamped == a.health.clamped
        assert b.health.stress_capped == a.health.stress_capped
    assert max(f.health.penetration for f in plain[1]) > 0.0


@pytest.mark.slow  # compiles kernels of double precision
def test_stress_of_every_particle_is_the_same_either_way():
    fast, plain = (drop(p, stress=True)[1][-1].stress for p in (False, True))
    assert fast.max() > 1.0
    np.testing.assert_allclose(plain, fast, rtol=1e-8, atol=1e-8 * fast.max())


@pytest.mark.slow  # compiles kernels of double precision
def test_single_precision_stays_near_double():
    exact, single = state(drop(True)), state(drop(True, real=np.float32))
    # 6e-8 of a rounding, times some hundred sums and 160 substeps of an impact at 2 m/s
    np.testing.assert_allclose(single, exact, atol=2e-4)


def launched_drop(way, threads, patch):
    launching = lambda solver: launched(solver, way, patch)  # noqa: E731
    return state(drop(True, real=np.float32, launching=launching, threads=threads))


@pytest.fixture(scope="module")
def first():
    with pytest.MonkeyPatch.context() as patch:
        return launched_drop("alone", 1, patch)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("way", WAYS)
def test_threads_launches_and_reruns_change_no_bit(first, way, threads, monkeypatch):
    assert np.array_equal(first, launched_drop(way, threads, monkeypatch))


def filtered(stencil, v, m):
    """sum_p w m (v_p + C_p dX) of nodal velocities v, from the particles' 27 weights each."""
    w, _ = weights(stencil.fx, stencil.h)
    nodes = np.repeat(stencil.cell_nodes, np.diff(stencil.cell_start), axis=0)
    d = stencil.h * (OFFSETS - stencil.fx[:, None])
    vp = np.einsum("pn,pna->pa", w, v[nodes])
    C = 4.0 / stencil.h**2 * np.einsum("pn,pna,pnb->pab", w, v[nodes], d)
    moved = vp[:, None] + np.einsum("pab,pnb->pna", C, d)
    out = np.zeros_like(v)
    np.add.at(out, nodes, (w * m[stencil.order, None])[..., None] * moved)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("plain", [False, True], ids=["fast", "plain"])
@pytest.mark.parametrize("mass", longest_but([LUMPED, CONSISTENT], CONSISTENT))
def test_one_substep_is_the_sum_that_numpy_makes(plain, mass):
    """v + alpha M~^-1 (B v - m v), then + dt M~^-1 f: eq. 1 to 3 in float64, every node free."""
    body, _ = ball(400)
    rubber = DIMENSIONLESS["rubber"].material(body.radius)
    rubber = replace(rubber, damping_time=0.01, law="corotated")
    s = settings(fps=1e4, frames=2, substeps=1, filter_rate=np.inf, followers=False, mass=mass)
    solver = TotalLagrangian(body, [rubber], s, real=np.float64, plain=plain)
    stencil, M = solver.body.stencil, solver.body.mass
    assert M.is_lumped == (mass == LUMPED)
    X = stencil.node_X
    u = 0.05 * np.stack([np.sin(2.0 * X[:, 1]), X[:, 0] * X[:, 2], np.cos(X[:, 0])], -1)
    v = 0.5 * np.stack([np.cos(X[:, 2]), np.sin(X[:, 0]), X[:, 1] ** 2], -1)
    solver.state.arrays["u"].from_numpy(u.ravel())
    solver.state.arrays["v"].from_numpy(v.ravel())
    dt = 1e-4
    u = u + 0.5 * dt * v
    lost = filtered(stencil, v, solver.body.m) - stencil.mass[:, None] * v
    v = v + M.acceleration(lost) / M.lightest
    G = [G @ solver.body.rows.spread for G in solver.body.rows.G]
    F, D = (np.stack([g @ q for g in G], -1) for q in (u, v))
    F = F + np.eye(3)
    E = np.einsum("pba,pbc->pac", F, D)
    mu, lam = solver.body.per["mu"][0], solver.body.per["lam"][0]
    P = corotated(F, mu, lam) + 2.0 * mu * 0.01 * F @ (0.5 * (E + E.swapaxes(1, 2)))
    # the shock viscosity, 3/2 rho l^2 (dln J/dt)^2 where l = J h, in what is compressed
    J, cof = np.linalg.det(F), np.linalg.det(F)[:, None, None] * np.linalg.inv(F).swapaxes(1, 2)
    rate = np.minimum(np.einsum("pab,pab->p", cof, D), 0.0)
    assert 30 < (rate == 0.0).sum() < 370, "some are compressed and some are not"
    q = 1.5 * rubber.density * stencil.h**2 * rate**2 / J
    P = P - q[:, None, None] * cof
    T = body.V0[:, None, None] * P
    v = v - dt * M.acceleration(sum(G[a].T @ T[:, :, a] for a in range(3)))
    solver.advance(1, 1)
    # the polar decomposition is taken until it changes by 3e-8 of itself, squared by the last step
    np.testing.assert_allclose(solver.state.view().v, v, rtol=1e-9, atol=1e-9 * np.abs(v).max())
