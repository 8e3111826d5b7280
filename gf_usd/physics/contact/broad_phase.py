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

from gf_usd.core.arrays import Floats, Ints, corners
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.obstacles.obstacle import Obstacle

FAR = 1e30  # [m]


@dataclass(frozen=True, kw_only=True)
class Box:
    """Bounding box and velocity range of a body."""

    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    mean: Floats  # (3,) [m/s] of its samples
    spread: float  # [m/s] largest deviation from the mean

    @classmethod
    def around(cls, x: Floats, v: Floats) -> Box:
        """The box of samples at x (n, 3) [m] with v (n, 3) [m/s]; without any, far from all."""
        if not len(x):
            far = np.full(3, FAR)
            return cls(low=far, high=-far, mean=np.zeros(3), spread=0.0)
        mean = v.mean(0)
        off = v - mean
        fastest = float(np.sqrt(np.einsum("na,na->n", off, off).max()))
        low, high = corners(x)
        return cls(low=low, high=high, mean=mean, spread=fastest)


def schedule(
    boxes: Sequence[Box],
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

    low, high = np.array([box.low for box in boxes]), np.array([box.high for box in boxes])
    mean, spread = np.array([box.mean for box in boxes]), np.array([box.spread for box in boxes])
    speeds = [obstacle.speed(frame) for obstacle in obstacles]
    rests = np.zeros(len(boxes), bool) if still is None else np.asarray(still, bool)
    through: dict[int, list[int]] = {}
    for one, other in contact_setup.through:
        through.setdefault(max(one, other), []).append(min(one, other))

    early = frame < contact_setup.meet_from
    for a, mine in enumerate(boxes):
        met = ~rests[:a] if rests[a] else np.ones(a, bool)
        met &= not early
        met[through.get(a, [])] = False
        others = np.flatnonzero(met)
        apart = np.maximum(np.maximum(low[others] - mine.high, mine.low - high[others]), 0.0)
        gap = np.sqrt((apart * apart).sum(1))
        drift = mean[others] - mine.mean
        hold = min(hold, until(gap, np.sqrt((drift * drift).sum(1)) + mine.spread + spread[others]))
        for b in others[gap < reach].tolist():
            near += [(a, b), (b, a)]
        for k, obstacle in enumerate(obstacles):
            if (a, k) in contact_setup.through_colliders or (rests[a] and speeds[k] == 0.0):
                continue
            speed = float(np.linalg.norm(mine.mean)) + mine.spread + speeds[k]
            away = obstacle.gap(mine.low, mine.high)
            hold = min(hold, until(np.array([away]), np.array([speed])))
            if away < reach:
                near.append((a, -1 - k))
    return near, hold


@dataclass(frozen=True, kw_only=True)
class BroadPhase:
    """The broad phase between all bodies of a scene, and with its obstacles."""

    members: Sequence[Ints]  # samples of each body
    obstacles: Sequence[Obstacle]
    contact_setup: ContactSetup
    reach: float  # [m] distance within which contact is considered
    spacing: float  # [m]

    def boxes(self, x: Floats, v: Floats) -> list[Box]:
        """Those of each body with samples at x (n, 3) [m] with v (n, 3) [m/s]."""
        return [Box.around(x[m], v[m]) for m in self.members]

    def pairs(
        self, boxes: Sequence[Box], frame: float, pull: float, still: Ints | None = None
    ) -> tuple[list[tuple[int, int]], float]:
        """See `schedule`."""
        if len(self.members) == 1 and not self.obstacles:
            return [], float("inf")
        return schedule(
            boxes, self.obstacles, self.contact_setup, frame=frame, pull=pull, reach=self.reach,
            spacing=self.spacing, still=still,
        )  # fmt: skip
