"""Sums over the columns of long arrays: the same as NumPy's own, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.arrays import corners, cross, lengths, nonzero_rows, row_dots


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_columns_say_what_rows_say(count: int) -> None:
    rows = np.random.default_rng(count).normal(size=(count, 3)) * 10.0 ** np.arange(-3, 0)
    np.testing.assert_array_equal(lengths(rows), np.linalg.norm(rows, axis=1))
    other = rows[::-1]
    np.testing.assert_array_equal(row_dots(rows, other), (rows * other).sum(1))
    low, high = corners(rows)
    np.testing.assert_array_equal(low, rows.min(axis=0))
    np.testing.assert_array_equal(high, rows.max(axis=0))


@pytest.mark.parametrize("shape", [(1, 3), (1000, 3), (4, 5, 3)])
@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_cross_products_are_those_of_numpy(shape: tuple[int, ...], real: type) -> None:
    dice = np.random.default_rng(0)
    a, b = (dice.normal(size=shape).astype(real) for _ in range(2))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
    np.testing.assert_array_equal(cross(a[:1], b), np.cross(a[:1], b))
    assert cross(a, b).dtype == real


def test_the_rows_are_left_as_they_are() -> None:
    rows = np.array([[3.0, 4.0, 12.0]])
    assert lengths(rows) == [13.0]
    np.testing.assert_array_equal(rows, [[3.0, 4.0, 12.0]])


def test_rows_of_zeros_are_told_from_those_with_one_number() -> None:
    rows = np.zeros((4, 3))
    rows[1, 2], rows[3, 0] = 1e-300, -2.0
    np.testing.assert_array_equal(nonzero_rows(rows), [1, 3])
