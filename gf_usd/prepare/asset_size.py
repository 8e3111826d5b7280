"""How large an asset is, and whether its unit is likely wrong."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import ASSUMED, Asset
from gf_usd.core.units import PLAUSIBLE, number_text

HUGE, TINY = 30.0, 0.005  # [m] beyond these the unit is more likely wrong than the asset odd
UNIT = "--meters-per-unit"
COMMON_UNITS = (0.01, 1.0, 0.001)  # [m]


def size(asset: Asset) -> Floats:
    """(3,) [m] of the box around all surfaces."""
    low = np.min([s.face_points.min(0) for s in asset.surfaces], axis=0)
    high = np.max([s.face_points.max(0) for s in asset.surfaces], axis=0)
    return high - low


def implausible_size(asset: Asset) -> str:
    """A warning where the asset is so large or small that its unit is likely wrong; else ""."""
    unit = asset.facts.units.meters_per_unit
    width = float(size(asset).max())
    units = width / unit
    # An assumed unit deserves less trust than one that somebody wrote down.
    least = PLAUSIBLE[0] if asset.facts.unit_from == ASSUMED else TINY
    if least <= width <= HUGE:
        return ""
    likely = [u for u in COMMON_UNITS if u != unit and PLAUSIBLE[0] <= units * u <= PLAUSIBLE[1]]
    # Of the units that fit, a tiny asset gets the largest and a huge one the first in the list.
    fitting = max(likely, default=None) if width < least else next(iter(likely), None)
    count = f"{units:.4g}"
    of_unit = f"unit{'s' * (count != '1')} of {unit:g} m"
    measured = f"the asset is {number_text(width)} m wide: {count} {of_unit}"
    if fitting is None:
        return f"{measured}; check its unit ({UNIT})"
    return f"{measured}; with {UNIT} {fitting:g} it would be {units * fitting:.3g} m"
