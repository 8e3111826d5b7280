"""How much particles are stretched: singular values and determinants of F."""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats
from gf_usd.physics import many
from gf_usd.physics.cofactor import entries

AFTER, LAST = [1, 2, 0], [2, 0, 1]  # of the columns of F that make C_23, C_31, C_12


def strains(F: Floats) -> tuple[Floats, Floats]:
    """Singular values (N, 3), ascending, and determinants (N,) of F (N, 3, 3)."""
    if many.serves(len(F)):
        return many.strains(F)
    q = entries(F)
    return _singular_values(q), _determinants(q)


def singular_values(F: Floats) -> Floats:
    """(N, 3) singular values, ascending: square roots of the eigenvalues of F^T F.

    The closed form for symmetric 3x3 matrices (Smith 1961), which is twenty times faster than a
    batched SVD and exact to about 1e-8 of the largest.
    """
    return many.strains(F)[0] if many.serves(len(F)) else _singular_values(entries(F))


def _determinants(q: Floats) -> Floats:
    minors = q[[4, 5, 3]] * q[[8, 6, 7]]
    minors -= q[[5, 3, 4]] * q[[7, 8, 6]]
    minors *= q[:3]
    return minors[0] + minors[1] + minors[2]


def _singular_values(q: Floats) -> Floats:
    """Of `entries` (9, N)."""
    one, two, three = q[:3], q[3:6], q[6:]
    squares = one * one + two * two + three * three  # diagonal of C = F^T F
    mixed = one[AFTER] * one[LAST] + two[AFTER] * two[LAST] + three[AFTER] * three[LAST]
    mean = (squares[0] + squares[1] + squares[2]) / 3.0
    squares -= mean
    sides = squares * squares + 2.0 * (mixed * mixed)
    p = np.sqrt((sides[0] + sides[1] + sides[2]) / 6.0)
    scale = 1.0 / np.where(p > 0.0, p, 1.0)
    squares *= scale
    mixed *= scale
    # det((C - mean) / p) / 2
    minors = squares * (mixed * mixed)
    cosine = 0.5 * (squares[0] * squares[1] * squares[2] - (minors[0] + minors[1] + minors[2]))
    cosine += mixed[0] * mixed[1] * mixed[2]
    angle = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0)) / 3.0
    p *= 2.0
    out = np.empty((q.shape[1], 3))
    out[:, 0] = low = mean + p * np.cos(angle + 2.0 * np.pi / 3.0)
    out[:, 2] = high = mean + p * np.cos(angle)
    out[:, 1] = 3.0 * mean - high - low
    return np.sqrt(np.maximum(out, 0.0, out=out), out=out)
