"""Intervals of sequences whose limit is known."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.pipeline.measures.convergence import (
    COARSE,
    SWINGING,
    TINY,
    UNORDERED,
    WIDEST,
    band,
    capped,
    estimate,
)


def sequence(limit, slope, order):
    """Values at h, 2 h and 4 h of limit + slope h^p with h = 1/10."""
    return [np.array([limit + slope * (h * 0.1) ** order]) for h in (1.0, 2.0, 4.0)]


@pytest.mark.parametrize("order", [1.0, 1.3, 2.0])
@pytest.mark.parametrize("slope", [-0.5, 0.5])
def test_the_limit_of_a_power_is_found(order, slope):
    found = estimate(sequence(3.0, slope, order), 1.0)
    assert found.known
    assert found.order == pytest.approx(order)
    assert found.value == pytest.approx(3.0, abs=1e-12)
    assert found.half >= abs(slope) * 0.1**order


@pytest.mark.parametrize("order", [0.5, 0.7, 2.6, 4.0])
def test_other_orders_are_not_believed_and_the_limit_is_inside(order):
    found = estimate(sequence(3.0, 0.5, order), 1.0)
    assert found.order == pytest.approx(order)
    distance = abs(found.value[0] - 3.0)
    # an order below 1 has its limit farther away than order 1 says, up to (2 - 1) / (2^p - 1)
    reach = (2.0 / (2.0**order - 1.0) - 1.0) if order < 1.0 else 1.0
    assert distance <= found.half * max(1.0, reach)
    if order > 1.0:
        assert distance <= found.half


def test_a_vector_has_norms():
    one = np.array(sequence(1.0, 0.5, 1.0))
    found = estimate([np.array([x[0], 0.0, -x[0]]) for x in one], 1.0)
    assert found.value == pytest.approx([1.0, 0.0, -1.0])
    assert found.half == pytest.approx(0.05 * np.sqrt(2.0))


def test_differences_that_grow_are_no_convergence():
    found = estimate([np.array([x]) for x in (1.5, 1.2, 1.1)], 1.0)
    assert not found.known
    assert "0.1" in found.reason
    assert "0.3" in found.reason
    assert found.as_json()["value"] is None
    assert found.as_json()["half_width"] is None
    assert found.as_json()["fine"] == [1.5]


def test_small_differences_without_order_are_a_wide_interval():
    found = estimate([np.array([x]) for x in (1.012, 1.002, 1.0)], 1.0)
    assert found.known
    assert found.half == pytest.approx(UNORDERED * 0.01)
    assert found.half > abs(1.012 - 1.002)


def test_signs_that_alternate_are_centered_on_the_finest():
    found = estimate([np.array([x]) for x in (1.1, 1.2, 1.0)], 1.0)
    assert found.value == pytest.approx(1.1)
    assert found.half == pytest.approx(SWINGING * 0.1)


def test_a_difference_that_vanishes_by_luck_does_not_make_it_certain():
    found = estimate([np.array([x]) for x in (1.0, 1.0, 1.4)], 1.0)
    assert found.half == pytest.approx(COARSE * 0.4)


def test_what_is_the_same_in_all_runs_is_known_to_rounding():
    found = estimate([np.array([0.3])] * 3, 1.0)
    assert (found.half, found.order) == (TINY, None)


def test_no_interval_is_narrower_than_the_least():
    assert estimate(sequence(3.0, 1e-3, 1.0), 1.0, least=0.01).half == 0.01


def test_an_interval_ends_at_what_is_possible():
    found = capped(estimate(sequence(3.0, -0.5, 1.0), 1.0), 3.02)
    assert found.value[0] + found.half == pytest.approx(3.02)
    assert found.value[0] - found.half == pytest.approx(2.95)
    beyond = estimate(sequence(3.0, -0.5, 1.0), 1.0)
    assert capped(beyond, 2.9) == beyond


def curves(parting):
    """Paths (50, 3) whose error is h (t + the parting of t)."""
    t = np.linspace(0.0, 1.0, 50)
    return [np.stack([t, e * (0.1 * t) + parting(t, e), 0.0 * t], 1) for e in (0.1, 0.2, 0.4)]


def test_the_band_of_a_curve_holds_its_limit():
    made = curves(lambda t, e: 0.0 * t)
    found = band(made, 1.0)
    assert (found.until, found.reason) == (50, "")
    limit = made[0] - np.array([[0.0, 1.0, 0.0]]) * (0.01 * made[0][:, :1])
    assert (np.linalg.norm(made[0] - limit, axis=1) <= found.half).all()


def test_curves_that_part_are_known_until_they_do():
    # after t = 0.6 the runs diverge, and the finer ones are no closer
    ways = {0.1: 1.0, 0.2: -1.0, 0.4: 0.5}
    found = band(curves(lambda t, e: ways[e] * np.maximum(0.0, t - 0.6)), 1.0)
    assert 30 <= found.until <= 32
    assert np.isfinite(found.half[: found.until]).all()
    assert np.isnan(found.half[found.until :]).all()
    assert "no less than" in found.reason


def test_a_band_ends_where_it_is_too_wide():
    found = band(curves(lambda t, e: 20.0 * e * t), 1.0)
    assert 0 < found.until < 50
    assert found.half[: found.until].max() <= WIDEST
    assert "uncertain" in found.reason
