"""Signed distance to surfaces that are whole, and to those that a crash turned inside out."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.distance import closest, outside_where_unwound


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
    healed = outside_where_unwound(seen, np.flatnonzero(seen.gap < 0.0), X, points, triangles)
    away = X[seen.rows] - healed.point
    distance = np.linalg.norm(away, axis=1)
    assert healed.gap == pytest.approx(distance, rel=1e-12)
    assert healed.normal == pytest.approx(away / distance[:, None], abs=1e-9)


def test_a_whole_surface_keeps_its_signs() -> None:
    points, triangles = sphere()
    X = np.random.default_rng(0).uniform(-1.2, 1.2, (300, 3))
    seen = closest(X, points, triangles, 0.5)
    healed = outside_where_unwound(seen, np.flatnonzero(seen.gap < 0.0), X, points, triangles)
    assert (seen.gap < 0.0).sum() > 50
    assert np.array_equal(healed.gap, seen.gap)
    assert np.array_equal(healed.normal, seen.normal)
