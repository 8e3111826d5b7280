"""Persistence: bodies from whose samples a detection need not search again.

Bodies that rest on each other are in contact at the same places for many frames. The planes of all
samples of a body are kept if, from the search that found them until the next detection,

- no sample moves along its plane by more than `CREEP`, or `RISE` of its height above it: next to an
  edge or a corner a plane is tilted, and would stop a body that slides on like a wall,
- no body or obstacle nearby has approached by more than `APPROACH`, or can come within reach of a
  sample that is not in contact with it: the difference of the mean motions of two bodies, and the
  motions of their samples relative to these means, add up to no more than the reach,
- no other body or obstacle comes near, and no obstacle that was near has moved or will move,
- the body is not deformed by more than `DEFORMED`, and it cannot come near itself before the next
  detection.

The motion until now is known; that until the next detection follows from the present speeds, as do
the intervals between detections. Planes that are still shifted from the true surface, to conserve
the energy of the springs (`continuity`), are searched again at every detection, which reduces the
shift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, Segments, gather, lengths, row_dots
from gf_usd.physics.contact.detection.broad_phase import Boxes
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes

CREEP = 0.02  # [spacings] largest motion of a sample along a kept plane that it touches
RISE = 0.25  # of its height above the plane: additional motion of a sample that does not touch it
APPROACH = 0.5  # [spacings] largest approach of a body or obstacle nearby
DEFORMED = 0.5  # [spacings] largest motion of a sample relative to the mean of its body
SHIFTED = 0.05  # [spacings] largest shift of a kept plane from the true surface

SAVED = (
    *("x", "place", "offset", "slide", "stay", "near", "mean", "path", "way", "own_until"),
    *("valid", "last"),
)


@dataclass(frozen=True, kw_only=True)
class Outlook:
    """The motion from a detection until the next one, as expected at the detection."""

    x: Floats  # (n + m, 3) [m] of samples and points of obstacles
    v: Floats  # (n + m, 3) [m/s]
    mean: Floats  # (B, 3) [m/s] of each body
    spread: Floats  # (B,) [m/s] largest deviation of a sample from it
    near: Ints  # (B, O + B) whether a body is near an obstacle, or near another body
    moving: Ints  # (O,) whether an obstacle moves
    pull: float  # [m/s^2] bound of the acceleration by gravity and fields
    time: float  # [s] of the detection
    span: float  # [s] until the next one, at most

    @property
    def near_moving(self) -> Ints:
        """(B,) bodies that are near an obstacle that moves."""
        return np.asarray((self.near[:, : len(self.moving)] & self.moving).any(1))

    def hardly_moving(self, distance: float) -> Ints:
        """(B,) bodies of which no sample moves by more than a distance [m]."""
        return self.span * (lengths(self.mean) + self.spread) <= distance

    @classmethod
    def of(
        cls, x: Floats, v: Floats, boxes: Boxes, pairs: Sequence[tuple[int, int]],
        moving: Sequence[bool], *, pull: float, time: float, span: float,
    ) -> Outlook:  # fmt: skip
        """From the boxes of all bodies and the pairs of `broad_phase.schedule`."""
        obstacles, bodies = len(moving), len(boxes.spread)
        near = np.zeros((bodies, obstacles + bodies), bool)
        for body, other in pairs:
            near[body, obstacles + other if other >= 0 else -1 - other] = True
        return cls(
            x=x, v=v, mean=boxes.mean, spread=boxes.spread, near=near,
            moving=np.array(moving, bool), pull=pull, time=time, span=span,
        )  # fmt: skip


class Persistence:
    """What the last search from each of B bodies found.

    members : the samples of each; obstacles : their number O; X : (n, 3) [m] of the samples at
    rest, and of m points of obstacles; reach : [m] within which contact is searched.
    """

    def __init__(
        self, members: Sequence[Ints], obstacles: int, X: Floats, *, reach: float, spacing: float
    ) -> None:
        n, count = len(X), len(members)
        self._samples, self._reach, self._spacing = Segments(members), reach, spacing
        self._of = np.zeros(sum(map(len, members)), np.int64)
        for k, m in enumerate(members):
            self._of[m] = k
        self.x = X.copy()  # (n, 3) [m] of the samples then
        self.place = np.zeros((n, 3))  # [m] points of their planes
        self.offset = np.zeros(n)  # [m] gaps less the distances from the planes
        self.slide = np.zeros(n)  # [m] that a sample may move along its plane
        self.stay = np.zeros(n)  # [m] the same of a kept plane
        self.near = np.zeros((count, obstacles + count), bool)  # see `Outlook`
        self.mean = np.zeros((count, count, 3))  # [m] of all bodies, at the search from each
        self.path = np.zeros((count, count))  # [m] `way` of all bodies, then
        self.own_until = np.zeros(count)  # [s] until when a body cannot come near itself
        self.valid = np.zeros(count, bool)  # whether there is such a search
        # [m] sum over detections of the largest motion of a sample relative to its body's mean
        self.way = np.zeros(count)
        self.last = X[: len(self._of)].copy()  # (n, 3) [m] of samples at the last detection

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {f"contact_kept_{name}": getattr(self, name).copy() for name in SAVED}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        for name in SAVED:
            setattr(self, name, np.array(saved[f"contact_kept_{name}"]))

    def forget(self, bodies: Ints) -> None:
        """The planes of bodies (k,) were removed."""
        self.valid[bodies] = False

    def follow(self, x: Floats) -> None:
        """Count how the bodies were deformed since the last detection; x : (n, 3) [m] now."""
        x = x[: len(self._of)]
        step = x - self.last
        self.way = self.way + self._samples.largest_deviation(step, self._samples.means(step))
        self.last = x

    def kept(self, planes: ContactPlanes, now: Outlook) -> Ints:
        """(B,) bodies whose planes may be kept until the next detection."""
        kept = self.valid & (self.own_until >= now.time + now.span)
        kept &= ~(now.near & ~self.near).any(1) & ~now.near_moving
        own = self.way - self.path.diagonal()
        kept &= own + now.span * now.spread <= DEFORMED * self._spacing
        if kept.any():
            kept &= ~self._approaches_far(now)
        if kept.any():
            kept &= ~self._slid(planes, now)
        return kept

    def approaches(self, x: Floats) -> Floats:
        """(B,) [m] by which bodies and what was near them may have approached since the search
        from each, at most; 0 where nothing was.

        x : (n, 3) [m] of the samples now.
        """
        out = np.zeros(len(self.way))
        a, _, far = self._approached(x)
        np.maximum.at(out, a, far)
        return out

    def _approached(self, x: Floats) -> tuple[Ints, Ints, Floats]:
        """Pairs (k,) of a body and what was near it, -1: an obstacle, which does not move, and
        (k,) [m] by which they may have approached.
        """
        means, bodies = self._samples.means(x), np.arange(len(self.way))
        obstacles = self.near.shape[1] - len(bodies)
        a, b = np.nonzero(self.near)
        b = np.where(b < obstacles, -1, b - obstacles)
        drift = means - self.mean[bodies, bodies]
        way = self.way - self.path.diagonal()
        others = np.where((b >= 0)[:, None], means[b] - self.mean[a, b], 0.0)
        far = lengths(others - drift[a]) + way[a]
        return a, b, far + np.where(b >= 0, self.way[b] - self.path[a, b], 0.0)

    def _approaches_far(self, now: Outlook) -> Ints:
        """(B,) bodies that something near has approached by more than `APPROACH`, or may come
        within reach of until the next detection.
        """
        a, b, far = self._approached(now.x)
        v = np.where((b >= 0)[:, None], now.mean[b], 0.0)
        speed = lengths(v - now.mean[a]) + now.spread[a] + np.where(b >= 0, now.spread[b], 0.0)
        ahead = now.span * speed + 0.5 * now.pull * now.span**2
        too_far = (far > APPROACH * self._spacing) | (far + ahead > self._reach)
        return np.bincount(a[too_far], minlength=len(self.way)) > 0

    def slid(self, planes: ContactPlanes, x: Floats) -> Floats:
        """(n + m,) [m] by which samples, and points of obstacles, have moved along their planes
        since the search.
        """
        out, rows = np.zeros(len(x)), planes.facing
        place = gather(planes.point, rows) + planes.interpolated_to(rows, x)
        way = gather(x, rows) - gather(self.x, rows)
        out[rows] = lengths(way - (place - gather(self.place, rows)))
        return out

    def _slid(self, planes: ContactPlanes, now: Outlook) -> Ints:
        """(B,) bodies of which a sample moves too far along its plane."""
        rows = planes.facing
        rate = planes.interpolated_to(rows, now.v)
        speed = lengths(gather(now.v, rows) - rate - gather(planes.velocity, rows))
        far = self.slid(planes, now.x)[rows] + now.span * speed > self.stay[rows]
        of = planes.bodies(self._of)
        return np.bincount(of[rows[far]], minlength=len(self.way)) > 0

    def gaps(self, planes: ContactPlanes, x: Floats) -> Floats:
        """(n + m,) [m] gaps of samples, and of points of obstacles, at x (n + m, 3) [m], by the
        motion since the search.
        """
        rows = planes.facing
        out = np.full(len(x), self._reach)
        out[: len(self._of)] -= np.minimum(self.approaches(x), self._reach)[self._of]
        out[rows] = self.offset[rows] - planes.below(x)[rows]
        return out

    def note(
        self, bodies: Ints, planes: ContactPlanes, gap: Floats, now: Outlook, *,
        slide: Floats, shift: Floats, own_until: Floats,
    ) -> None:  # fmt: skip
        """A detection has searched from the samples of bodies (k,).

        gap : (n + m,) [m] of samples and points of obstacles; slide : (n + m,) [m] that they may
        move along their planes; shift : (n + m,) [m] of the planes from the true surface;
        own_until : (B,) see `own_until`.
        """
        of = planes.bodies(self._of)
        mine = np.flatnonzero(np.isin(of, bodies))
        place = planes.point + planes.interpolated(now.x)
        below, rows = np.zeros(len(place)), planes.facing
        away = gather(place, rows) - gather(now.x, rows)
        below[rows] = row_dots(away, gather(planes.normal, rows))
        offset = gap + below
        stay = CREEP * self._spacing + RISE * np.maximum(-below, 0.0)
        for array, new in (
            (self.x, now.x), (self.place, place), (self.offset, offset), (self.slide, slide),
            (self.stay, stay),
        ):  # fmt: skip
            array[mine] = gather(new, mine)
        self.near[bodies] = now.near[bodies]
        self.mean[bodies], self.path[bodies] = self._samples.means(now.x), self.way
        self.own_until[bodies] = own_until[bodies]
        shifted = np.bincount(of[shift > SHIFTED * self._spacing], minlength=len(self.way))
        self.valid[bodies] = ((shifted == 0) & ~now.near_moving)[bodies]
