"""The surface of Gaussians and how far a mesh is from it, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from random_turns import random_turns

from gf_usd.core.errors import InputError
from tools.paper.drift import density, distances, drift, isosurface, kernel_axes

LEVEL = 0.43
# One Gaussian has rho = level where |x| = sigma sqrt(-2 ln level).
SHELL = np.sqrt(-2.0 * np.log(LEVEL))


def test_one_gaussian_is_an_ellipsoid() -> None:
    axes = np.diag([0.1, 0.2, 0.4])[None]
    at = np.array([[5.0, -3.0, 1.0]])
    points, triangles = isosurface(at, axes, level=LEVEL)
    q = ((points - at) / [0.1, 0.2, 0.4]) ** 2
    # linear interpolation between corners a cell (2.4 / 64) apart, of a curved profile
    np.testing.assert_allclose(np.sqrt(q.sum(1)), SHELL, rtol=0.08)
    assert np.abs(np.sqrt(q.sum(1)) - SHELL).mean() < 0.02
    assert len(triangles) > 100


def test_density_adds_up_and_turns_with_its_axes() -> None:
    R = random_turns(1, 1)[0]
    axes = np.stack([R @ np.diag([0.1, 0.2, 0.3]), np.eye(3)])
    at = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    X = np.array([R @ [0.1, 0.0, 0.0], [1.0, 1.0, 0.0]])
    d = X[1] @ R / [0.1, 0.2, 0.3]
    expected = [
        np.exp(-0.5) + np.exp(-0.5 * ((X[0] - at[1]) ** 2).sum()),
        np.exp(-0.5 * d @ d) + np.exp(-0.5),
    ]
    # beyond four deviations a Gaussian is left out: 3e-4
    np.testing.assert_allclose(density(X, at, axes), expected, atol=4e-4)


def test_finer_cells_come_nearer() -> None:
    axes = 0.2 * np.eye(3)[None]
    error = []
    for resolution in (16, 32, 64):
        points, _ = isosurface(np.zeros((1, 3)), axes, level=LEVEL, resolution=resolution)
        error.append(np.abs(np.linalg.norm(points, axis=1) - 0.2 * SHELL).mean())
    # second order: a quarter each, with room for where the corners happen to lie
    assert error[1] < 0.4 * error[0]
    assert error[2] < 0.4 * error[1]
    assert error[2] < 1e-3 * 1.6


def test_a_level_that_is_never_reached_is_refused() -> None:
    with pytest.raises(InputError, match="nowhere"):
        isosurface(np.zeros((1, 3)), 0.1 * np.eye(3)[None], level=1.5)


def test_the_kernel_stretches_with_the_body() -> None:
    F = np.diag([1.0, 0.5, 2.0])[None]
    A = kernel_axes(F, np.eye(3)[None], 2.0)
    np.testing.assert_allclose(A[0], np.diag([0.612, 0.612, 2.448]))


def test_its_widths_are_those_of_the_paper_for_its_ball() -> None:
    spacing = np.cbrt(4.0 / 3.0 * np.pi / 120)
    A = kernel_axes(np.eye(3)[None], np.eye(3)[None], spacing)
    np.testing.assert_allclose(np.diag(A[0]), [0.1, 0.2, 0.2], rtol=2e-3)


@pytest.mark.slow
def test_distances_are_exact_and_drift_is_their_mean() -> None:
    pytest.importorskip(
        "open3d", reason="open3d or its libraries are missing", exc_type=ImportError
    )
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) + 1e4
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    X = np.array([[0.3, 0.6, 0.25], [2.0, 0.5, 0.0], [0.5, 0.5, 0.0]]) + 1e4
    np.testing.assert_allclose(distances(X, square, triangles), [0.25, 1.0, 0.0], atol=1e-6)
    ball = np.zeros((1, 3))
    mesh = SHELL * 0.2 * random_turns(50, 0)[:, 0]
    spacing = 0.2 / 0.612
    seen = drift(1.5 * mesh, ball, np.eye(3)[None], np.eye(3)[None], spacing, level=LEVEL)
    # across it is a shell of .2, along axis 0 half as far: the gap is half a shell at least
    assert seen.largest >= seen.mean > 0.25 * 0.2 * SHELL
    assert len(seen.distances) == 50
