"""Cofactors of many 3x3 matrices at once, in a few passes over arrays.

With the nine entries as rows, side by side over all matrices, every cofactor is the difference of
two products: four lookups and three operations, whatever their number.  A cross product for each
row costs a small body three times as much, all of it in calls.

The stretch U of the polar decomposition F = R U, and how fast it changes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats

# cof[k] = q[A[k]] q[B[k]] - q[C[k]] q[D[k]] of entries in the order of rows
A = np.array([4, 5, 3, 2, 0, 1, 1, 2, 0])
B = np.array([8, 6, 7, 7, 8, 6, 5, 3, 4])
C = np.array([5, 3, 4, 1, 2, 0, 2, 0, 1])
D = np.array([7, 8, 6, 8, 6, 7, 4, 5, 3])


def entries(F: Floats) -> Floats:
    """(9, n) of matrices (n, 3, 3): a copy, in one piece of memory."""
    return np.array(F.reshape(-1, 9).T, order="C")


def cofactors(q: Floats) -> Floats:
    """cof F = J F^-T as `entries`, (9, n), of entries (9, n)."""
    one, other = q[A], q[C]
    one *= q[B]
    other *= q[D]
    one -= other
    return one


HARD = 1e-6  # of tr(U)^3: beyond it the closed form would lose as many digits
AFTER, LAST = [2, 0, 1], [1, 2, 0]  # rows and columns of a skew matrix where its axial vector is


def stretch(F: Floats, rate: Floats, R: Floats | None = None) -> tuple[Floats, Floats]:
    """U of the polar decomposition F = R U and dU/dt, (n, 3, 3) each, from F and dF/dt.

    U^2 = C = F^T F.  Where R (n, 3, 3) is known and det F > 0, U = R^T F, and with W = R^T dR/dt,
    which is skew, R^T dF/dt = W U + dU.  The skew part of that, a, is one of W U + U W, so that

        w = (tr(U) I - U)^-1 a = (C + II I) a / (I II - III)

    by Cayley and Hamilton, I, II, III the invariants of U.  Else see `_by_axes`.
    """
    if R is None:
        return _by_axes(F, rate)
    RT = np.swapaxes(R, -1, -2)
    U, A = RT @ F, RT @ rate
    C = np.swapaxes(U, -1, -2) @ U
    first = U[:, 0, 0] + U[:, 1, 1] + U[:, 2, 2]
    second = 0.5 * (first * first - (C[:, 0, 0] + C[:, 1, 1] + C[:, 2, 2]))
    third = np.linalg.det(F)
    below = first * second - third
    skew = A[:, AFTER, LAST] - A[:, LAST, AFTER]
    hard = (third <= 0.0) | (below <= HARD * np.abs(first) ** 3)
    below = np.where(hard, 1.0, below)[:, None]
    w = ((C @ skew[:, :, None])[:, :, 0] + second[:, None] * skew) / below
    W = np.zeros(F.shape)
    W[:, AFTER, LAST] = w
    W[:, LAST, AFTER] = -w
    dU = A - W @ U
    if hard.any():
        U[hard], dU[hard] = _by_axes(F[hard], rate[hard])
    return U, dU


def _by_axes(F: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """`stretch` by the axes of C: also where R is not known, or no rotation makes U positive.

    dU solves U dU + dU U = dC, entry by entry in the frame of U: dU_ij = dC_ij / (U_i + U_j).
    Symmetric and not negative at J < 0 too.  Where F squashes a plane to a line, the part of dU in
    that plane has no value and is taken as 0.
    """
    cross = np.swapaxes(F, -1, -2) @ rate
    C, dC = np.swapaxes(F, -1, -2) @ F, cross + np.swapaxes(cross, -1, -2)
    squares, Q = np.linalg.eigh(C)
    s = np.sqrt(np.maximum(squares, 0.0))
    QT = np.swapaxes(Q, -1, -2)
    both = s[..., :, None] + s[..., None, :]
    lost = both <= 1e-7 * s[..., -1:, None]  # the square root halves the digits of eigh
    local = QT @ dC @ Q
    if lost.any():
        local = np.where(lost, 0.0, local / np.where(lost, 1.0, both))
    else:
        local /= both
    return (Q * s[..., None, :]) @ QT, Q @ local @ QT


CHUNK = 4096  # particles at once: what is made on the way stays in a core's cache
NEWTON = 12  # steps of the polar iteration, enough for stretches of 1/100 to 100
SETTLED = 1e-9  # change after which an iterate is exact to rounding
SWEEPS = 6  # Jacobi converges quadratically: f64 digits are used up well before


def _newton(F: Floats) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Iterates (n, 3, 3), and which of them (n,) are rotations to rounding."""
    q = entries(F)
    upright = done = np.linalg.det(F) > 0.0
    hopeless = ~upright
    with np.errstate(all="ignore"):  # what comes to nothing goes to the SVD
        for _ in range(NEWTON):
            new = cofactors(q)
            new /= q[0] * new[0] + q[1] * new[1] + q[2] * new[2]
            new += q
            new *= 0.5
            # The error of an iterate is the square of its change.
            q -= new
            done = np.abs(q, out=q).max(0) < SETTLED
            q = new
            if (done | hopeless).all():
                break
    return q.T.reshape(-1, 3, 3), done & upright


