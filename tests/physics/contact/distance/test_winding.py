"""Signed distance to surfaces that are whole, and to those that a crash turned inside out."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.distance.closest import closest
from gf_usd.physics.contact.distance.winding import crossings, outside_by_winding, shell


def sphere() -> tuple[Floats, Ints]:
    points, triangles = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0],
                                  [0, 0, -1]], float), np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )  # fmt: skip
    points, triangles = igl.upsample(points, triangles, 4)
    return points / np.linalg.norm(points, axis=1, keepdims=True), triangles


def through_itself() -> tuple[Floats, Ints]:
    """A sphere whose top was pushed out through its bottom: a lobe that is inside out."""
    points, triangles = sphere()
    points[:, 2] -= 3.0 * np.clip((points[:, 2] - 0.5) / 0.2, 0.0, 1.0)
    return points, triangles


def test_a_lobe_that_is_inside_out_is_met_from_outside() -> None:
    points, triangles = through_itself()
    X = np.array([[0.0, 0.0, z] for z in (-2.1, -2.3)])  # under it
    seen = closest(X, points, triangles, 0.5)
    assert (seen.gap < 0.0).all()  # what the nearest triangle alone says
    healed = outside_by_winding(seen, np.flatnonzero(seen.gap < 0.0), X, points, triangles)
    away = X[seen.rows] - healed.point
    distance = np.linalg.norm(away, axis=1)
    assert healed.gap == pytest.approx(distance, rel=1e-12)
    assert healed.normal == pytest.approx(away / distance[:, None], abs=1e-9)


def test_a_whole_surface_keeps_its_signs() -> None:
    points, triangles = sphere()
    X = np.random.default_rng(0).uniform(-1.2, 1.2, (300, 3))
    seen = closest(X, points, triangles, 0.5)
    healed = outside_by_winding(seen, np.flatnonzero(seen.gap < 0.0), X, points, triangles)
    assert (seen.gap < 0.0).sum() > 50
    assert np.array_equal(healed.gap, seen.gap)
    assert np.array_equal(healed.normal, seen.normal)


def test_a_ray_counts_how_often_a_shell_winds() -> None:
    for points, triangles in (sphere(), through_itself()):
        kept = shell(points, triangles)
        assert kept is not None
        X = np.random.default_rng(1).uniform(-2.6, 1.2, (500, 3)) * [0.4, 0.4, 1.0]
        X = np.concatenate([X, 0.5 * points[:50]])  # rays through vertices and edges, too
        expected = igl.fast_winding_number(points, triangles, X)
        counted = crossings(X, points[kept[0]], kept[1])
        sure = np.abs(expected - np.round(expected)) < 0.05
        assert sure.sum() > 400
        assert np.array_equal(counted[sure], np.round(expected[sure]))
    assert set(counted.tolist()) >= {-1, 0, 1}


def test_a_shell_has_no_borders() -> None:
    points, triangles = sphere()
    assert shell(points, triangles[1:]) is None
    # A seam whose vertices are there twice is no border.
    seam = np.concatenate([points, points[:5]])
    doubled = triangles.copy()
    doubled[::2] = np.where(doubled[::2] < 5, doubled[::2] + len(points), doubled[::2])
    kept = shell(seam, doubled)
    assert kept is not None
    assert len(kept[0]) == len(points)
    turned = triangles.copy()
    turned[0] = turned[0, ::-1]
    assert shell(points, turned) is None


def test_a_ray_along_edges_and_through_corners_crosses_once() -> None:
    """A cube with its corners on whole numbers: rays meet edges, corners and whole faces."""
    points = np.array([[x, y, z] for x in (0, 2) for y in (0, 2) for z in (0, 2)], float)
    triangles = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
         [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    kept = shell(points, triangles)
    assert kept is not None
    inside = np.array([[1.0, 1.0, 1.0], [0.5, 0.25, 0.25], [1.5, 1.5, 1.5]])  # on the diagonals
    outside = np.array([[-1.0, 1.0, 1.0], [-1.0, 0.5, 0.5], [3.0, 1.0, 1.0], [-1.0, 3.0, 1.0]])
    way = 1 if np.array_equal(crossings(inside, points[kept[0]], kept[1]), [1, 1, 1]) else -1
    assert np.array_equal(crossings(inside, points[kept[0]], kept[1]), [way] * 3)
    assert np.array_equal(crossings(outside, points[kept[0]], kept[1]), [0] * 4)
