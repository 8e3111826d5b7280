"""The exponents of the tables of scale."""

from __future__ import annotations

import pytest

from tools.bench.scale import AXES, exponent


def test_an_exponent_is_the_slope_from_the_knee_on():
    sizes = [1, 10, 100, 1_000]
    seconds = [5.0, *(2e-3 * n**1.25 for n in sizes[1:])]
    assert exponent(sizes, seconds, 10) == pytest.approx(1.25)
    assert exponent(sizes[:2], seconds[:2], 10) is None, "of one size there is none"


def test_every_axis_is_fitted_over_two_sizes_at_least():
    for axis in AXES.values():
        assert sum(size >= axis.knee for size in axis.sizes) >= 2
