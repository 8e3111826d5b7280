"""Cycles that are repeated until they are periodic: when it ends, and what the notes say of it."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.settings import Settings, shortened
from gf_usd.pipeline.frames.period import PERIODIC, Period

LEAD, CYCLE, MOST, DECAY = 3, 8, 16, 0.5
FIRST = LEAD + (MOST - 1) * CYCLE


def positions(index: int, decay: float = DECAY) -> Floats:
    """(2, 3) [m]: a wave of one period, on which a transient lies that shrinks by `decay` each."""
    phase = 2.0 * np.pi * index / CYCLE
    transient = decay ** (index / CYCLE)
    return np.array([[np.cos(phase) + transient, 0.0, 0.0], [0.0, np.sin(phase), 0.0]])


def run(period: Period, decay: float = DECAY, end: int = FIRST + CYCLE) -> list[int]:
    """Indices of the samples that are simulated."""
    seen, index = [], 0
    while index < end:
        seen.append(index)
        index = period.observe(index, positions(index - period.skipped, decay)) + 1
    return seen


def test_it_ends_after_the_first_cycle_that_differs_little_enough() -> None:
    """Differences at the start of cycle k are (1 - 1/2) 2^(1 - k) 2^(-3/8)."""
    period = Period(CYCLE, MOST - 1, FIRST, 1.0, until=True)
    seen = run(period)
    largest = [(1.0 - DECAY) * DECAY ** (k - 1 + LEAD / CYCLE) for k in range(1, MOST)]
    enough = 1 + next(k for k, d in enumerate(largest, 1) if d <= PERIODIC)
    assert period.cycles == enough + 1
    assert period.difference == pytest.approx(largest[enough - 1], rel=1e-9)
    assert seen == [*range(LEAD + enough * CYCLE), *range(FIRST, FIRST + CYCLE)]
    assert period.skipped == (MOST - 1 - enough) * CYCLE
    assert "the written cycle, number" in period.notes[0]
    assert period.health["loop_cycles"] == enough + 1


def test_what_never_becomes_periodic_is_said() -> None:
    period = Period(CYCLE, MOST - 1, FIRST, 1.0, until=True)
    assert len(run(period, decay=0.99)) == FIRST + CYCLE
    assert period.skipped == 0
    assert f"the last of {MOST}, the maximum of --loop auto" in period.notes[0]
    assert period.health["loop_difference_share"] > PERIODIC


def test_a_number_of_times_is_kept_to() -> None:
    period = Period(CYCLE, MOST - 1, FIRST, 1.0)
    assert len(run(period)) == FIRST + CYCLE
    assert period.cycles == MOST


def test_nothing_is_said_where_nothing_is_repeated() -> None:
    period = Period(0, 0, LEAD, 1.0)
    run(period)
    assert (period.notes, period.health, period.state()) == ((), {}, {})


@pytest.mark.parametrize("at", [LEAD + 2 * CYCLE + 3, FIRST + 2])
def test_it_continues_identically(at: int) -> None:
    whole, before = (Period(CYCLE, MOST - 1, FIRST, 1.0, until=True) for _ in range(2))
    seen = run(whole)
    simulated = seen[: seen.index(at) + 1] if at in seen else seen
    for index in simulated:
        before.observe(index, positions(index - before.skipped))
    after = Period(CYCLE, MOST - 1, FIRST, 1.0, until=True)
    after.load(before.state())
    for index in seen[len(simulated) :]:
        after.observe(index, positions(index - after.skipped))
    assert after.health == whole.health
    assert after.notes == whole.notes


def test_a_bake_that_began_later_writes_the_same_time_codes() -> None:
    settings = Settings(
        frames=40, first=30, fps=12.0, time_codes_per_second=24.0, start=-59.0, gravity=(0, 0, 0),
        up=(0, 1, 0),
    )  # fmt: skip
    later = shortened(settings, 16)
    assert [later.time_code(i) for i in range(later.first, later.frames)] == [
        settings.time_code(i) for i in range(30, 40)
    ]
