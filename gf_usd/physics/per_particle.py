"""Kernels over the particles of a frame: rotation, singular values, radiance.

The particles are shared among threads and their values stay in registers; in NumPy, each of some
two hundred array operations would be limited by memory, on one core. Double precision, except for
the radiance coefficients.
"""

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.matrices import signed_polar
from gf_usd.core.radiance import DIRECTIONS, INVERSES, terms
from gf_usd.physics.laws.simd3x3 import (
    at,
    cofactor,
    determinant,
    double_dot,
    let,
    product,
    put,
    transposed,
    unrolled,
)
from gf_usd.physics.taichi_arrays import on_arrays
from gf_usd.system.taichi_runtime import ensure_running, ensure_taichi, import_taichi

ti = import_taichi()

NEWTON = 12  # iterations for the polar decomposition, enough for stretches of 1/100 to 100
LANES = 4  # particles at once, the width of SIMD vectors
SETTLED = 1e-9  # change below which an iterate is converged to rounding

Many = ti.types.ndarray(dtype=ti.f64, ndim=1)
Flags = ti.types.ndarray(dtype=ti.i32, ndim=1)


def nearest_rotation(F: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) R of the polar decomposition with det R = 1, as from the signed SVD.

    Newton's iteration Q <- (Q + Q^-T) / 2 (Higham 1986) is several times as fast as the SVD, which
    is used where F is inverted or nearly singular.
    """
    ensure_running()
    R, done = np.empty(F.shape), np.zeros(len(F), np.int32)
    _rotations(_flat(F), R.reshape(-1), done)
    left = done == 0
    if left.any():
        R[left] = signed_polar(F[left])
    return R


def strains(F: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Singular values (N, 3), ascending, and determinants (N,) of F (N, 3, 3).

    Square roots of the eigenvalues of F^T F by the closed form for symmetric 3x3 matrices (Smith
    1961), with an error of about 1e-8 of the largest; without its arc cosine, which has no SIMD
    instruction.
    """
    ensure_running()
    s, J = np.empty((len(F), 3)), np.empty(len(F))
    _stretches(_flat(F), s.reshape(-1), J)
    return s, J


def _flat(values: Floats) -> NDArray[np.float64]:
    return np.ascontiguousarray(values, float).reshape(-1)


@unrolled
def matrix(values, p):
    """Matrix p of an array, nine values row by row."""
    return [let(at(values, 9 * p + a)) for a in range(9)]


@unrolled
def keep(values, p, A):
    """Store A in the layout of `matrix`."""
    for a in range(9):
        put(at(values, 9 * p + a), A[a])


@on_arrays
@ti.kernel
def _rotations(F: Many, R: Many, done: Flags):
    """R of the polar decomposition of each F where `done`: see `nearest_rotation`."""
    for p in range(done.shape[0]):
        Q = matrix(F, p)
        settled = 0
        if determinant(Q, cofactor(Q)) > 0.0:
            step = 0
            while step < NEWTON and settled == 0:
                C = cofactor(Q)
                if newton(Q, C, determinant(Q, C)) < SETTLED:
                    settled = 1
                step += 1
        done[p] = settled
        keep(R, p, Q)


@unrolled
def newton(Q, C, J):
    """Q <- (Q + C / J) / 2; the largest change of an entry."""
    half, largest = let(0.5 / J), None
    for a in range(9):
        new = let(0.5 * Q[a] + half * C[a])
        change = ti.abs(new - Q[a])
        largest = let(change if largest is None else ti.max(largest, change))
        put(Q[a], new)
    return largest


