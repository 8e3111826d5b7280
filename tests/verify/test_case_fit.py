"""Orders, limits, frequencies and minima read off figures that are known."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.verify.case import convergence_order, fit_frequency, interpolate_minimum


@pytest.mark.parametrize("p", [1.0, 2.0, 2.7])
def test_the_order_of_a_power(p: float) -> None:
    h = np.array([0.5, 0.2, 0.05])
    assert convergence_order(h, -3.0 * h**p) == pytest.approx(p, rel=1e-10)


@pytest.mark.parametrize("off", [0.9, 1.0, 1.08])
def test_the_frequency_of_a_sine_with_an_offset(off: float) -> None:
    t = np.linspace(0.0, 3.0, 90)
    w = 2.0 * np.pi * 1.37
    q = 0.3 + 0.2 * np.cos(w * t) - 0.5 * np.sin(w * t)
    # Three periods are sampled, so a guess within a tenth leads to it.
    assert fit_frequency(t, q, off * w) == pytest.approx(w, rel=1e-8)


def test_the_least_of_a_parabola_between_its_samples() -> None:
    t = np.linspace(0.0, 1.0, 11)
    at, value = interpolate_minimum(t, 2.0 * (t - 0.43) ** 2 - 1.0)
    assert at == pytest.approx(0.43, abs=1e-12)
    assert value == pytest.approx(-1.0, abs=1e-12)


@pytest.mark.parametrize("y", [[0.0, 1.0, 2.5, 4.0], [4.0, 2.0, 1.0, 0.5]])
def test_a_least_at_an_end_is_a_number(y: list[float]) -> None:
    assert np.isfinite(interpolate_minimum(np.arange(4.0), np.array(y))).all()
