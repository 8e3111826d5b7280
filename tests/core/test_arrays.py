"""Sums over the columns of long arrays: the same as NumPy's own, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.arrays import Segments, corners, cross, lengths, nonzero_rows, row_dots


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


def test_rows_of_zeros_are_distinguished_from_those_with_one_number() -> None:
    rows = np.zeros((4, 3))
    rows[1, 2], rows[3, 0] = 1e-300, -2.0
    np.testing.assert_array_equal(nonzero_rows(rows), [1, 3])


@pytest.mark.parametrize("mixed", [False, True])
def test_segments_are_reduced_as_one_by_one(mixed: bool) -> None:
    dice = np.random.default_rng(3)
    rows, of = dice.normal(size=(50, 3)), np.sort(dice.choice([0, 2, 3], 47))  # none of 1
    if mixed:
        dice.shuffle(of)
    members = [np.flatnonzero(of == k) for k in range(5)]
    segments = Segments(members)
    means = segments.means(rows)
    expected = [rows[m].mean(0) if len(m) else np.zeros(3) for m in members]
    np.testing.assert_allclose(means, expected, rtol=0.0, atol=1e-14)
    least, largest = segments.least(rows, 9.0), segments.largest(rows, -9.0)
    away = segments.largest_deviation(rows, means)
    for k, m in enumerate(members):
        np.testing.assert_array_equal(least[k], rows[m].min(0, initial=9.0))
        np.testing.assert_array_equal(largest[k], rows[m].max(0, initial=-9.0))
        assert away[k] == lengths(rows[m] - means[k]).max(initial=0.0)
    assert Segments([]).means(rows).shape == (0, 3)
