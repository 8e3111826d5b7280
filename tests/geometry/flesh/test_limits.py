"""Limits of flesh: whose a point is, where its bone carries it, and how far it may go."""

from __future__ import annotations

import numpy as np
import pytest
from moved_bone import moved_bone
from scipy import sparse

from gf_usd.core.stage import Skeleton
from gf_usd.geometry.flesh.cores import Core, Cores
from gf_usd.geometry.flesh.limits import flesh_limits, nearest_bone

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
SHIFT = np.array([0.3, 0.0, 0.1])
CELL = 0.05
X = np.array([[0.2, 0.1, 0.0], [0.9, -0.02, 0.0], [1.4, 0.0, 0.3], [-0.1, 0.0, 0.0]])


def axis(bone: int, start: float, end: float) -> Core:
    line = np.linspace(start, end, 5)[:, None] * [1.0, 0.0, 0.0]
    return Core(bone=bone, points=line, radius=np.full(5, 0.01))


CORES = Cores(cores=(axis(0, 0.0, 1.0), axis(1, 1.2, 2.0)))
SKELETON = Skeleton(
    bones=(moved_bone(TURN, SHIFT), moved_bone(2.0 * np.eye(3), np.zeros(3))),
    weights={"/M": sparse.csr_matrix((0, 2))},
)


def test_a_point_belongs_to_the_bone_with_the_nearest_axis() -> None:
    of, way = nearest_bone(CORES, X)
    np.testing.assert_array_equal(of, [0, 0, 1, 0])
    expected = [[0.0, 0.1, 0.0], [0.0, -0.02, 0.0], [0.0, 0.0, 0.3], [-0.1, 0.0, 0.0]]
    np.testing.assert_allclose(way, expected, atol=1e-15)


@pytest.mark.parametrize(("squish", "stretch"), [(0.75, 0.4), (None, 0.4), (0.75, None)])
def test_ways_are_shares_of_the_distance_to_the_bone(
    squish: float | None, stretch: float | None
) -> None:
    made = flesh_limits(CORES, SKELETON, squish=squish, stretch=stretch, cell=CELL)
    r = np.array([0.1, CELL, 0.3, 0.1])  # that of a cell's edge at least
    toward = np.inf if squish is None else 0.25 * r
    away = np.inf if stretch is None else 0.4 * r
    np.testing.assert_allclose(made.toward(X), np.broadcast_to(toward, 4), rtol=1e-12)
    np.testing.assert_allclose(made.away(X), np.broadcast_to(away, 4), rtol=1e-12)


def test_a_bone_carries_its_points_and_their_direction_from_it() -> None:
    made = flesh_limits(CORES, SKELETON, squish=0.5, stretch=None, cell=CELL)
    place, n = made.carried(X)(1.0)
    moved = X @ TURN.T + SHIFT
    moved[2] = 2.0 * X[2]
    np.testing.assert_allclose(place, moved, atol=1e-12)
    outward = np.array([[0, 1, 0], [0, -1, 0], [0, 0, 1], [-1, 0, 0]], float)
    outward[[0, 1, 3]] = outward[[0, 1, 3]] @ TURN.T
    np.testing.assert_allclose(n, outward, atol=1e-12)
    np.testing.assert_allclose(made.carried(X)(0.0)[0], X, atol=1e-12)
