"""Planes that mirror: a body before one moves as half of a body that is symmetric."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gf_usd.core.errors import UsageError
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.physics.updated_lagrangian.walls import NOWHERE, Wall, planes
from gf_usd.verify.bodies import block, elastic, settings

H = 0.1  # [m]
MADE = elastic(E=1e4, nu=0.3, density=1000.0)


def run(body, walls=(), velocity=(0.0, 0.0, 0.0), **changes):
    s = settings("cpu", frames=4, fps=100.0, **changes)
    return UpdatedLagrangian(body, [MADE], s, walls=walls, velocity=velocity, real=np.float64)


@pytest.mark.acceptance
@pytest.mark.slow  # compiles kernels of its own
def test_half_of_a_symmetric_body_moves_as_the_whole() -> None:
    whole = block((-2 * H, 0.0, 0.0), (4, 2, 2), H)
    half = block((0.0, 0.0, 0.0), (2, 2, 2), H)

    def apart(X):
        return np.column_stack([2.0 * X[:, 0], 0.5 + X[:, 2], 0.3 * X[:, 0] * X[:, 0]])

    *_, both = run(whole, velocity=apart).frames()
    *_, one = run(half, [Wall(axis=0, at=0.0)], velocity=apart).frames()
    # the particles of the half among those of the whole
    where = {tuple(np.round(X / H, 6)): k for k, X in enumerate(whole.X)}
    same = [where[tuple(np.round(X / H, 6))] for X in half.X]
    np.testing.assert_allclose(one.particles.x, both.particles.x[same], atol=1e-13)
    np.testing.assert_allclose(one.particles.F, both.particles.F[same], atol=1e-11)
    assert np.abs(one.particles.x - half.X).max() > 0.01


@pytest.mark.slow  # compiles kernels of its own
@pytest.mark.parametrize("kernel", ["serial", "resident"])
def test_momentum_is_what_planes_and_weight_gave_and_none_passes_them(kernel) -> None:
    body = block((0.0, 0.0, 0.0), (2, 2, 1), H)
    walls = [
        Wall(axis=0, at=0.0), Wall(axis=1, at=0.0, sticks=True), Wall(axis=2, at=0.0),
        Wall(axis=2, at=H, above=False),
    ]  # fmt: skip
    solver = run(body, walls, (-1.0, -2.0, 0.0), gravity=(0.0, -9.81, 0.0))
    solver.kernel = kernel
    first, *_, last = solver.frames()
    m = first.health.mass
    fell = np.array([0.0, -9.81 * last.time, 0.0])
    kept = np.subtract(last.health.momentum, first.health.momentum) / m
    np.testing.assert_allclose(kept, solver.state.wall_impulse / m + fell, atol=1e-12)
    assert solver.state.wall_impulse[1] > 0.1 * m
    x = last.particles.x
    assert x[:, :2].min() > 0.0
    assert x[:, 2].min() > 0.0
    assert x[:, 2].max() < H
    # plane strain: no motion across
    np.testing.assert_allclose(last.particles.v[:, 2], 0.0, atol=1e-12)
    saved = solver.save()
    solver.next(4, last.health)
    solver.load(saved)
    np.testing.assert_array_equal(solver.state.wall_impulse, saved["wall_impulse_sum"])


@pytest.mark.slow  # compiles kernels of its own
def test_what_sticks_is_held_and_what_slides_is_not() -> None:
    body = block((0.0, 0.0, 0.0), (2, 1, 2), H)
    moved = {}
    for sticks in (False, True):
        wall = Wall(axis=1, at=0.0, sticks=sticks)
        *_, last = run(body, [wall], (1.0, 0.0, 0.0)).frames()
        moved[sticks] = last.particles.x[:, 0] - body.X[:, 0]
    np.testing.assert_allclose(moved[False], 0.03, atol=1e-12)
    # A wave of shear, sqrt(mu / rho) = 2 m/s, crosses the block in 0.05 s: it is as if sheared
    # evenly in less than that.
    low, high = (moved[True][(body.X[:, 1] < 0.5 * H) == below].mean() for below in (True, False))
    assert low < 0.5 * 0.03
    assert 1.5 * low < high < 0.03


def test_planes_are_counted_in_half_cells_and_move_with_the_grid() -> None:
    X = np.full((2, 3), 0.5)
    made = planes(
        [Wall(axis=0, at=0.0), Wall(axis=0, at=1.0, above=False, sticks=True)], X,
        np.array([-0.05, 0.0, 0.0]), H,
    )  # fmt: skip
    assert made.first.tolist() == [1, -NOWHERE, -NOWHERE]
    assert made.last.tolist() == [21, NOWHERE, NOWHERE]
    assert made.stuck.tolist() == [2, 0, 0]
    assert made.moved(np.array([3, 0, 0])).first[0] == -5


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        ([Wall(axis=1, at=0.03)], "wall at y = 0.03 m does not fit the grid with cells of"),
        ([Wall(axis=1, at=0.03)], "the nearest half cell is 2 cm away"),
        ([Wall(axis=1, at=0.6)], "2 of 2 particles are behind the wall at y = 0.6 m"),
        ([Wall(axis=2, at=0.4, above=False)], "behind the wall at z"),
        ([Wall(axis=0, at=0.0), Wall(axis=0, at=0.1)], "two walls below along x"),
    ],
)
def test_what_is_no_wall_is_refused(walls, message) -> None:
    with pytest.raises(UsageError, match=message):
        planes(walls, np.full((2, 3), 0.5), np.zeros(3), H)


@pytest.mark.parametrize(
    ("at", "origin", "h"),
    [
        (-12300.0012345, -12345.678, 0.0041),
        (1e6 + 0.1002, 0.3, 1e-3),
        (0.03, 0.0, H),
        (1.0, 0.1, 1 / 3),
    ],
)
def test_a_wall_where_the_hint_places_it_is_accepted(at: float, origin: float, h: float) -> None:
    """Nine digits were too few 12 km from zero, with cells of 4 mm."""
    X, start = np.full((2, 3), 2e6), np.array([origin, 0.0, 0.0])
    with pytest.raises(UsageError) as refused:
        planes([Wall(axis=0, at=at)], X, start, h)
    found = re.search(r"place it at x = (\S+) m", refused.value.hint)
    assert found is not None
    planes([Wall(axis=0, at=float(found[1]))], X, start, h)
    if at == 0.03:
        assert found[1] == "0.05"