def _signed_svd(F: Floats) -> NDArray[np.float64]:
    U, _, Vt = np.linalg.svd(F)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    return U @ Vt


def jacobi(S: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Diagonalise symmetric S (N, 3, 3): returns Q^T S Q and Q, det Q = 1, Q near the identity."""
    # Entry by entry over all matrices: products of 3x3 matrices would cost several times as much.
    s = np.array(np.asarray(S, float).transpose(1, 2, 0), order="C")
    q = np.zeros(s.shape)
    q.reshape(9, -1)[::4] = 1.0
    # Below rounding an off-diagonal says nothing, and turning by it would be noise.
    scale = 1e-14 * np.maximum(s[0, 0] + s[1, 1] + s[2, 2], 1e-300)
    for _ in range(SWEEPS):
        moved = False
        for a, b, other in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            active = np.abs(s[a, b]) > scale
            if not active.any():
                continue
            moved = True
            off = np.where(active, s[a, b], 1.0)
            tau = (s[b, b] - s[a, a]) / (2.0 * off)
            t = np.where(tau >= 0.0, 1.0, -1.0) / (np.abs(tau) + np.sqrt(1.0 + tau * tau))
            t *= active
            cosine = 1.0 / np.sqrt(1.0 + t * t)
            sine = t * cosine
            off *= t
            s[a, a] -= off
            s[b, b] += off
            s[a, b] = s[b, a] = np.where(active, 0.0, s[a, b])
            first, second = s[a, other], s[b, other]
            s[a, other], s[b, other] = (
                cosine * first - sine * second,
                sine * first + cosine * second,
            )
            s[other, a], s[other, b] = s[a, other], s[b, other]
            first, second = q[:, a], q[:, b]
            q[:, a], q[:, b] = cosine * first - sine * second, sine * first + cosine * second
        if not moved:
            break
    return s.transpose(2, 0, 1), q.transpose(2, 0, 1)


def matrix_from_quaternion(q: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) rotation of unit quaternions (N, 4), (w, x, y, z)."""
    w, x, y, z = np.asarray(q, float).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )


def quaternion_from_matrix(R: Floats) -> NDArray[np.float64]:
    """(N, 4) unit quaternion (w, x, y, z) of rotations (N, 3, 3)."""
    r = entries(R)
    a, b, c = r[::4]
    # 4 q q^T.  The largest of four squared components is at least a quarter: divide by that one.
    products = np.empty((4, 4, len(R)))
    for k, square in enumerate((1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c)):
        products[k, k] = square
    products[0, 1:] = products[1:, 0] = r[[7, 2, 3]] - r[[5, 6, 1]]
    products[1, 2:] = products[2:, 1] = r[[3, 2]] + r[[1, 6]]
    products[2, 3] = products[3, 2] = r[7] + r[5]
    products *= 0.25
    largest = products.reshape(16, -1)[::5].argmax(0)
    q = products[largest, :, np.arange(len(R))]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


JACOBI_AFTER, JACOBI_LAST = [1, 2, 0], [2, 0, 1]  # of the columns of F that make C_23, C_31, C_12


def _determinants(q: Floats) -> Floats:
    minors = q[[4, 5, 3]] * q[[8, 6, 7]]
    minors -= q[[5, 3, 4]] * q[[7, 8, 6]]
    minors *= q[:3]
    return minors[0] + minors[1] + minors[2]


def _singular_values(q: Floats) -> Floats:
    """Of `entries` (9, N)."""
    one, two, three = q[:3], q[3:6], q[6:]
    squares = one * one + two * two + three * three  # diagonal of C = F^T F
    mixed = (
        one[JACOBI_AFTER] * one[JACOBI_LAST]
        + two[JACOBI_AFTER] * two[JACOBI_LAST]
        + three[JACOBI_AFTER] * three[JACOBI_LAST]
    )
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


def gaussian_axes(orientations: Floats, scales: Floats) -> NDArray[np.float64]:
    """A = R diag(scale), (N, 3, 3), of quaternions (w, x, y, z) (N, 4) and scales (N, 3).

    The quaternions need not be normalised; one of length 0 is no rotation.
    """
    q = np.asarray(orientations, dtype=np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(length > 0.0, q / np.where(length > 0.0, length, 1.0), (1.0, 0.0, 0.0, 0.0))
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    rotation = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return rotation * np.asarray(scales, dtype=np.float64)[:, None, :]
