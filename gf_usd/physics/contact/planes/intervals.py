"""How long the planes of one detection hold: until samples touch them, or have slid too far."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats, lengths, row_dots
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes


def until_contact(planes: ContactPlanes, gap: Floats, v: Floats, growth: float) -> float:
    """[s] for which no sample touches its plane; inf where none comes nearer.

    gap : (n,) [m] that is left; v : (n, 3) [m/s]; growth : factor by which speeds may grow.
    """
    rows = planes.facing
    left = gap[rows]
    if (left <= 0.0).any():
        return 0.0
    f = planes.of(rows)
    closing = -row_dots(v[rows] - f.interpolated(v) - f.velocity, f.normal)
    nears = closing > 0.0
    return float((left[nears] / (growth * closing[nears])).min(initial=np.inf))


def until_stopped(height: Floats, closing: Floats, pull: float, distance: float) -> float:
    """[s] until what moves with one of these samples has moved on by a distance [m] after a stop.

    A floor stops a part of a body at once, and what moves along with it and has no velocity
    relative to it goes on.

    height : (n,) [m] above what stops the samples; closing : (n,) [m/s] at which they come nearer;
    pull : [m/s^2] at which they may gain speed until then.
    """
    above, speed = np.maximum(height, 0.0), np.maximum(closing, 0.0)
    landing = np.sqrt(speed * speed + 2.0 * pull * above)  # [m/s]
    falls = 2.0 * above / np.maximum(speed + landing, 1e-30)
    return float((falls + distance / np.maximum(landing, 1e-30)).min(initial=np.inf))


def until_slid(planes: ContactPlanes, distance: Floats, v: Floats) -> float:
    """[s] until a sample has moved by `distance` (n,) [m] against its plane; v : (n, 3) [m/s]."""
    rows = planes.facing
    f = planes.of(rows)
    speed = lengths(v[rows] - f.interpolated(v) - f.velocity)
    return float((distance[rows] / np.maximum(speed, 1e-30)).min(initial=np.inf))
