"""Obstacles: what a detection asks of one."""

from __future__ import annotations

import numpy as np
import pytest
from trimesh.creation import icosphere

from gf_usd.core.stage import Collider
from gf_usd.physics.contact.obstacles.obstacle import Obstacle, box_gap
from gf_usd.system.taichi_runtime import init_taichi

REACH = 0.3  # [m]


@pytest.fixture(autouse=True, scope="module")
def _taichi() -> None:
    init_taichi("cpu", 1)


def turning_ball() -> Collider:
    """A ball of radius 1 m that is turned and stretched over three frames."""
    ball = icosphere(3)
    c, s = np.cos([0.0, 0.4, 0.9]), np.sin([0.0, 0.4, 0.9])
    linear = np.tile(np.eye(3), (3, 1, 1))
    linear[:, 0, 0], linear[:, 0, 1], linear[:, 1, 0], linear[:, 1, 1] = 1.2 * c, -s, 1.2 * s, c
    return Collider(
        path="/Ball", shape="mesh", points=np.array(ball.vertices),
        triangles=np.array(ball.faces), linear=linear, offset=np.zeros((3, 3)),
    )  # fmt: skip


@pytest.mark.slow
def test_triangles_that_numbered_points_were_near_change_nothing() -> None:
    dice = np.random.default_rng(0)
    X = dice.normal(size=(400, 3))
    X *= (0.8 + 0.4 * dice.random((400, 1))) / np.linalg.norm(X, axis=1, keepdims=True)
    known, plain = Obstacle(turning_ball(), 0.04), Obstacle(turning_ball(), 0.04)
    for frame, some in ((0.0, slice(200)), (0.5, slice(400)), (1.5, slice(100, 400, 3))):
        of = np.arange(400)[some]
        got = known.planes(X[some], REACH, frame, 0.01, of)
        expected = plain.planes(X[some], REACH, frame, 0.01)
        assert len(got.seen.rows) > 0.9 * len(of)
        assert np.array_equal(got.velocity, expected.velocity)
        for name in ("rows", "gap", "triangle", "weights", "point", "normal"):
            assert np.array_equal(getattr(got.seen, name), getattr(expected.seen, name)), name


def test_gaps_of_boxes_are_those_of_each() -> None:
    dice = np.random.default_rng(1)
    obstacle = Obstacle(turning_ball(), 0.04)
    low = 4.0 * dice.normal(size=(50, 3))
    high = low + dice.random((50, 3))
    gaps = obstacle.gaps(low, high)
    assert 0 < (gaps == 0.0).sum() < 50
    np.testing.assert_allclose(
        gaps, [box_gap(a, b, *obstacle.box) for a, b in zip(low, high)], rtol=1e-15
    )
