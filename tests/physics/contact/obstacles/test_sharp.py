"""Convex edges and corners of obstacles."""

from __future__ import annotations

import numpy as np
import pytest
from solids import cube, sphere

from gf_usd.physics.contact.obstacles.sharp import SharpFeatures

EVERYWHERE = np.full(3, -np.inf), np.full(3, np.inf)


def points_of(points, triangles, step: float, box=EVERYWHERE):
    points = np.asarray(points, float)
    found = SharpFeatures(points, np.asarray(triangles), step).within(points, *box)
    return found, found.among(points)


def test_a_cube_has_twelve_edges_and_eight_corners() -> None:
    """The diagonals of its faces are no edges; points are at most a step apart."""
    box = cube()
    low, high = box.points.min(0), box.points.max(0)
    found, x = points_of(box.points, box.triangles, 0.3 * float((high - low)[0]))
    outer = (np.isclose(x, low) | np.isclose(x, high)).sum(1)
    assert (outer == 3).sum() == 8
    assert (outer == 2).sum() == 12 * 3
    assert len(x) == 8 + 12 * 3
    assert len(np.unique(found.key)) == len(x)
    middle = 0.5 * (low + high)
    corner = outer == 3
    toward = (middle - x[corner]) / np.linalg.norm(middle - x[corner], axis=1, keepdims=True)
    np.testing.assert_allclose(found.inward[corner], toward, atol=1e-6)


def test_faces_that_share_no_vertices_have_edges() -> None:
    box = cube()
    triangles = np.asarray(box.triangles)
    points = np.asarray(box.points, float)[triangles].reshape(-1, 3)
    _, x = points_of(points, np.arange(len(points)).reshape(-1, 3), 10.0)
    assert len(x) == 8


def test_a_hollow_has_no_corners_and_a_ball_neither() -> None:
    """A cube seen from inside is concave everywhere."""
    box = cube()
    assert not SharpFeatures(
        np.asarray(box.points, float), np.asarray(box.triangles)[:, ::-1], 0.1
    ).any
    ball = sphere()
    assert not SharpFeatures(np.asarray(ball.points, float), np.asarray(ball.triangles), 0.1).any


def test_the_tip_of_a_cone_is_a_corner_though_no_edge_at_it_is_sharp() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rim = np.stack([0.3 * np.cos(turn), np.zeros(24), -0.3 * np.sin(turn)], 1)
    points = np.concatenate([rim, [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]])
    k = np.arange(24)
    after = (k + 1) % 24
    triangles = np.concatenate(
        [np.stack([k, after, 24 + 0 * k], 1), np.stack([after, k, 25 + 0 * k], 1)]
    )
    found, x = points_of(points, triangles, 10.0)
    tip = x[:, 1] > 0.5
    assert tip.sum() == 1
    np.testing.assert_allclose(found.inward[tip], [[0.0, -1.0, 0.0]], atol=1e-6)
    assert len(x) == 25


@pytest.mark.parametrize("axis", range(3))
def test_only_points_in_the_box_are_found_and_they_keep_their_keys(axis: int) -> None:
    box = cube()
    whole, x = points_of(box.points, box.triangles, 0.05)
    low, high = EVERYWHERE[0].copy(), EVERYWHERE[1].copy()
    low[axis], high[axis] = np.quantile(x[:, axis], [0.4, 0.7])
    some, y = points_of(box.points, box.triangles, 0.05, (low, high))
    inside = (x[:, axis] >= low[axis]) & (x[:, axis] <= high[axis])
    assert 0 < len(y) < len(x)
    assert set(some.key) == set(whole.key[inside])
    at = {int(k): place for k, place in zip(whole.key, x)}
    np.testing.assert_array_equal(y, [at[int(k)] for k in some.key])
