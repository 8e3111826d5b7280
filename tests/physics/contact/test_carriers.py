"""Three samples that carry a plane: their weights, and how they turn."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.carriers import FAT, Triples, spin, triangle


def sheet(seed: int = 0) -> Floats:
    """Points (200, 3) of a square in the plane z = 0, some .1 apart."""
    points = np.random.default_rng(seed).random((200, 3)) * [1.4, 1.4, 0.0]
    return points - [0.2, 0.2, 0.0]


def test_weights_are_barycentric_and_the_largest_comes_first() -> None:
    X = sheet()
    places = np.random.default_rng(1).random((50, 3)) * [1.0, 1.0, 0.0]
    samples, weights = Triples(X)(places)
    np.testing.assert_allclose(weights.sum(1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nk,nka->na", weights, X[samples]), places, atol=1e-12)
    assert (np.diff(weights, axis=1) <= 0.0).all()
    assert np.abs(weights).max() < 2.0
    assert (triangle(X[samples])[2] > FAT).all()


def test_a_sample_carries_its_own_place() -> None:
    X = sheet()
    samples, weights = Triples(X)(X[:20])
    np.testing.assert_array_equal(samples[:, 0], np.arange(20))
    np.testing.assert_allclose(weights, np.tile([1.0, 0.0, 0.0], (20, 1)), atol=1e-12)


def test_two_samples_let_one_carry() -> None:
    samples, weights = Triples(np.eye(3)[:2])(np.array([[0.9, 0.2, 0.0]]))
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
