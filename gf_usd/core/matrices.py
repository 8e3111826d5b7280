"""Cofactors of many 3x3 matrices at once, in a few passes over arrays.

With the nine entries stored as rows over all matrices, each cofactor is a difference of two
products: four lookups and three operations for any number of matrices.  A cross product for each
row takes three times as long for a small body, because of its many calls.

Also the conversion of Gaussians between axes, and a quaternion with three standard deviations, and
the stretch U of the polar decomposition F = R U with its rate.
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


def signed_polar(F: Floats) -> NDArray[np.float64]:
    """(n, 3, 3) R of the polar decomposition of F (n, 3, 3) with det R = 1, by the SVD.

    F = U S V^T, R = U diag(1, 1, det U det V) V^T: the rotation nearest to F (Kabsch 1976), also
    where F is inverted or singular.
    """
    U, _, Vt = np.linalg.svd(F)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    return U @ Vt


def across(d: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors that complete a unit vector d (3,) to a right-handed frame."""
    u = np.cross(np.eye(3)[int(np.argmin(np.abs(d)))], d)
    u = u / np.linalg.norm(u)
    return u, np.cross(d, u)


def matrix_from_quaternion(q: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) rotation of unit quaternions (N, 4), (w, x, y, z)."""
    return np.stack([np.stack(row, -1) for row in rotation_rows(np.asarray(q, float).T)], -2)


def rotation_rows(q: Floats) -> tuple[tuple[Floats, Floats, Floats], ...]:
    """The entries (N,), row by row, of the rotations of unit quaternions w, x, y, z (4, N)."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def gaussian_axes(orientations: Floats, scales: Floats) -> NDArray[np.float64]:
    """A = R diag(scale), (N, 3, 3), of quaternions (w, x, y, z) (N, 4) and scales (N, 3).

    The quaternions need not be normalized; one of length 0 is no rotation.
    """
    q = np.asarray(orientations, dtype=np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(length > 0.0, q / np.where(length > 0.0, length, 1.0), (1.0, 0.0, 0.0, 0.0))
    return matrix_from_quaternion(q) * np.asarray(scales, dtype=np.float64)[:, None, :]


def ellipsoids(axes: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quaternions (N, 4) (x, y, z, w) and semi-axes (N, 3) of A (N, 3, 3), whose columns may lean.

    x = A s, |s| = 1, is the same ellipsoid as U S s with A = U S V^T.
    """
    from scipy.spatial.transform import Rotation

    scales = np.linalg.norm(axes, axis=1)
    safe = np.where(scales > 0.0, scales, 1.0)
    Q = axes / safe[:, None, :]
    square = np.einsum("nij,nik->njk", Q, Q)
    if np.abs(square - np.eye(3)).max(initial=0.0) > 1e-3:
        Q, scales, _ = np.linalg.svd(axes)
    mirrored = np.linalg.det(Q) < 0.0
    Q = np.where(mirrored[:, None, None], -Q, Q)
    return Rotation.from_matrix(Q).as_quat(), scales
