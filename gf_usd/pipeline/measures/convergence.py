"""How certain a figure is, from the same motion at three resolutions.

With values f1, f2, f3 at spacings h, 2 h and 4 h, finest first, and an error that falls as h^p,

    p = log2(|f3 - f2| / |f2 - f1|)        f = f1 + (f1 - f2) / (2^p - 1)

are the observed order and the value that the sequence tends to (Richardson, Phil. Trans. A 210,
1911; Roache, Annual Review of Fluid Mechanics 29, 1997).  The interval is

    f +- max(S |f1 - f2| / (2^p - 1), C |f2 - f3|)

with p kept between 1 and 2, the orders that contact and smooth motion have here: three runs are not
enough to believe a higher one, and a lower one is that of runs which are still too coarse (Eca and
Hoekstra, J. Comput. Phys. 262, 2014, do alike, with larger S where p is out of its range).  Vectors
have norms instead of magnitudes.  S, C and the limits were chosen by the coverage that
tools/acceptance/certify.py measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats

LOWEST, HIGHEST = 1.0, 2.0  # orders that are believed
SAFETY = 1.0  # half width over the distance from f1 to the limit
COARSE = 0.08  # half width over |f2 - f3|, at least: f1 - f2 may be small by luck
SWINGING = 0.6  # half width over the larger of |f1 - f2| and |f2 - f3| / 2, where signs alternate
SMALL = 0.02  # of the scale: differences that do not shrink, yet hardly matter
UNORDERED = 1.25  # half width over the largest of them
TINY = 1e-6  # of the scale: float32 holds no finer difference
PARTED = 0.02  # of the scale: curves that are farther apart, and come no closer, have parted
WIDEST = 0.5  # of the scale: a wider band says nothing


@dataclass(frozen=True, kw_only=True)
class Interval:
    """What is known of a figure."""

    fine: Floats  # (k,) at the full resolution
    value: Floats  # (k,) middle of the interval; of a vector the center of a ball
    half: float  # half of its width, or the radius
    order: float | None = None  # observed; None: there is none to see
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
        """Plain values; what is not known is None."""
        known = self.known
        return {
            "fine": self.fine.tolist(),
            "value": self.value.tolist() if known else None,
            "half_width": self.half if known else None,
            "order": self.order,
            "reason": self.reason,
        }


def unknown(fine: Floats, reason: str) -> Interval:
    """A figure without an interval."""
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
    """An interval of which the part above `most` is known to be impossible.

    As it was, where that would leave out the value at the full resolution.
    """
    low, high = interval.value[0] - interval.half, interval.value[0] + interval.half
    if not interval.known or high <= most or max(low, float(interval.fine[0])) >= most:
        return interval
    return replace(interval, value=np.array([0.5 * (low + most)]), half=0.5 * (most - low))


@dataclass(frozen=True, kw_only=True)
class Band:
    """What is known of a curve over T frames."""

    half: Floats = field(repr=False)  # (T,) half width about the fine curve; NaN where unknown
    until: int  # frames from the first that are known; T: all
    reason: str = ""  # why the others are not
    parts: bool = False  # somewhere among the others the finer runs are no closer than the coarser


def band(curves: Sequence[Floats], scale: float) -> Band:
    """The band of a curve from the same at h, 2 h and 4 h, (T, k) each.

    Errors add up over time: the differences are the largest so far.  Where those of the finer pair
    are no smaller than those of the coarser one, or the band is wider than WIDEST, the curves have
    parted, and from there on nothing is known.
    """
    count = min(len(one) for one in curves)
    fine, half, quarter = (np.asarray(one, float)[:count] for one in curves)
    d1 = np.maximum.accumulate(np.linalg.norm(fine - half, axis=1))
    d2 = np.maximum.accumulate(np.linalg.norm(half - quarter, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        p = np.clip(np.nan_to_num(np.log2(d2 / d1), nan=HIGHEST, posinf=HIGHEST), LOWEST, HIGHEST)
    # about the fine curve: from it to the limit, and as far beyond as the interval of a figure
    width = (1.0 + SAFETY) * d1 / (2.0**p - 1.0) + COARSE * d2
    parted = (d1 >= d2) & (d1 > PARTED * scale)
    lost = parted | (width > WIDEST * scale)
    until = int(lost.argmax()) if lost.any() else count
    reason = ""
    if until < count and parted[until]:
        reason = (
            f"the run at half of the resolution differs by {d1[until]:.3g} m, which is no less "
            f"than the {d2[until]:.3g} m of the run at a quarter"
        )
    elif until < count:
        reason = f"it is uncertain by {width[until]:.3g} m"
    width = np.maximum(width, TINY * scale)
    width[until:] = np.nan
    return Band(half=width, until=until, reason=reason, parts=bool(parted.any()))
