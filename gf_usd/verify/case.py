"""Verification cases, their measures, and fits of orders, frequencies and minima."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from gf_usd.core.arrays import Floats

ABSOLUTE, RELATIVE, AT_LEAST = "absolute", "relative", "at least"


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A series of measured values, for a plot."""

    title: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    logarithmic: bool = True  # both axes
    target: float | None = None  # a horizontal line


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A measured value with its target and the tolerance of its error.

    The error is |value - target| (ABSOLUTE), |value - target| / |target| (RELATIVE) or
    max(0, target - value) (AT_LEAST).
    """

    name: str
    value: float
    target: float
    bound: float  # tolerance of the error
    why: str  # justification of the bound: order, step, cell size, rounding
    kind: str = ABSOLUTE
    unit: str = ""
    curve: Curve | None = None

    @property
    def error(self) -> float:
        """The error in the unit of the value; for RELATIVE a ratio."""
        if self.kind == AT_LEAST:
            shortfall = float(self.target - self.value)
            return shortfall if math.isnan(shortfall) else max(0.0, shortfall)
        difference = float(abs(self.value - self.target))
        return difference / abs(self.target) if self.kind == RELATIVE else difference

    @property
    def passed(self) -> bool:
        """Whether the error is within the bound; False for NaN."""
        return bool(self.error <= self.bound)


Run = Callable[[str], Iterable[Measure]]  # device -> measures


@dataclass(frozen=True, kw_only=True)
class Case:
    """A verification case: a problem with a reference solution."""

    name: str
    what: str  # description: set-up, measured values and their meaning
    source: str  # of the reference solution
    quick: Run  # seconds
    full: Run | None = None  # finer or longer; None: same as quick
    f64: bool = False  # double precision: Taichi is restarted, so these cases run last


@dataclass(frozen=True, kw_only=True)
class Result:
    """The measures of a case that has run."""

    case: Case
    measures: tuple[Measure, ...]
    seconds: float

    @property
    def passed(self) -> bool:
        return all(m.passed for m in self.measures)


def rows(result: Result) -> list[dict[str, Any]]:
    """A row per measure with the keys of `gf-usd verify --json`; None for NaN and infinity."""
    return [
        {
            "name": f"{result.case.name}.{m.name}",
            "value": _finite_or_none(m.value),
            "target": _finite_or_none(m.target),
            "error": _finite_or_none(m.error),
            "bound": m.bound,
            "pass": m.passed,
            "kind": m.kind,
            "unit": m.unit,
            "why": m.why,
            "case": result.case.name,
            "what": result.case.what,
            "source": result.case.source,
            "seconds": round(result.seconds, 3),
            **({"curve": asdict(m.curve)} if m.curve else {}),
        }
        for m in result.measures
    ]


def _finite_or_none(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def convergence_order(h: Floats, error: Floats) -> float:
    """Order of convergence: the slope of ln |error| over ln h, by least squares."""
    return float(np.polyfit(np.log(h), np.log(np.abs(error)), 1)[0])


def fit_frequency(t: Floats, q: Floats, guess: float) -> float:
    """Angular frequency w of q = a cos(w t) + b sin(w t) + c, by least squares from a guess."""
    q = (
        q / np.abs(q).max()
    )  # otherwise a small amplitude gives no gradient, and the fit returns the guess

    def basis(w: float) -> Floats:
        return np.stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)], 1)

    def residual(w: Floats) -> Floats:
        B = basis(float(w[0]))
        return q - B @ np.linalg.lstsq(B, q, rcond=None)[0]

    return float(least_squares(residual, [guess], x_scale=guess).x[0])


def interpolate_minimum(t: Floats, y: Floats) -> tuple[float, float]:
    """Time and value of the minimum of sampled y, by a parabola through three samples."""
    k = int(np.clip(np.argmin(y), 1, len(y) - 2))
    a, b, c = np.polyfit(t[k - 1 : k + 2] - t[k], y[k - 1 : k + 2], 2)
    return float(t[k] - b / (2.0 * a)), float(c - b * b / (4.0 * a))
