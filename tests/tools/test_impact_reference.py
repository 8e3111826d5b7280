"""The finite elements of the case `rim`: stress of an even strain, and what the floor does."""

from __future__ import annotations

import numpy as np
import pytest

from tools import impact_reference
from tools.impact_reference import BULK, HARDENING, MU, RADIUS, SPEED, YIELD, Bar


def strained(along: float, across: float) -> Bar:
    """A bar with even logarithmic strains."""
    bar = Bar(3, held=False)
    bar.x = bar.X * np.exp([across, along])
    return bar


@pytest.mark.parametrize("along", [1e-3, 0.2])
def test_an_even_strain_pulls_on_the_ends_and_the_mantle_alone(along: float) -> None:
    across = -0.45 * along
    bar = strained(along, across)
    f = bar.force()
    # Radial return: the stress 2 mu (e_z - e_r) of the trial comes down to Y + H a.
    shear = 2.0 * MU * (along - across)
    a = max(0.0, (shear - YIELD) / (3.0 * MU + HARDENING))
    sigma = shear - 3.0 * MU * a
    tau = 2.0 / 3.0 * sigma + BULK * (along + 2.0 * across)
    end = f[bar.X[:, 1] == bar.X[:, 1].max(), 1].sum()
    # Two Gauss points along r are exact for r dr; rounding of some 1e3 MPa mm^2 is left.
    assert end == pytest.approx(-tau / np.exp(along) * np.pi * RADIUS**2, rel=1e-10)
    np.testing.assert_allclose(bar.a, a, atol=1e-14)
    inside = (bar.X[:, 0] < RADIUS) & (bar.X[:, 1] > 0.0) & (bar.X[:, 1] < bar.X[:, 1].max())
    assert np.abs(f[inside]).max() < 1e-10 * abs(end)
    assert bar.lost == pytest.approx(sigma * a * bar.V.sum(), rel=1e-10, abs=1e-12)


def test_the_floor_stops_what_would_enter_and_lets_go_of_what_leaves() -> None:
    free, held = Bar(2, held=False), Bar(2, held=True)
    for bar in (free, held):
        bar.step(1e-6)
        assert (bar.x[bar.bottom, 1] == 0.0).all()
        assert (bar.x[~bar.bottom, 1] < bar.X[~bar.bottom, 1]).all()
        bar.v[:, 1] = SPEED
        bar.step(1e-6)
    assert (free.x[free.bottom, 1] > 0.0).all()
    assert (held.x[held.bottom, 1] == 0.0).all()


def test_a_step_is_stable_and_a_bar_in_flight_keeps_its_energy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(impact_reference, "YIELD", 1e9)
    bar = Bar(2, held=False)
    bar.x[:, 1] += 10.0  # of a floor far below
    bar.v[:, 1] *= bar.X[:, 1] / bar.X[:, 1].max()
    start, momentum = bar.energy(), bar.m @ bar.v[:, 1]
    for _ in range(200):
        bar.step(bar.stable())
    assert bar.m @ bar.v[:, 1] == pytest.approx(momentum, rel=1e-12)
    assert bar.lost == 0.0
    assert bar.energy() < start  # part of it is strain, which an unstable step would exceed
