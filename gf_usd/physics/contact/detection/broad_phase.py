"""Broad phase: pairs of bodies and obstacles that are near each other, and for how long.

A pair whose bounding boxes are separated is skipped until they could overlap.

For self-contact a surface is divided into patches, and all pairs of patches are compared. Separated
ones are skipped until they could be in contact, and pairs that are neighbors at rest until the
surface between them is folded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, Segments, lengths
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.obstacles.obstacle import Obstacle, box_gap

FAR = 1e30  # [m]
BLOCK = 100_000  # pairs of bodies that are compared at once


@dataclass(frozen=True, kw_only=True)
class Boxes:
    """Bounding boxes and velocity ranges of B bodies."""

    low: Floats  # (B, 3) [m]
    high: Floats  # (B, 3) [m]
    mean: Floats  # (B, 3) [m/s] of their samples
    spread: Floats  # (B,) [m/s] largest deviation from the mean

    @classmethod
    def around(cls, samples: Segments, x: Floats, v: Floats) -> Boxes:
        """Those of samples at x (n, 3) [m] with v (n, 3) [m/s]; without any, far from all."""
        mean = samples.means(v)
        return cls(
            low=samples.least(x, FAR), high=samples.largest(x, -FAR),
            mean=mean, spread=samples.largest_deviation(v, mean),
        )  # fmt: skip


def schedule(
    boxes: Boxes,
    obstacles: Sequence[Obstacle],
    contact_setup: ContactSetup,
    *,
    frame: float,
    pull: float,
    reach: float,
    spacing: float,
    still: Ints | None = None,
) -> tuple[list[tuple[int, int]], float]:
    """Which pairs (body, body or -1 - obstacle) are near, and for how long [s] that holds.

    frame : time of the obstacles; pull : [m/s^2] bound of the acceleration by gravity and fields;
    reach : [m] distance within which contact is considered.
    still : (B,) bodies that do not move: pairs of two static partners are omitted.
    """
    near: list[tuple[int, int]] = []
    hold = float("inf")

    def until(gap: Floats, speed: Floats) -> float:
        # Surfaces without a plane yet are beyond this distance, or outside of the box.
        left = np.maximum(reach, gap - spacing)
        # the root t of  speed t + pull t^2 / 2 = left
        fastest = speed + np.sqrt(speed * speed + 2.0 * pull * left)
        return float((2.0 * left / np.maximum(fastest, 1e-30)).min(initial=np.inf))

    low, high, mean, spread = boxes.low, boxes.high, boxes.mean, boxes.spread
    count = len(spread)
    rests = np.zeros(count, bool) if still is None else np.asarray(still, bool)
    through = np.array([(max(p), min(p)) for p in contact_setup.through], np.int64).reshape(-1, 2)
    if frame >= contact_setup.meet_from:
        rows = max(1, BLOCK // max(1, count))
        for first in range(0, count, rows):
            some = np.arange(first, min(first + rows, count))
            met = (np.arange(count) < some[:, None]) & ~(rests & rests[some, None])
            apart = through[(through[:, 0] >= first) & (through[:, 0] <= some[-1])]
            met[apart[:, 0] - first, apart[:, 1]] = False
            a, b = np.nonzero(met)
            a += first
            gap = box_gap(low[a], high[a], low[b], high[b])
            hold = min(hold, until(gap, lengths(mean[b] - mean[a]) + spread[a] + spread[b]))
            close = gap < reach
            for one, other in zip(a[close].tolist(), b[close].tolist()):
                near += [(one, other), (other, one)]
    own_speed = lengths(mean) + spread
    for k, obstacle in enumerate(obstacles):
        speed = obstacle.speed(frame)
        met = np.ones(count, bool) if speed > 0.0 else ~rests
        met[[body for body, other in contact_setup.through_colliders if other == k]] = False
        bodies = np.flatnonzero(met)
        gap = obstacle.gaps(low[bodies], high[bodies])
        hold = min(hold, until(gap, own_speed[bodies] + speed))
        near += [(body, -1 - k) for body in bodies[gap < reach].tolist()]
    return near, hold


@dataclass(frozen=True, kw_only=True)
class BroadPhase:
    """The broad phase between all bodies of a scene, and with its obstacles."""

    samples: Segments  # of each body
    obstacles: Sequence[Obstacle]
    contact_setup: ContactSetup
    reach: float  # [m] distance within which contact is considered
    spacing: float  # [m]

    def boxes(self, x: Floats, v: Floats) -> Boxes:
        """Those of each body with samples at x (n, 3) [m] with v (n, 3) [m/s]."""
        return Boxes.around(self.samples, x, v)

    def pairs(
        self, boxes: Boxes, frame: float, pull: float, still: Ints | None = None
    ) -> tuple[list[tuple[int, int]], float]:
        """See `schedule`."""
        if len(boxes.spread) == 1 and not self.obstacles:
            return [], float("inf")
        return schedule(
            boxes, self.obstacles, self.contact_setup, frame=frame, pull=pull, reach=self.reach,
            spacing=self.spacing, still=still,
        )  # fmt: skip
