"""Real spherical harmonics to degree 3, in the order and signs of 3D Gaussian splats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.colour import srgb_to_linear
from gf_usd.model import Floats
from gf_usd.scene import Harmonics

DEGREE = 3  # the highest that is evaluated; more of a file's coefficients are left out


def basis(directions: Floats) -> NDArray[np.float64]:
    """Y (N, 16) at unit directions (N, 3), with the Condon-Shortley phase (-1)^m.

    Normalised so that the integral of Y_i Y_j over the sphere is 1 where i = j and 0 elsewhere.
    """
    x, y, z = np.asarray(directions, dtype=np.float64).T
    pi = np.pi
    terms = [
        np.full_like(x, 0.5 * np.sqrt(1 / pi)),
        -np.sqrt(3 / (4 * pi)) * y,
        np.sqrt(3 / (4 * pi)) * z,
        -np.sqrt(3 / (4 * pi)) * x,
        0.5 * np.sqrt(15 / pi) * x * y,
        -0.5 * np.sqrt(15 / pi) * y * z,
        0.25 * np.sqrt(5 / pi) * (3 * z * z - 1),
        -0.5 * np.sqrt(15 / pi) * x * z,
        0.25 * np.sqrt(15 / pi) * (x * x - y * y),
        -0.25 * np.sqrt(35 / (2 * pi)) * y * (3 * x * x - y * y),
        0.5 * np.sqrt(105 / pi) * x * y * z,
        -0.25 * np.sqrt(21 / (2 * pi)) * y * (5 * z * z - 1),
        0.25 * np.sqrt(7 / pi) * z * (5 * z * z - 3),
        -0.25 * np.sqrt(21 / (2 * pi)) * x * (5 * z * z - 1),
        0.25 * np.sqrt(105 / pi) * z * (x * x - y * y),
        -0.25 * np.sqrt(35 / (2 * pi)) * x * (x * x - 3 * y * y),
    ]
    return np.stack(terms, axis=1)


def seen_from(harmonics: Harmonics, towards: Floats) -> NDArray[np.floating]:
    """Linear colour (N, 3) = 0.5 + sum_k c_k Y_k(d) of splats seen along `towards` (N, 3)."""
    local = towards @ np.asarray(harmonics.frame).T
    local = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    used = min(harmonics.coefficients.shape[1], (DEGREE + 1) ** 2)
    weights = basis(local)[:, :used]
    value = 0.5 + np.einsum("nk,nkc->nc", weights, harmonics.coefficients[:, :used])
    value = np.maximum(value, 0.0)
    return srgb_to_linear(value) if harmonics.srgb else value
