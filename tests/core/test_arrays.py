"""Sums over the columns of long arrays: the same as NumPy's own, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.arrays import corners, lengths


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_columns_say_what_rows_say(count: int) -> None:
    rows = np.random.default_rng(count).normal(size=(count, 3)) * 10.0 ** np.arange(-3, 0)
    np.testing.assert_array_equal(lengths(rows), np.linalg.norm(rows, axis=1))
    low, high = corners(rows)
    np.testing.assert_array_equal(low, rows.min(axis=0))
    np.testing.assert_array_equal(high, rows.max(axis=0))


def test_the_rows_are_left_as_they_are() -> None:
    rows = np.array([[3.0, 4.0, 12.0]])
    assert lengths(rows) == [13.0]
    np.testing.assert_array_equal(rows, [[3.0, 4.0, 12.0]])
