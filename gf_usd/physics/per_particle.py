# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""What a frame asks of every particle, as kernels: rotation, stretches, Gaussian, radiance.

A particle stays in registers and threads share the particles; with arrays in NumPy each of some two
hundred operations would walk through memory, on one core.  In double precision, but for the
coefficients of radiance.
"""

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.radiance import DIRECTIONS, INVERSES, terms
from gf_usd.system.taichi_runtime import ensure_running, ensure_taichi, import_taichi

ti = import_taichi()

NEWTON = 12  # steps of the polar iteration, enough for stretches of 1/100 to 100
SETTLED = 1e-9  # change after which an iterate is exact to rounding
SWEEPS = 6  # Jacobi converges quadratically: f64 digits are used up well before

Many = ti.types.ndarray(dtype=ti.f64, ndim=1)
Flags = ti.types.ndarray(dtype=ti.i32, ndim=1)


def nearest_rotation(F: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) R of the polar decomposition with det R = 1: that of the signed SVD.

    By Newton's iteration Q <- (Q + Q^-T) / 2 (Higham 1986), several times as fast; by the SVD
    itself where F is inverted, or so flat that the iteration would take long.
    """
    ensure_running()
    R, done = np.empty(F.shape), np.zeros(len(F), np.int32)
    _rotations(_flat(F), R.reshape(-1), done)
    left = done == 0
    if left.any():
        U, _, Vt = np.linalg.svd(F[left])
        U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
        R[left] = U @ Vt
    return R


def strains(F: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Singular values (N, 3), ascending, and determinants (N,) of F (N, 3, 3).

    Square roots of the eigenvalues of F^T F by the closed form for symmetric 3x3 matrices (Smith
    1961), which is exact to about 1e-8 of the largest.
    """
    ensure_running()
    s, J = np.empty((len(F), 3)), np.empty(len(F))
    _stretches(_flat(F), s.reshape(-1), J)
    return s, J


def carried(
    F: Floats, rest: Floats, R: Floats, turn: Floats, axes: Floats, last: Floats
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Axes (N, 3, 3), quaternions (N, 4) and scales (N, 3) of Gaussians after a frame.

    F, and R its rotations; rest : Q0 diag(s0); turn, axes (N, 3, 3), last (N, 4): of the frame
    before.
    """
    ensure_running()
    axes_now, q, scales = np.empty(F.shape), np.empty((len(F), 4)), np.empty((len(F), 3))
    given = (_flat(a) for a in (F, rest, R, turn, axes, last))
    made = (a.reshape(-1) for a in (axes_now, q, scales))
    _carry(*given, *made, len(F))
    return axes_now, q, scales


def _flat(values: Floats) -> NDArray[np.float64]:
    return np.ascontiguousarray(values, float).reshape(-1)


@ti.func
def matrix(values: ti.template(), p):
    """Matrix p of many, row by row."""
    return ti.Matrix(
        [[values[9 * p + 3 * a + b] for b in ti.static(range(3))] for a in ti.static(range(3))]
    )


@ti.func
def keep(values: ti.template(), p, A):
    for a, b in ti.static(ti.ndrange(3, 3)):
        values[9 * p + 3 * a + b] = A[a, b]


@ti.func
def cofactor(A):
    return ti.Matrix(
        [
            [
                A[(a + 1) % 3, (b + 1) % 3] * A[(a + 2) % 3, (b + 2) % 3]
                - A[(a + 1) % 3, (b + 2) % 3] * A[(a + 2) % 3, (b + 1) % 3]
                for b in ti.static(range(3))
            ]
            for a in ti.static(range(3))
        ]
    )


@ti.func
def first_row(A, B):
    """A00 B00 + A01 B01 + A02 B02: the determinant of A where B is its cofactor."""
    return A[0, 0] * B[0, 0] + A[0, 1] * B[0, 1] + A[0, 2] * B[0, 2]


@ti.func
def root(x):
    """sqrt(x), 0 where rounding made x negative; what is no number stays none."""
    return ti.sqrt(ti.select(x < 0.0, 0.0 * x, x))


@ti.func
def within(x):
    """x in [-1, 1]."""
    return ti.select(x > 1.0, x / x, ti.select(x < -1.0, 0.0 - x / x, x))


@ti.kernel
def _rotations(F: Many, R: Many, done: Flags):
    """R of the polar decomposition of each F where `done`: see `nearest_rotation`."""
    for p in range(done.shape[0]):
        Q = matrix(F, p)
        settled = 0
        if first_row(Q, cofactor(Q)) > 0.0:
            step = 0
            while step < NEWTON and settled == 0:
                C = cofactor(Q)
                J = first_row(Q, C)
                new = 0.5 * (Q + C / J)
                change = new - Q
                largest = 0.0 * J
                for a, b in ti.static(ti.ndrange(3, 3)):
                    largest = ti.max(largest, ti.abs(change[a, b]))
                if largest < SETTLED:
                    settled = 1
                Q = new
                step += 1
        done[p] = settled
        keep(R, p, Q)


@ti.kernel
def _stretches(F: Many, s: Many, J: Many):
    """Singular values, ascending, and det F: see `strains`."""
    for p in range(J.shape[0]):
        A = matrix(F, p)
        J[p] = first_row(A, cofactor(A))
        C = A.transpose() @ A
        q = (C[0, 0] + C[1, 1] + C[2, 2]) / 3.0
        D = C
        size = 0.0 * q
        for a in ti.static(range(3)):
            D[a, a] = D[a, a] - q
        for a, b in ti.static(ti.ndrange(3, 3)):
            size += D[a, b] * D[a, b]
        r = ti.sqrt(size / 6.0)
        if r > 0.0:
            D = D / r
        cosine = within(first_row(D, cofactor(D)) / 2.0)
        angle = ti.acos(cosine) / 3.0
        # cos(angle + 2 pi / 3), of which a literal would have single precision only
        along, across = ti.cos(angle), ti.sqrt(0.0 * angle + 3.0) * ti.sin(angle)
        high = q + 2.0 * r * along
        low = q - r * (along + across)
        s[3 * p] = root(low)
        s[3 * p + 1] = root(3.0 * q - high - low)
        s[3 * p + 2] = root(high)


@ti.func
def quaternion(R):
    """Unit quaternion (w, x, y, z) of a rotation R."""
    a, b, c = R[0, 0], R[1, 1], R[2, 2]
    wx, wy, wz = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, xz, yz = R[1, 0] + R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2]
    w2, x2, y2, z2 = 1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c
    # The largest of four squared components is at least a quarter: divide by that one.
    q = ti.Vector([w2, wx, wy, wz])
    most = w2
    if x2 > most:
        most = x2
        q = ti.Vector([wx, x2, xy, xz])
    if y2 > most:
        most = y2
        q = ti.Vector([wy, xy, y2, yz])
    if z2 > most:
        q = ti.Vector([wz, xz, yz, z2])
    return q / q.norm()


