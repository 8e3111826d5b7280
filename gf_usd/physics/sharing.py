"""Sparse products shared among threads, rows in turns: SciPy lets go of the interpreter meanwhile.

Each row is a sum of its own, so that the result does not depend on how they are shared.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats
from gf_usd.runtime import threads

FEW = 4_096  # rows for each thread, at least: handing them out takes some 50 us


def product(M: Any, u: Floats) -> NDArray[np.float64]:
    """M u of a sparse M (n, m) in rows and u (m, k)."""
    count = M.shape[0]
    parts = min(threads(), count // FEW)
    if parts < 2:
        return M @ u
    bounds = [count * k // parts for k in range(parts + 1)]
    out = np.empty((count, *u.shape[1:]))

    def part(first: int, behind: int) -> None:
        out[first:behind] = _rows(M, first, behind) @ u

    list(_pool(parts).map(part, bounds[:-1], bounds[1:]))
    return out


def _rows(M: Any, first: int, behind: int) -> Any:
    """Some rows of M, without a copy of what is in them."""
    start, end = M.indptr[first], M.indptr[behind]
    return type(M)(
        (M.data[start:end], M.indices[start:end], M.indptr[first : behind + 1] - start),
        shape=(behind - first, M.shape[1]),
        copy=False,
    )


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="rows")
