"""Arrays of rows of three numbers: their types, and sums over each row, computed by columns.

NumPy reduces an axis of length three with a loop per row, which takes several times as long.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def columns(rows: Floats) -> np.ndarray:
    """(k, n) of rows (n, k), each column in one piece of memory."""
    return np.ascontiguousarray(np.asarray(rows).T)


def lengths(rows: Floats) -> np.ndarray:
    """|a| (n,) of rows (n, 3), to the bit what `numpy.linalg.norm` says."""
    squares = columns(rows)
    squares = squares * squares
    return np.sqrt(squares[0] + squares[1] + squares[2])


def row_dots(a: Floats, b: Floats) -> np.ndarray:
    """a . b (n,) of rows (n, 3), to the bit what `(a * b).sum(1)` says."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def cross(a: Floats, b: Floats) -> np.ndarray:
    """a x b (..., 3) of vectors (..., 3), to the bit what `numpy.cross` says."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[..., axis] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return out


def nonzero_rows(rows: Floats) -> Ints:
    """Which of rows (n, 3) are not 0."""
    return np.flatnonzero((rows[:, 0] != 0.0) | (rows[:, 1] != 0.0) | (rows[:, 2] != 0.0))


def corners(rows: Floats) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest (3,) of rows (n, 3)."""
    of = columns(rows)
    return of.min(1), of.max(1)


def triple(values: Any) -> tuple[float, float, float]:
    """The first three of some numbers as Python's."""
    return float(values[0]), float(values[1]), float(values[2])


Floats = NDArray[Any]  # of any width: files hold float32, the solver's bookkeeping float64
Ints = NDArray[Any]
AXES = {"X": 0, "Y": 1, "Z": 2}
