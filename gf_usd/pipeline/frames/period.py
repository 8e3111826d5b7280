"""When a motion that is driven in cycles repeats itself: `--loop`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.pipeline.health.warnings import NOT_PERIODIC

if TYPE_CHECKING:
    pass


PERIODIC = 0.002  # of the radius: --loop auto ends; under a pixel of a body 500 pixels wide

PHASES = 16  # samples of a cycle that are compared with those of the cycle before


class Period:
    """How far a repeated cycle is from being periodic, and when it need not be repeated again.

    The difference of two cycles is the largest way of a point from where it was a period before,
    over up to `PHASES` samples spread over the cycle.

    cycle : samples of a period, 0: nothing is repeated; repeats : times, at most; first : index of
    the first sample that is written; radius : [m].  until : repeat only until two cycles differ by
    `PERIODIC` of the radius at most.
    """

    def __init__(
        self, cycle: int, repeats: int, first: int, radius: float, *, until: bool = False
    ) -> None:
        self._cycle, self._first, self._radius = cycle, first, radius
        self._until = until
        self._begin = first - cycle * repeats  # where the first cycle begins
        self._phases = np.unique(np.linspace(0, max(cycle - 1, 0), PHASES).astype(int)).tolist()
        self._poses: dict[int, Floats] = {}  # by phase
        self._now = 0.0  # [m] of the cycle so far
        self.difference: float | None = None  # [m] of the last whole cycle
        self.skipped = 0  # samples that were not simulated, as the cycle was periodic before

    def see(self, index: int, x: Floats) -> int:
        """Take notice of positions x (n, 3) [m] at a sample.

        Returns the index of the sample from which the simulation goes on: this one, or the last
        before those that are written, at which everything is as it is now.
        """
        since = index - self._begin
        if not self._cycle or since < 0:
            return index
        phase = since % self._cycle
        if phase == 0 and index <= self._first:
            self._now = 0.0
        if phase in self._phases:
            if (before := self._poses.get(phase)) is not None:
                self._now = max(self._now, float(np.linalg.norm(x - before, axis=1).max()))
            self._poses[phase] = np.array(x)
        last = phase == self._cycle - 1
        if since >= self._cycle and (last or index > self._first):
            self.difference = self._now
        if self._until and last and index < self._first and self.share <= PERIODIC:
            self.skipped = self._first - 1 - index
            self._until = False
            return self._first - 1
        return index

    def state(self) -> dict[str, Floats]:
        """What `load` goes on from."""
        if not self._cycle:
            return {}
        difference = np.nan if self.difference is None else self.difference
        numbers = np.array([self._now, difference, self.skipped])
        return {"period": numbers} | {f"period{k}": x for k, x in self._poses.items()}

    def load(self, state: Mapping[str, Floats]) -> None:
        """Go on from `state`, which may hold more."""
        if not self._cycle:
            return
        now, difference, skipped = state["period"].tolist()
        self._now, self.skipped = now, int(skipped)
        self._until = self._until and not self.skipped
        self.difference = None if np.isnan(difference) else difference
        self._poses = {k: state[f"period{k}"] for k in self._phases if f"period{k}" in state}

    @property
    def share(self) -> float:
        """The difference over the radius; inf where there is none yet."""
        return np.inf if self.difference is None else self.difference / self._radius

    @property
    def cycles(self) -> int:
        """Cycles that are simulated, with the one that is written."""
        return (self._first - self._begin - self.skipped) // self._cycle + 1

    @property
    def health(self) -> dict[str, float | int]:
        """What the report says of it; nothing where nothing was repeated."""
        if not self._cycle or self.difference is None:
            return {}
        return {
            "loop_cycles": self.cycles,
            "loop_difference_m": self.difference,
            "loop_difference_share": self.share,
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """What is said of it."""
        if not self._cycle or self.difference is None:
            return ()
        each = f"{self.difference:.2g} m, {100.0 * self.share:.2g} % of the radius"
        if self._until and self.share > PERIODIC:
            return (
                f"the written cycle is the last of {self.cycles}, the maximum of --loop auto, "
                f"and still differs from the previous one by {each}; up to"
                f" {100.0 * PERIODIC:g} % counts as periodic",
            )
        more = "; a larger --loop reduces the difference" if self.share > NOT_PERIODIC else ""
        return (
            f"the written cycle, number {self.cycles}, differs from the previous one by"
            f" {each}{more}",
        )
