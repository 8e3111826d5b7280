"""The stretch U of the polar decomposition F = R U, and how fast it changes."""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats

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