@on_arrays
@ti.kernel
def _stretches(F: Many, s: Many, J: Many):
    """Singular values, ascending, and det F, of LANES particles at once: see `strains`."""
    count = J.shape[0]
    for g in range((count + LANES - 1) // LANES):
        A = lanes_of(F, g, count)
        size = determinant(A, cofactor(A))
        D = product(transposed(A), A)
        q = (D[0] + D[4] + D[8]) / 3.0
        r = scaled_deviator(D, q)
        cosine = determinant(D, cofactor(D)) / 2.0
        # D and -D have opposite eigenvalues: the angle for |cosine| is at most 30 degrees
        along = cosine_of_third(ti.select(cosine < 0.0, 0.0 - cosine, cosine))
        # 2 cos(angle - 2 pi / 3), with sqrt(3), of which a literal would have single precision only
        across = along + ti.sqrt(3.0 * ti.max((1.0 - along) * (1.0 + along), 0.0))
        up = ti.select(cosine < 0.0, across, 2.0 * along)
        down = ti.select(cosine < 0.0, 2.0 * along, across)
        low, high = q - r * down, q + r * up
        first, middle, last = root(low), root(3.0 * q - high - low), root(high)
        for lane in ti.static(range(LANES)):
            p = g * LANES + lane
            if p < count:
                J[p] = size[lane]
                s[3 * p] = first[lane]
                s[3 * p + 1] = middle[lane]
                s[3 * p + 2] = last[lane]


@ti.func
def lanes_of(values: ti.template(), g, count):
    """Matrices of group g of an array of `count`, nine lane vectors; the last is repeated."""
    o = [9 * ti.min(LANES * g + lane, count - 1) for lane in ti.static(range(LANES))]
    return [
        ti.Vector([values[o[k] + a] for k in ti.static(range(LANES))]) for a in ti.static(range(9))
    ]


@ti.func
def cosine_of_third(y):
    """x = cos(arccos(y) / 3) of y from 0 to 1, at most 1; NaN stays NaN.

    Newton's iteration for 4 x^3 - 3 x = y, whose slope is 6 to 9, from a cubic within 3e-4.
    """
    y = ti.select(y > 1.0, y / y, y)
    x = 0.8660254 + y * (0.1666667 - y * (0.0425206 - y * 0.0098285))
    for _ in ti.static(range(3)):
        x = x - ((4.0 * x * x - 3.0) * x - y) / (12.0 * x * x - 3.0)
    return ti.select(x > 1.0, x / x, x)


@unrolled
def scaled_deviator(D, q):
    """D <- (D - q) / r, and r = |D - q| / sqrt(6); where r is 0 D is left 0."""
    for a in (0, 4, 8):
        put(D[a], D[a] - q)
    r = let(ti.sqrt(double_dot(D, D) / 6.0))
    inverse = let(1.0 / ti.select(r > 0.0, r, 0.0 * r + 1.0))
    for a in range(9):
        put(D[a], D[a] * inverse)
    return r


@unrolled
def root(x):
    """sqrt(x), 0 where rounding made x negative; NaN stays NaN."""
    x = let(x)
    return ti.sqrt(ti.select(x < 0.0, 0.0 * x, x))


_terms = ti.func(terms)
F32_2, F32_3 = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (2, 3))

# (10, 15) contribution of each direction to each coefficient above degree 0
GIVES = np.ascontiguousarray(np.concatenate(INVERSES, axis=0).T, np.float32)
VIEW_DIRECTIONS = np.ascontiguousarray(DIRECTIONS, np.float32)


def rotated(harmonics: NDArray[np.float32], rotations: Floats) -> NDArray[np.float32]:
    """Spherical harmonic coefficients (N, (d + 1)^2, 3) rotated by (N, 3, 3), degree d from 1 to 3.

    In single precision: see `gf_usd.core.radiance`.
    """
    ensure_taichi()
    out = np.zeros(harmonics.shape, np.float32)
    out[:, 0] = harmonics[:, 0]
    turn = np.ascontiguousarray(rotations, np.float32)
    _turn(np.ascontiguousarray(harmonics, np.float32), turn, VIEW_DIRECTIONS, GIVES, out,
          round(harmonics.shape[1] ** 0.5) - 1)  # fmt: skip
    return out


@ti.kernel
def _turn(h: F32_3, turn: F32_3, looks: F32_2, gives: F32_2, out: F32_3, degrees: ti.template()):
    """h'_m = sum_j B^+_mj sum_k Y_k(R^T d_j) h_k, degree by degree."""
    for i in range(h.shape[0]):
        for j in range(looks.shape[0]):
            a, b, c = looks[j, 0], looks[j, 1], looks[j, 2]
            x = a * turn[i, 0, 0] + b * turn[i, 1, 0] + c * turn[i, 2, 0]
            y = a * turn[i, 0, 1] + b * turn[i, 1, 1] + c * turn[i, 2, 1]
            z = a * turn[i, 0, 2] + b * turn[i, 1, 2] + c * turn[i, 2, 2]
            Y = _terms(x, y, z)
            for degree in ti.static(range(1, degrees + 1)):
                for channel in ti.static(range(3)):
                    seen = 0.0
                    for k in ti.static(range(degree * degree, (degree + 1) * (degree + 1))):
                        seen += Y[k] * h[i, k, channel]
                    for k in ti.static(range(degree * degree, (degree + 1) * (degree + 1))):
                        out[i, k, channel] += gives[j, k - 1] * seen
