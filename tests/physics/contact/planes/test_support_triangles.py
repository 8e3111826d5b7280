"""Three samples that carry a plane: their weights, and how they turn."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.planes.support_triangles import (
    FAT,
    NEAR,
    SPREAD,
    SupportTriangles,
    spin,
)


def sheet(seed: int = 0) -> Floats:
    """Points (200, 3) of a square in the plane z = 0, some .1 apart."""
    points = np.random.default_rng(seed).random((200, 3)) * [1.4, 1.4, 0.0]
    return points - [0.2, 0.2, 0.0]


def test_weights_are_barycentric_and_the_largest_comes_first() -> None:
    X = sheet()
    places = np.random.default_rng(1).random((50, 3)) * [1.0, 1.0, 0.0]
    samples, weights = SupportTriangles(X)(places)
    np.testing.assert_allclose(weights.sum(1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nk,nka->na", weights, X[samples]), places, atol=1e-12)
    assert (np.diff(weights, axis=1) <= 0.0).all()
    assert np.abs(weights).max() < 2.0
    corners = X[samples]
    sides = corners - np.roll(corners, 1, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    assert (2.0 * 3.0**0.5 * area > FAT * (sides**2).sum((1, 2))).all()


def test_of_the_six_nearest_the_triangle_that_costs_least_carries() -> None:
    rng = np.random.default_rng(4)
    X, places = rng.normal(size=(40, 3)), rng.normal(size=(30, 3))
    samples, weights = SupportTriangles(X)(places)
    for place, got, w in zip(places, samples, weights):
        near = np.argsort(np.linalg.norm(X - place, axis=1))[:NEAR]
        least = np.inf
        for corners in map(list, combinations(near, 3)):
            a, b, c = X[corners]
            plane = np.stack([b - a, c - a], 1)
            st = np.linalg.lstsq(plane, place - a, rcond=None)[0]
            share = np.array([1.0 - st.sum(), *st])
            far = np.linalg.norm(X[corners] - place, axis=1)
            height = np.linalg.norm(a + plane @ st - place)
            area = np.linalg.norm(np.cross(b - a, c - a))
            sides = sum(((p - q) ** 2).sum() for p, q in ((a, b), (b, c), (c, a)))
            fat = 2.0 * 3.0**0.5 * area / sides
            cost = np.abs(share) @ far + height + SPREAD * far.mean()
            cost /= fat if fat > FAT else 1e-3 * fat + 1e-12
            if cost < least:
                least, best = cost, dict(zip(corners, share))
        assert set(got) == set(best)
        np.testing.assert_allclose(w, [best[s] for s in got], atol=1e-9)


def test_a_sample_carries_its_own_place() -> None:
    X = sheet()
    samples, weights = SupportTriangles(X)(X[:20])
    np.testing.assert_array_equal(samples[:, 0], np.arange(20))
    np.testing.assert_allclose(weights, np.tile([1.0, 0.0, 0.0], (20, 1)), atol=1e-12)


def test_two_samples_let_one_carry() -> None:
    samples, weights = SupportTriangles(np.eye(3)[:2])(np.array([[0.9, 0.2, 0.0]]))
    np.testing.assert_array_equal(samples, [[0, 0, 0]])
    np.testing.assert_array_equal(weights, [[1.0, 0.0, 0.0]])


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_three_points_that_turn_as_one_say_how_fast(scale: float) -> None:
    rng = np.random.default_rng(2)
    x, omega, along = (
        scale * rng.normal(size=(9, 3, 3)),
        rng.normal(size=(9, 3)),
        rng.normal(size=3),
    )
    v = np.cross(omega[:, None], x) + along
    np.testing.assert_allclose(spin(x, v), omega, atol=1e-9)


def test_points_in_line_do_not_turn() -> None:
    x = np.outer([0.0, 1.0, 3.0], [1.0, 2.0, 0.5])[None]
    np.testing.assert_array_equal(spin(x, np.random.default_rng(3).normal(size=(1, 3, 3))), 0.0)
