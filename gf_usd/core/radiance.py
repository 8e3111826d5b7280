"""Real spherical harmonics to degree 3, in the order and signs of 3D Gaussian splats.

A rotation mixes the coefficients of one degree among themselves.  The function of the rotated body
is c'(d) = c(R^T d), so that

    sum_k h'_k Y_k(d) = sum_k h_k Y_k(R^T d)   for all d of the sphere,

and h' = D_l(R) h with D_l = B^+ Y_l(R^T d_j), B = Y_l(d_j) at enough fixed directions d_j: the
equation holds at these, hence everywhere, because both sides are of degree l.

The sRGB transfer function (IEC 61966-2-1), both ways.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats

DEGREE = 3  # the highest that is evaluated
Y_0 = 0.28209479177387814  # the value of the harmonic of degree 0: sqrt(1 / 4 pi)
A = sqrt(3.0 / (4.0 * pi))
B = sqrt(15.0 / (4.0 * pi))
C = sqrt(5.0 / (16.0 * pi))
D = sqrt(35.0 / (32.0 * pi))
E = sqrt(105.0 / (16.0 * pi))
F = sqrt(21.0 / (32.0 * pi))
G = sqrt(7.0 / (16.0 * pi))


def terms(x, y, z):
    """Y_0 to Y_15 as polynomials of unit vectors, with the Condon-Shortley phase (-1)^m.

    A list, of arrays or in a kernel of numbers: hence no annotations, which Taichi would read.
    """
    return [
        Y_0 + 0.0 * x,
        -A * y,
        A * z,
        -A * x,
        B * x * y,
        -B * y * z,
        C * (3.0 * z * z - 1.0),
        -B * x * z,
        0.5 * B * (x * x - y * y),
        -D * y * (3.0 * x * x - y * y),
        2.0 * E * x * y * z,
        -F * y * (5.0 * z * z - 1.0),
        G * z * (5.0 * z * z - 3.0),
        -F * x * (5.0 * z * z - 1.0),
        E * z * (x * x - y * y),
        -D * x * (x * x - 3.0 * y * y),
    ]


def basis(directions: Floats) -> NDArray[np.float64]:
    """Y (N, 16) at unit directions (N, 3).

    Normalized so that the integral of Y_i Y_j over the sphere is 1 where i = j and 0 elsewhere.
    """
    x, y, z = np.asarray(directions, dtype=np.float64).T
    return np.stack(terms(x, y, z), axis=1)


def band(degree: int) -> slice:
    """The indices of the coefficients of one degree."""
    return slice(degree**2, (degree + 1) ** 2)


def _directions() -> NDArray[np.float64]:
    """Ten directions, no two opposite: the corners of a cube and of its golden rectangles."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    corners = [(1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]
    a, b = 1.0 / golden, golden
    edges = [(0, a, b), (0, a, -b), (a, b, 0), (a, -b, 0), (b, 0, a), (-b, 0, a)]
    points = np.array(corners + edges, dtype=float)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


# Half a dodecahedron: the least singular value of B over the largest is 1 for degrees 1 and 2 and
# 0.41 for degree 3, so that nothing is lost in the inverse.
DIRECTIONS = _directions()
INVERSES = tuple(np.linalg.pinv(basis(DIRECTIONS)[:, band(d)]) for d in range(1, DEGREE + 1))


def turned(coefficients: Floats, rotation: Floats) -> NDArray[np.float64]:
    """h' (N, K, 3) of the function that is turned by one rotation (3, 3), of h (N, K, 3).

    K = (degree + 1)^2 with a degree of 0 to 3; see the equations above.
    """
    h = np.array(coefficients, dtype=np.float64)
    Y = basis(DIRECTIONS @ np.asarray(rotation, dtype=np.float64))
    for degree in range(1, round(h.shape[1] ** 0.5)):
        D = INVERSES[degree - 1] @ Y[:, band(degree)]
        h[:, band(degree)] = np.einsum("jk,nkc->njc", D, h[:, band(degree)])
    return h


def srgb_to_linear(value: Floats) -> NDArray[np.floating]:
    """Linear light of encoded values, any shape: v / 12.92 below 0.04045, else a 2.4 power."""
    value = np.asarray(value)
    high = ((np.maximum(value, 0.0) + 0.055) / 1.055) ** 2.4
    return np.where(value <= 0.04045, value / 12.92, high)


def linear_to_srgb(value: Floats) -> NDArray[np.floating]:
    """Encoded values of linear light, any shape: the inverse of `srgb_to_linear`."""
    value = np.asarray(value)
    high = 1.055 * np.maximum(value, 0.0) ** (1.0 / 2.4) - 0.055
    return np.where(value <= 0.0031308, 12.92 * value, high)
