"""Rotated spherical harmonics against the rotated function itself."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import lpmv

from gf_usd.core.radiance import DIRECTIONS, band, basis
from gf_usd.physics.per_particle import rotated

ROUNDING = 1e-13  # of sums of sixteen terms of size 1
SINGLE = 1e-5  # of sums of some hundred terms of size 1 in single precision


def directions(count, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_the_basis_is_that_of_splat_files():
    """Legendre functions with their phase (-1)^m: sqrt 2 times cos for m > 0, sin |m| for m < 0.

    The order l^2 + l + m, and every sign, is that of the constants in 3D Gaussian splatting.
    """
    x, y, z = directions(30).T
    around = np.arctan2(y, x)
    expected = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            size = factorial(degree - abs(m)) / factorial(degree + abs(m))
            size = np.sqrt((2 * degree + 1) / (4 * np.pi) * size) * (np.sqrt(2) if m else 1.0)
            wave = np.cos(m * around) if m >= 0 else np.sin(-m * around)
            expected.append(size * lpmv(abs(m), degree, z) * wave)
    np.testing.assert_allclose(basis(directions(30)).T, expected, atol=ROUNDING)
    # the first constants of each degree there, at (x, y, z)
    assert basis([[0.0, 1.0, 0.0]])[0, [1, 9]] == pytest.approx(
        [-0.4886025119029199, 0.5900435899266435]
    )


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_turned_coefficients_show_the_turned_function(degree):
    """c'(d) = c(R^T d), in directions that the matrices were not made from."""
    rng = np.random.default_rng(degree)
    turns = Rotation.random(40, random_state=degree).as_matrix()
    h = np.zeros((40, (degree + 1) ** 2, 3))
    h[:, band(degree)] = rng.normal(size=(40, 2 * degree + 1, 3))
    turned = rotated(h, turns)
    for d in directions(25, seed=degree):
        seen = basis(np.tile(d, (40, 1)))[:, : h.shape[1]]
        before = basis(np.einsum("nba,b->na", turns, d))[:, : h.shape[1]]
        np.testing.assert_allclose(
            np.einsum("nk,nkc->nc", seen, turned),
            np.einsum("nk,nkc->nc", before, h),
            atol=SINGLE,
        )


def test_no_turn_changes_nothing():
    h = np.random.default_rng(1).normal(size=(5, 16, 3))
    np.testing.assert_allclose(rotated(h, np.tile(np.eye(3), (5, 1, 1))), h, atol=SINGLE)


def test_two_turns_are_one():
    a, b = (Rotation.random(20, random_state=s).as_matrix() for s in (3, 4))
    h = np.random.default_rng(1).normal(size=(20, 16, 3))
    np.testing.assert_allclose(rotated(rotated(h, a), b), rotated(h, b @ a), atol=SINGLE)


def test_degree_1_turns_like_a_vector():
    """Y_1 is (-y, z, -x): its coefficients are a vector in that order and with those signs."""
    turns = Rotation.random(10, random_state=5).as_matrix()
    vector = np.random.default_rng(2).normal(size=(10, 3))
    h = np.zeros((10, 4, 3))
    h[:, 1:, 0] = np.stack([-vector[:, 1], vector[:, 2], -vector[:, 0]], axis=1)
    w = np.einsum("nab,nb->na", turns, vector)
    expected = np.stack([-w[:, 1], w[:, 2], -w[:, 0]], axis=1)
    np.testing.assert_allclose(rotated(h, turns)[:, 1:, 0], expected, atol=SINGLE)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_directions_tell_the_harmonics_apart(degree):
    """The matrices lose no more than one digit."""
    size = np.linalg.svd(basis(DIRECTIONS)[:, band(degree)], compute_uv=False)
    assert size[-1] > 0.4 * size[0]
