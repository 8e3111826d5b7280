"""A verification case and its measurements.

Reading orders and frequencies off figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from gf_usd.core.arrays import Floats

ABSOLUTE, RELATIVE, AT_LEAST = "absolute", "relative", "at least"


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Figures that belong together, for a plot."""

    title: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    logarithmic: bool = True  # both axes
    target: float | None = None  # a level line


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One figure next to its target.

    The error is |value - target|, the same over |target|, or by how much the value falls short of
    the target, whichever `kind` says.
    """

    name: str
    value: float
    target: float
    bound: float  # of the error
    why: str  # where the bound comes from: order, step, cell size, rounding
    kind: str = ABSOLUTE
    unit: str = ""
    curve: Curve | None = None

    @property
    def error(self) -> float:
        """In the unit of the value; a ratio where the kind is relative."""
        if self.kind == AT_LEAST:
            short = float(self.target - self.value)
            return short if math.isnan(short) else max(0.0, short)
        off = float(abs(self.value - self.target))
        return off / abs(self.target) if self.kind == RELATIVE else off

    @property
    def passed(self) -> bool:
        """False for what is no number, too."""
        return bool(self.error <= self.bound)


Run = Callable[[str], Iterable[Measure]]  # device -> measures


@dataclass(frozen=True, kw_only=True)
class Case:
    """A question to the solver whose answer is known."""

    name: str
    what: str  # what is set up, what is measured and what it shows
    source: str  # where the target comes from
    quick: Run  # seconds
    full: Run | None = None  # finer, or longer; None: the quick one says all
    f64: bool = False  # in double precision: Taichi starts anew, so these run last


@dataclass(frozen=True, kw_only=True)
class Result:
    """A case that has run."""

    case: Case
    measures: tuple[Measure, ...]
    seconds: float

    @property
    def passed(self) -> bool:
        return all(m.passed for m in self.measures)


def rows(result: Result) -> list[dict[str, Any]]:
    """One row a measure, with the keys of `gf-usd verify --json`; what is no number is None."""
    return [
        {
            "name": f"{result.case.name}.{m.name}",
            "value": _number(m.value),
            "target": _number(m.target),
            "error": _number(m.error),
            "bound": m.bound,
            "pass": m.passed,
            "kind": m.kind,
            "unit": m.unit,
            "why": m.why,
            "case": result.case.name,
            "what": result.case.what,
            "source": result.case.source,
            "seconds": round(result.seconds, 3),
            **({"curve": vars(m.curve)} if m.curve else {}),
        }
        for m in result.measures
    ]


def _number(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def order(h: Floats, error: Floats) -> float:
    """Slope of ln error over ln h, by least squares."""
    return float(np.polyfit(np.log(h), np.log(np.abs(error)), 1)[0])


def frequency(t: Floats, q: Floats, guess: float) -> float:
    """Angular frequency of q = a cos(w t) + b sin(w t) + c, by least squares from a guess."""
    q = q / np.abs(q).max()  # or a small swing would have no gradient, and the guess be the answer

    def basis(w: float) -> Floats:
        return np.stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)], 1)

    def residual(w: Floats) -> Floats:
        B = basis(float(w[0]))
        return q - B @ np.linalg.lstsq(B, q, rcond=None)[0]

    return float(least_squares(residual, [guess], x_scale=guess).x[0])


def lowest(t: Floats, y: Floats) -> tuple[float, float]:
    """Time and value of the least of sampled y, by a parabola through the three nearest."""
    k = int(np.clip(np.argmin(y), 1, len(y) - 2))
    a, b, c = np.polyfit(t[k - 1 : k + 2] - t[k], y[k - 1 : k + 2], 2)
    return float(t[k] - b / (2.0 * a)), float(c - b * b / (4.0 * a))
