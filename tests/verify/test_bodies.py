"""The bodies of the cases, and reading forces off a solver."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.errors import SolverError
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import (
    GAUSS,
    MIDDLE,
    block,
    clamp,
    elastic,
    iterate_states,
    mean_stress,
    nodal_forces,
    set_state,
    settings,
)
from gf_usd.verify.cases.elastic import manufactured
from gf_usd.verify.cases.elastic.cantilever import Beam
from gf_usd.verify.cases.elastic.locking import exact
from gf_usd.verify.cases.floor import restitution_without_adhesion


@pytest.mark.parametrize("places", [GAUSS, MIDDLE])
def test_a_block_has_eight_particles_in_every_cell(places) -> None:
    low, cells, h = np.array([1.0, -2.0, 0.5]), np.array([2, 3, 4]), 0.25
    body = block(low, cells, h, places=places)
    inside = (body.X - low) / h
    count = np.zeros(cells, int)
    np.add.at(count, tuple(np.floor(inside).astype(int).T), 1)
    assert (count == 8).all()
    assert body.V0.sum() == pytest.approx(24 * h**3, rel=1e-12)


def test_gauss_places_integrate_cubics_of_a_cell() -> None:
    body = block(np.zeros(3), (1, 1, 1), 1.0, places=GAUSS)
    x, y, z = body.X.T
    assert body.V0 @ (x**3 * y**2 * z) == pytest.approx(1.0 / 24.0, rel=1e-12)


def test_a_clamp_holds_what_is_under_its_plane() -> None:
    pin = clamp(1, 0.5)
    X = np.array([[0.0, 0.4, 1.0], [0.0, 0.6, 1.0]])
    assert pin.inside(X).tolist() == [True, False]
    np.testing.assert_array_equal(pin.nearest(X), [[0.0, 0.5, 1.0], [0.0, 0.5, 1.0]])


@pytest.mark.slow
def test_virial_and_force_of_a_strained_block() -> None:
    body = block(np.zeros(3), (2, 2, 2), 0.5, places=GAUSS)
    made = elastic(E=2.0, nu=0.0, density=3.0)
    s = settings("cpu", fps=1e9, substeps=1, followers=False)
    solver = TotalLagrangian(body, [made], s, real=np.float64)
    set_state(solver, solver.body.stencil.node_X * [0.1, 0.0, 0.0])
    # nu = 0: P = E (F - 1) along the axis, and nothing across.
    P = mean_stress(solver)
    np.testing.assert_allclose(P, np.diag([0.2, 0.0, 0.0]), atol=1e-14)
    set_state(solver, np.zeros((solver.body.stencil.node_count, 3)))
    b = np.zeros((solver.body.stencil.free_count, 3))
    b[:, 1] = 7.0
    solver.state.accelerate(b)
    assert nodal_forces(solver)[:, 1].sum() == pytest.approx(3.0 * 7.0, rel=1e-9)


def test_the_manufactured_forces_follow_from_the_solution() -> None:
    made = elastic(E=1e7, nu=0.3, density=1000.0, law="neoHookean")
    exact = manufactured.Solution(made)
    X, t, step = np.array([[0.1, -0.3, 0.45], [0.0, 0.2, -0.4]]), 3e-3, 1e-4
    slope = np.zeros_like(X)
    for axis in range(3):
        bump = step * np.eye(3)[axis]
        high, low = exact.P(X + bump, t), exact.P(X - bump, t)
        slope[:, axis] = (high - low)[:, axis] / (2.0 * step)
    time = 1e-6
    rate = (exact.v(X, t + time) - exact.v(X, t - time)) / (2.0 * time)
    expected = rate - slope / made.density
    # Differences of second order: (pi step)^2 / 6 = 2e-8, and rounding of P ~ 1e4 over step.
    size = np.abs(rate).max()
    np.testing.assert_allclose(exact.b(X, t), expected, atol=1e-5 * size)
    ends = np.array([[0.5, 0.5, 0.5]])
    assert np.abs(exact.u(ends, t)).max() > 0.0


def test_references_have_their_known_limits() -> None:
    assert restitution_without_adhesion(0.999999) == pytest.approx(1.0, abs=1e-5)
    assert restitution_without_adhesion(0.85) == pytest.approx(0.8546, abs=5e-5)
    # A slender beam: 22.373 sqrt(E I / rho A) / L^2, here with 8 times its thickness: shear and
    # rotation take some 4 %.
    slender = 22.3733 * np.sqrt(1e6 / 12.0 / 1000.0) / 8.0
    assert 0.93 < exact(0.3) / slender < 0.97
    assert exact(0.49) < exact(0.0)
    beam = Beam(slenderness=20, cells=8)
    assert beam.h == pytest.approx(1.0 / 160.0)
    assert beam.omega == pytest.approx(3.516 * np.sqrt(1e3 / 12.0) / 20.0, rel=1e-4)


def swinging() -> TotalLagrangian:
    body = block(np.zeros(3), (3, 2, 2), 0.5)
    s = settings("cpu", frames=4, fps=200.0)
    return TotalLagrangian(
        body, [elastic(E=1e6, nu=0.3, density=1000.0)], s,
        velocity=lambda X: 0.01 * np.sin(X[:, ::-1]),
    )  # fmt: skip


@pytest.mark.slow
def test_motion_is_that_of_frames():
    frames = list(swinging().frames())
    seen = [(t, now.particles.x) for t, now in iterate_states(swinging())]
    assert [t for t, _ in seen] == [frame.time for frame in frames]
    for (_, x), frame in zip(seen, frames):
        np.testing.assert_array_equal(x, frame.particles.x)


@pytest.mark.slow
def test_motion_ends_where_something_is_no_number():
    solver = swinging()
    moved = iterate_states(solver)
    next(moved)
    solver.throw(np.full((solver.body.stencil.free_count, 3), np.nan))
    with pytest.raises(SolverError, match="frame 1"):
        next(moved)
