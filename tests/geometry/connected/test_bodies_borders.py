"""Weights of the parts of a surface, inside of it."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.geometry.connected.bodies import part_weights, smoothstep

WIDTH = 0.4


def box(low: float, high: float, cap: int) -> tuple[np.ndarray, np.ndarray]:
    """The walls of a beam of section 1 x 1 between two x, and its cap at one end (0 or 1)."""
    square = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    points = np.array([(x, *yz) for x in (low, high) for yz in square])
    faces = []
    for k in range(4):
        a, b = k, (k + 1) % 4
        faces += [(a, b, b + 4), (a, b + 4, a + 4)]
    first = 4 * cap
    faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return points, np.array(faces)


def inside(n: int = 4000) -> np.ndarray:
    return np.random.default_rng(3).uniform([-3, -0.5, -0.5], [3, 0.5, 0.5], (n, 3))


PARTS = [box(-3.0, 0.0, 0), box(0.0, 3.0, 1)]


def test_the_weights_of_every_point_add_up_to_one():
    three = [box(-3.0, -0.1, 0), box(-0.1, 0.1, 0), box(0.1, 3.0, 1)]
    for parts in (PARTS, three):
        w = part_weights(inside(), parts, WIDTH)
        assert (w >= 0.0).all()
        # sums of at most three doubles of size 1
        np.testing.assert_allclose(w.sum(1), 1.0, rtol=0.0, atol=1e-15)


def test_the_width_is_the_same_at_any_depth_and_the_weights_rise_across_it():
    X = inside()
    w = part_weights(X, PARTS, WIDTH)[:, 1]
    # d^2 cancels to 1e-16 of the square of a length of 3, over twice the way to the border: for
    # points 1e-4 from it, 1e-11 of the width; S has the slope 3/2 at most
    far = np.abs(X[:, 0]) > 1e-4
    np.testing.assert_allclose(w[far], smoothstep(0.5 + X[far, 0] / WIDTH), rtol=0.0, atol=1e-10)
    assert (np.diff(w[np.argsort(X[:, 0])]) > -1e-10).all()
    assert (w[X[:, 0] < -0.5 * WIDTH - 1e-9] == 0.0).all()
    assert (w[X[:, 0] > 0.5 * WIDTH + 1e-9] == 1.0).all()


def test_a_wider_border_mixes_more():
    X = inside()
    mixed = [((w := part_weights(X, PARTS, width)[:, 0]) * (1 - w)).sum() for width in (0.2, 0.4)]
    # where both lie inside the beam, the mixed share of it is in proportion to the width; its
    # 4000 random points hold some 130 of the narrow one: 1 / sqrt(130) = .09, three times that
    assert mixed[1] / mixed[0] == pytest.approx(2.0, rel=0.27)


def test_one_part_has_all_the_weight():
    assert (part_weights(inside(10), PARTS[:1], WIDTH) == 1.0).all()


def test_points_on_the_border_itself_have_half_of_each():
    X = np.array([[0.0, 0.5, 0.1], [0.0, 0.2, 0.1]])
    np.testing.assert_allclose(part_weights(X, PARTS, WIDTH), 0.5, atol=1e-12)
