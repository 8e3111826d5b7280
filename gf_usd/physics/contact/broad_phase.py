"""Broad phase: bodies and obstacles that are near each other, and for how long they are.

A pair whose boxes are apart is left alone until they could have come together.

Parts of one body: its surface is divided into patches, and every pair of them is compared.  Those
that are apart are left alone until they could have come together, those that are neighbors at rest
until the surface is folded between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.obstacles import Obstacle


@dataclass(frozen=True, kw_only=True)
class Box:
    """A body as others come near it."""

    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    mean: Floats  # (3,) [m/s] of its samples
    spread: float  # [m/s] the fastest of them against the mean

    @classmethod
    def around(cls, x: Floats, v: Floats) -> Box:
        """Of samples at x (n, 3) [m] with v (n, 3) [m/s]."""
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
    fall: float,
    reach: float,
    spacing: float,
    still: Ints | None = None,
) -> tuple[list[tuple[int, int]], float]:
    """Which pairs (body, body or -1 - obstacle) are near, and for how long [s] that holds.

    frame : where the obstacles are; fall : [m/s] that gravity adds until the next detection;
    reach : [m] from where something is faced; bodies `still` (B,) do not move: what does not either
    is no concern of theirs.
    """
    near: list[tuple[int, int]] = []
    hold = float("inf")

    def until(gap: Floats, speed: Floats) -> float:
        # What no sample faces yet is farther than that off, or comes from beyond the box.
        left = np.maximum(reach, gap - spacing) / np.maximum(speed + fall, 1e-30)
        return float(left.min(initial=np.inf))

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
