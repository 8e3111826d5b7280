"""Broad phase: bodies and obstacles that are near each other, and for how long they are.

A pair whose boxes are apart is left alone until they could have come together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.narrow_phase import Obstacle, box_gap


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
        return cls(low=x.min(0), high=x.max(0), mean=mean, spread=fastest)


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

    def judge(gap: float, speed: float, *pairs: tuple[int, int]) -> float:
        # What no sample faces yet is farther than that off, or comes from beyond the box.
        if gap < reach:
            near.extend(pairs)
        return max(reach, gap - spacing) / max(speed + fall, 1e-30)

    speeds = [obstacle.speed(frame) for obstacle in obstacles]

    rests = [still is not None and bool(still[k]) for k in range(len(boxes))]
    for a, mine in enumerate(boxes):
        for b, other in enumerate(boxes[:a]):
            if (a, b) in contact_setup.through or (b, a) in contact_setup.through:
                continue
            if rests[a] and rests[b]:
                continue
            speed = float(np.linalg.norm(mine.mean - other.mean)) + mine.spread + other.spread
            gap = box_gap(mine.low, mine.high, other.low, other.high)
            hold = min(hold, judge(gap, speed, (a, b), (b, a)))
        for k, obstacle in enumerate(obstacles):
            if (a, k) in contact_setup.through_colliders or (rests[a] and speeds[k] == 0.0):
                continue
            speed = float(np.linalg.norm(mine.mean)) + mine.spread + speeds[k]
            hold = min(hold, judge(obstacle.gap(mine.low, mine.high), speed, (a, -1 - k)))
    return near, hold
