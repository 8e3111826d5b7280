"""Reading orders and frequencies off figures."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from gf_usd.model import Floats


def order(h: Floats, error: Floats) -> float:
    """Slope of ln error over ln h, by least squares."""
    return float(np.polyfit(np.log(h), np.log(np.abs(error)), 1)[0])


def frequency(t: Floats, q: Floats, guess: float) -> float:
    """Angular frequency of q = a cos(w t) + b sin(w t) + c, by least squares from a guess."""

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
