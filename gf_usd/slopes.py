"""Derivatives at scattered points by least squares over neighbours, as one sparse operator.

    da/dX = [sum_j w_j (a_j - a) d_j] M^+,   M = sum_j w_j d_j d_j^T,   d_j = X_j - X

exact for affine a where the neighbours fill space.  Along a direction in which there are none M is
singular, and the derivative of least norm, 0 along it, is taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats, Ints
from gf_usd.sparse import sparse

FLAT = 1e-9  # eigenvalue of M, beside the largest, of a direction without neighbours


def operator(near: Ints, d: Floats, w: Floats) -> sparse.csr_matrix:
    """(3 N, N) [1/m], row 3 p + b of da/dX_b at point p.

    near : (N, k) points beside each; d : (N, k, 3) [m] from it to them; w : (N, k) weights.
    """
    n, k = near.shape
    M = np.einsum("nk,nka,nkb->nab", w, d, d)
    B = np.einsum("nk,nka,nab->nbk", w, d, np.linalg.pinv(M, rcond=FLAT, hermitian=True))
    own = np.repeat(np.arange(n, dtype=np.int32), 3)
    columns = np.concatenate([np.repeat(near.astype(np.int32), 3, axis=0), own[:, None]], 1)
    values = np.concatenate([B.reshape(3 * n, k), -B.sum(2).reshape(3 * n, 1)], 1)
    start = np.arange(0, columns.size + 1, k + 1)
    D = sparse.csr_matrix((values.ravel(), columns.ravel(), start), shape=(3 * n, n))
    D.sum_duplicates()
    return D


def slopes(D: sparse.csr_matrix, values: Floats) -> NDArray[np.float64]:
    """(N, c, 3) of values (N, c): derivative by X_b of component a in place [:, a, b]."""
    n, c = values.shape
    return np.ascontiguousarray((D @ values).reshape(n, 3, c).swapaxes(1, 2))
