"""Medians of repeated measurements."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Median cost of something."""

    wall: float  # [s]
    cpu: float  # [s] of all threads
    spread: float  # (slowest - fastest) / median of the wall times
    memory: float = 0.0  # [bytes] peak resident


def median(runs: Sequence[tuple[float, float, float]]) -> Sample:
    """Median of (wall, cpu, memory) over the runs."""
    wall, cpu, memory = (list(column) for column in zip(*runs, strict=True))
    middle = statistics.median(wall)
    return Sample(
        wall=middle,
        cpu=statistics.median(cpu),
        spread=(max(wall) - min(wall)) / middle,
        memory=statistics.median(memory),
    )
