"""Arrays of rows of three numbers: their types, sums over each row, and over segments of rows.

NumPy reduces an axis of length three with a loop per row, which takes several times as long as by
columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def columns(rows: Floats) -> np.ndarray:
    """(k, n) of rows (n, k), each column in one piece of memory."""
    return np.ascontiguousarray(np.asarray(rows).T)


def lengths(rows: Floats) -> np.ndarray:
    """|a| (n,) of rows (n, 3), bit-identical to `numpy.linalg.norm`."""
    squares = columns(rows)
    squares = squares * squares
    return np.sqrt(squares[0] + squares[1] + squares[2])


def row_dots(a: Floats, b: Floats) -> np.ndarray:
    """a . b (n,) of rows (n, 3), bit-identical to `(a * b).sum(1)`."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def cross(a: Floats, b: Floats) -> np.ndarray:
    """a x b (..., 3) of vectors (..., 3), bit-identical to `numpy.cross`."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[..., axis] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return out


def gather(values: Floats, rows: Ints) -> np.ndarray:
    """values[rows] (*rows.shape, ...) of values (n, ...) by integers.

    Three components at (4000, 3) rows: 62 us, and 306 us by NumPy's indexing (measured).
    """
    return values.take(rows, axis=0)


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


class Segments:
    """Segmented reductions: of the rows of each of B sets, which have no row in common.

    members : the rows of each set, ascending; a set may be empty.
    """

    def __init__(self, members: Sequence[Ints]) -> None:
        count = np.array([len(m) for m in members], np.int64)
        self.of = np.repeat(np.arange(len(count)), count)  # (n,) the set of each row, in order
        self._order = np.concatenate([*members, np.zeros(0, np.int64)])
        self._in_order = np.array_equal(self._order, np.arange(len(self._order)))
        self._filled = np.flatnonzero(count)
        self._start = (np.cumsum(count) - count)[self._filled]
        self._count = np.maximum(count, 1).astype(float)

    def ordered(self, rows: Floats) -> np.ndarray:
        """(n, ...) rows in the order of the sets; further rows are in none of them."""
        return rows[: len(self._order)] if self._in_order else gather(rows, self._order)

    def means(self, rows: Floats) -> np.ndarray:
        """(B, k) of rows (n, k); 0 of an empty set."""
        return self._reduced(np.add, rows, 0.0) / self._count[:, None]

    def least(self, rows: Floats, empty: float) -> np.ndarray:
        """(B, k) of rows (n, k)."""
        return self._reduced(np.minimum, rows, empty)

    def largest(self, rows: Floats, empty: float) -> np.ndarray:
        """(B, k) of rows (n, k)."""
        return self._reduced(np.maximum, rows, empty)

    def largest_deviation(self, rows: Floats, means: Floats) -> np.ndarray:
        """(B,) largest distance of rows (n, 3) from `means` (B, 3) of their sets."""
        away = lengths(self.ordered(rows) - gather(means, self.of))
        out = np.zeros(len(self._count))
        if len(self._filled):
            out[self._filled] = np.maximum.reduceat(away, self._start)
        return out

    def _reduced(self, reduction: np.ufunc, rows: Floats, empty: float) -> np.ndarray:
        out = np.full((rows.shape[1], len(self._count)), empty)
        if len(self._filled):
            found = reduction.reduceat(columns(self.ordered(rows)), self._start, axis=1)
            out[:, self._filled] = found
        return np.ascontiguousarray(out.T)


Floats = NDArray[Any]  # of any width: files hold float32, the solver's bookkeeping float64
Ints = NDArray[Any]
AXES = {"X": 0, "Y": 1, "Z": 2}
