"""The cases of laws that flow notice a wrong material."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.verify.case import Measure
from gf_usd.verify.cases.plastic import expansion, membrane, taylor
from gf_usd.verify.registry import run_case

COARSE = (0.08, 0.01, 0.1)  # bounds with two cells a radius


def bars() -> list[Measure]:
    """Radius and length of the coarsest bar."""
    figures = taylor.impact(2, bounds=COARSE)("cpu")
    return [next(figures), next(figures)]


@pytest.mark.slow
def test_taylors_bar_passes_with_copper_and_fails_with_ten_times_its_yield_stress(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert all(figure.passed for figure in bars())
    monkeypatch.setattr(taylor, "COPPER", taylor.HARD)
    radius, length = bars()
    assert not radius.passed
    assert not length.passed
    assert radius.error > 5.0 * radius.bound


@pytest.mark.slow
@pytest.mark.acceptance
def test_the_two_observers_of_taylors_bar_notice_a_wall_that_is_a_trifle_slow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right = taylor.wall
    monkeypatch.setattr(taylor, "wall", lambda speed, frames: right((1.0 - 1e-10) * speed, frames))
    (figure,) = run_case(next(c for c in taylor.CASES if c.f64)).measures
    assert not figure.passed
    assert figure.error < 1e-9


def test_a_quarter_of_the_rod_has_its_volume_and_second_moment() -> None:
    rod = taylor.quarter_rod(3)
    assert (rod.X > 0.0).all()
    area = 0.25 * np.pi * taylor.RADIUS**2
    assert rod.V0.sum() == pytest.approx(area * taylor.LENGTH, rel=1e-12)
    second = rod.V0 @ (rod.X[:, 0] ** 2 + rod.X[:, 2] ** 2)
    # A cut stratum is one point in the middle of its share: (a / R)^2 / 12 of the rim, a = R / 6.
    assert second == pytest.approx(0.5 * area * taylor.LENGTH * taylor.RADIUS**2, rel=5e-3)


def test_the_panel_has_the_moments_of_its_trapezoid() -> None:
    cells = 12
    panel, h = membrane.panel(cells)
    wide, left, right = membrane.WIDTH, membrane.LEFT, membrane.RIGHT
    area = 0.5 * (left + right) * wide
    assert panel.V0.sum() == pytest.approx(area * h, rel=1e-12)
    x = panel.V0 @ panel.X[:, 0] / panel.V0.sum()
    # Points on the slanted edges count whole strata of h / 32 as inside or not.
    assert x == pytest.approx(wide * (left + 2.0 * right) / (3.0 * (left + right)), rel=1e-3)
    assert panel.X[:, 1].max() < membrane.RISE + right


def test_inertia_of_the_cylinder_is_what_its_points_are_accelerated_by() -> None:
    a, speed, dt = 15e-3, 3.0, 1e-6
    R = np.linspace(expansion.INNER, expansion.OUTER, 4001)
    before, r, after = (
        np.sqrt(R**2 + (a + k * dt * speed) ** 2 - expansion.INNER**2) for k in (-1, 0, 1)
    )
    force = expansion.DENSITY * (after - 2.0 * r + before) / dt**2
    # Differences leave (v dt / a)^2 and rounding, 1e-16 (a / (v dt))^2 of v^2 / a.
    integral = np.trapezoid(force, r)
    assert expansion.inertia(a, speed) == pytest.approx(integral, rel=1e-5)