@ti.func
def diagonalize(S):
    """Q^T S Q, diagonal, and Q, det Q = 1, near the identity, of a symmetric S."""
    Q = S * 0.0
    for a in ti.static(range(3)):
        Q[a, a] = 1.0
    # Below rounding an off-diagonal says nothing, and turning by it would be noise.
    least = 1e-14 * ti.max(S[0, 0] + S[1, 1] + S[2, 2], 1e-300)
    sweep = 0
    moved = 1
    while sweep < SWEEPS and moved == 1:
        moved = 0
        for p, q in ti.static(((0, 1), (0, 2), (1, 2))):
            off = S[p, q]
            if ti.abs(off) > least:
                moved = 1
                tau = (S[q, q] - S[p, p]) / (2.0 * off)
                sign = ti.select(tau >= 0.0, 1.0, -1.0)
                t = sign / (ti.abs(tau) + ti.sqrt(1.0 + tau * tau))
                c = 1.0 / ti.sqrt(1.0 + t * t)
                J = S * 0.0
                for a in ti.static(range(3)):
                    J[a, a] = 1.0
                J[p, p] = c
                J[q, q] = c
                J[p, q] = t * c
                J[q, p] = 0.0 - t * c
                S = J.transpose() @ S @ J
                Q = Q @ J
        sweep += 1
    return S, Q


@ti.kernel
def _carry(
    F: Many, rest: Many, R: Many, turn: Many, axes: Many, last: Many, new_axes: Many,
    new_last: Many, scales: Many, count: ti.i32,
):  # fmt: skip
    """A frame of `gaussians.GaussianTrack`, of which turn, axes and last are the state.

    rest : Q0 diag(s0); R : rotations of F, the next turn.
    """
    for p in range(count):
        A = matrix(F, p) @ matrix(rest, p)
        start = matrix(R, p) @ matrix(turn, p).transpose() @ matrix(axes, p)
        B = start.transpose() @ A
        S, spin = diagonalize(B @ B.transpose())
        Q = start @ spin
        keep(new_axes, p, Q)
        for a in ti.static(range(3)):
            scales[3 * p + a] = root(S[a, a])
        q = quaternion(Q)
        before = ti.Vector([last[4 * p + a] for a in ti.static(range(4))])
        sign = 1.0
        if q.dot(before) < 0.0:
            sign = -1.0
        for a in ti.static(range(4)):
            new_last[4 * p + a] = sign * q[a]


_terms = ti.func(terms)
F32_2, F32_3 = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (2, 3))

# (10, 15) what each direction gives to each coefficient above degree 0
GIVES = np.ascontiguousarray(np.concatenate(INVERSES, axis=0).T, np.float32)
LOOKS = np.ascontiguousarray(DIRECTIONS, np.float32)


def rotated(harmonics: NDArray[np.float32], rotations: Floats) -> NDArray[np.float32]:
    """Coefficients (N, (d + 1)^2, 3) turned by rotations (N, 3, 3), d from 1 to 3.

    In single precision: see `gf_usd.core.radiance`.
    """
    ensure_taichi()
    out = np.zeros(harmonics.shape, np.float32)
    out[:, 0] = harmonics[:, 0]
    turn = np.ascontiguousarray(rotations, np.float32)
    _turn(np.ascontiguousarray(harmonics, np.float32), turn, LOOKS, GIVES, out,
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
