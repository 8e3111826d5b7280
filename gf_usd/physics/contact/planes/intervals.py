"""How long the planes of one detection hold: until samples touch them, or have slid too far.

These times follow from the speeds at the detection.  A body that is stopped, or that was compressed
and rebounds, may be faster: whether a detection was late is known at the next one (`Lateness`).
"""

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
    speed = v[rows] - planes.interpolated_to(rows, v) - planes.velocity[rows]
    closing = -row_dots(speed, planes.normal[rows])
    nears = closing > 0.0
    return float((left[nears] / (growth * closing[nears])).min(initial=np.inf))


def until_stopped(height: Floats, closing: Floats, pull: float, distance: float) -> float:
    """[s] until a body that moves with one of these samples has moved by a distance [m] since the
    sample was stopped.

    A floor stops a sample at once, while a body in contact that had no velocity relative to the
    sample moves on: their relative velocity at the detection does not show that it will approach.

    height : (n,) [m] of the samples above the surface that stops them; closing : (n,) [m/s] of
    their approach to it; pull : [m/s^2] bound of their acceleration until then.
    """
    above, speed = np.maximum(height, 0.0), np.maximum(closing, 0.0)
    landing = np.sqrt(speed * speed + 2.0 * pull * above)  # [m/s]
    falls = 2.0 * above / np.maximum(speed + landing, 1e-30)
    return float((falls + distance / np.maximum(landing, 1e-30)).min(initial=np.inf))


def until_slid(planes: ContactPlanes, distance: Floats, v: Floats) -> float:
    """[s] until a sample has moved by `distance` (n,) [m] against its plane; v : (n, 3) [m/s]."""
    rows = planes.facing
    speed = lengths(v[rows] - planes.interpolated_to(rows, v) - planes.velocity[rows])
    return float((distance[rows] / np.maximum(speed, 1e-30)).min(initial=np.inf))


LATE = 1.125  # of the time that a detection held, up to which the next one is not late
SOONEST = 0.25  # least interval of detections in a repetition, relative to the first attempt
REPEATS = 3  # of a frame


class Lateness:
    """Whether a detection of a frame was late, and the time between two when it is repeated."""

    def __init__(self) -> None:
        self._start = self._bound = np.inf  # [s] from when on, and the time
        self._found: tuple[float, float] | None = None  # the same, for a repetition
        self._repeats = 0

    def renew(self) -> None:
        """Drop the results of the frame before."""
        self._start = self._bound = np.inf
        self._found, self._repeats = None, 0

    def begin(self) -> None:
        """An attempt at a frame begins."""
        self._found = None

    def bound(self, time: float) -> float:
        """[s] that may pass until the detection after one at a time [s]."""
        return self._bound if time >= self._start else np.inf

    @property
    def repeats(self) -> bool:
        """Whether the frame is a repetition."""
        return self._repeats > 0

    def note(self, time: float, took: float, held: float, dt: float) -> None:
        """A detection at a time [s] was the last for `took` [s], and by the motion of the bodies
        since then it held for `held` [s].

        dt : [s] of a substep; detections are no sooner.
        """
        if self._found is None and took > max(LATE * held, 1.5 * dt):
            self._found = time, took * max(SOONEST, 0.8 * held / took)

    def repeat(self) -> bool:
        """Whether the frame is to be repeated, with detections at shorter intervals."""
        if self._found is None or self._repeats == REPEATS:
            return False
        start, bound = self._found
        self._start, self._bound = min(start, self._start), min(bound, self._bound)
        self._repeats += 1
        self._found = None
        return True
