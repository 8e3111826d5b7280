"""Cofactors of many 3x3 matrices at once, in a few passes over arrays.

With the nine entries as rows, side by side over all matrices, every cofactor is the difference of
two products: four lookups and three operations, whatever their number.  A cross product for each
row costs a small body three times as much, all of it in calls.
"""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats

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
