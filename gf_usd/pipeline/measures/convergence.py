"""Uncertainty of a figure by Richardson extrapolation from three resolutions.

With values f1, f2, f3 at spacings h, 2 h and 4 h, finest first, and an error that falls as h^p,

    p = log2(|f3 - f2| / |f2 - f1|)        f = f1 + (f1 - f2) / (2^p - 1)

are the observed order and the value that the sequence tends to (Richardson, Phil. Trans. A 210,
1911; Roache, Annual Review of Fluid Mechanics 29, 1997).  The interval is

    f +- max(S |f1 - f2| / (2^p - 1), C |f2 - f3|)

with p limited to [1, 2], the orders of contact and of smooth motion in this method: three runs are
no evidence of a higher order, and a lower one indicates runs that are still too coarse (Eca and
Hoekstra, J. Comput. Phys. 262, 2014, limit p alike, with larger S outside the range).  For vectors,
magnitudes are norms.  S, C and the limits were chosen by the coverage that
tools/acceptance/certify.py measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.units import length_text

LOWEST, HIGHEST = 1.0, 2.0  # accepted range of the order
SAFETY = 1.0  # half width over the distance from f1 to the limit
COARSE = 0.08  # least half width over |f2 - f3|: f1 - f2 can be small coincidentally
SWINGING = 0.6  # half width over the larger of |f1 - f2| and |f2 - f3| / 2, where signs alternate
SMALL = 0.02  # of the scale: differences that are accepted without convergence
UNORDERED = 1.25  # half width over the largest of these differences
TINY = 1e-6  # of the scale: the resolution of float32
DIVERGED = 0.02  # of the scale: curves that differ by more, without convergence, have diverged
WIDEST = 0.5  # of the scale: a wider band is useless


@dataclass(frozen=True, kw_only=True)
class Interval:
    """The value of a figure and its uncertainty."""

    fine: Floats  # (k,) at the full resolution
    value: Floats  # (k,) middle of the interval; of a vector the center of a ball
    half: float  # half of its width, or the radius
    order: float | None = None  # observed order of convergence; None: not defined
    reason: str = ""  # why there is no interval; "" where there is one

    @property
    def known(self) -> bool:
        """Whether there is an interval."""
        return not self.reason

    @property
    def relative(self) -> float:
        """Half width over the magnitude of the value."""
        size = float(np.linalg.norm(self.value))
        return self.half / size if size else np.inf

    def as_json(self) -> dict[str, Any]:
        """Plain values; None for unknown ones."""
        known = self.known
        return {
            "fine": self.fine.tolist(),
            "value": self.value.tolist() if known else None,
            "half_width": self.half if known else None,
            "order": self.order,
            "reason": self.reason,
        }


def unknown(fine: Floats, reason: str) -> Interval:
    """An interval that is unknown, with the reason."""
    return Interval(fine=fine, value=fine, half=float("nan"), reason=reason)


def estimate(values: Sequence[Floats], scale: float, least: float = 0.0) -> Interval:
    """The interval of a figure from its values (k,) at h, 2 h and 4 h.

    scale : a magnitude of the figure, by which differences are small or large.
    least : half width that no interval is narrower than, once its values differ: where particles
    and contact samples lie has an effect that does not fall smoothly with h.
    """
    fine, half, quarter = (np.asarray(one, float) for one in values)
    step, before = fine - half, half - quarter
    d1, d2 = float(np.linalg.norm(step)), float(np.linalg.norm(before))
    order = float(np.log2(d2 / d1)) if min(d1, d2) > TINY * scale else None
    if max(d1, d2) <= TINY * scale:
        return Interval(fine=fine, value=fine, half=max(d1, d2, TINY * scale))
    if d1 >= d2:
        if d1 > SMALL * scale:
            return unknown(
                fine,
                f"it changes by {d2:.3g} from a quarter to half of the resolution and by "
                f"{d1:.3g} from half to full resolution: the differences do not decrease",
            )
        return Interval(fine=fine, value=fine, half=max(UNORDERED * d1, least), order=order)
    if float(step @ before) < 0.0:
        width = max(SWINGING * max(d1, 0.5 * d2), least)
        return Interval(fine=fine, value=fine, half=width, order=order)
    p = min(max(np.log2(d2 / d1), LOWEST), HIGHEST) if d1 else HIGHEST
    ratio = 2.0**p - 1.0
    width = max(SAFETY * d1 / ratio, COARSE * d2, least)
    return Interval(fine=fine, value=fine + step / ratio, half=width, order=order)


def capped(interval: Interval, most: float) -> Interval:
    """The interval without its part above the upper limit `most`.

    Unchanged where that would exclude the value at the full resolution.
    """
    low, high = interval.value[0] - interval.half, interval.value[0] + interval.half
    if not interval.known or high <= most or max(low, float(interval.fine[0])) >= most:
        return interval
    return replace(interval, value=np.array([0.5 * (low + most)]), half=0.5 * (most - low))


@dataclass(frozen=True, kw_only=True)
class Band:
    """The uncertainty of a curve over T frames."""

    half: Floats = field(repr=False)  # (T,) half width about the fine curve; NaN where unknown
    until: int  # number of leading frames with a known band; T: all
    reason: str = ""  # why the band of the others is unknown
    parts: bool = False  # in some of the others the finer runs differ no less than the coarser ones


def band(curves: Sequence[Floats], scale: float) -> Band:
    """The band of a curve from its values at h, 2 h and 4 h, (T, k) each.

    Errors accumulate over time, so differences are running maxima. Where the difference of the
    finer pair is no smaller than that of the coarser pair, or the band is wider than WIDEST, the
    curves have diverged, and the band is unknown from there on.
    """
    count = min(len(one) for one in curves)
    fine, half, quarter = (np.asarray(one, float)[:count] for one in curves)
    d1 = np.maximum.accumulate(np.linalg.norm(fine - half, axis=1))
    d2 = np.maximum.accumulate(np.linalg.norm(half - quarter, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        p = np.clip(np.nan_to_num(np.log2(d2 / d1), nan=HIGHEST, posinf=HIGHEST), LOWEST, HIGHEST)
    # about the fine curve: its distance from the limit, plus the half width of a figure's interval
    width = (1.0 + SAFETY) * d1 / (2.0**p - 1.0) + COARSE * d2
    diverged = (d1 >= d2) & (d1 > DIVERGED * scale)
    lost = diverged | (width > WIDEST * scale)
    until = int(lost.argmax()) if lost.any() else count
    reason = ""
    if until < count and diverged[until]:
        reason = (
            f"the run at half of the resolution differs by {length_text(d1[until])}, which is no"
            f" less than the {length_text(d2[until])} of the run at a quarter"
        )
    elif until < count:
        reason = f"it is uncertain by {length_text(width[until])}"
    width = np.maximum(width, TINY * scale)
    width[until:] = np.nan
    return Band(half=width, until=until, reason=reason, parts=bool(diverged.any()))
