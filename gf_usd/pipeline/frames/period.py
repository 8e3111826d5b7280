"""Detects when a motion that is driven in cycles is periodic: `--loop`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.units import length_text, percent_text
from gf_usd.pipeline.health.warnings import NOT_PERIODIC

if TYPE_CHECKING:
    pass


PERIODIC = 0.002  # of the radius: --loop auto ends here; under a pixel of a body of 500 pixels

PHASES = 16  # samples of a cycle that are compared with those of the cycle before


class Period:
    """Difference between successive cycles, and whether more cycles are needed.

    The difference of two cycles is the largest distance of a point from its position one period
    earlier, over up to `PHASES` samples that are spread over the cycle.

    cycle : samples per period, 0: not repeated; repeats : maximum number; first : index of the
        first written sample; radius : [m]. until : stop repeating once two cycles differ by at most
        `PERIODIC` of the radius.
    """

    def __init__(
        self, cycle: int, repeats: int, first: int, radius: float, *, until: bool = False
    ) -> None:
        self._cycle, self._first, self._radius = cycle, first, radius
        self._until = until
        self._begin = first - cycle * repeats  # where the first cycle begins
        self._phases = np.unique(np.linspace(0, max(cycle - 1, 0), PHASES).astype(int)).tolist()
        self._poses: dict[int, Floats] = {}  # by phase
        self._now = 0.0  # [m] of the current cycle
        self.difference: float | None = None  # [m] of the last complete cycle
        self.skipped = 0  # samples that were skipped because the motion was periodic

    def observe(self, index: int, x: Floats) -> int:
        """Compare positions x (n, 3) [m] of a sample with those one period earlier.

        Returns the sample index from which the simulation continues: this one or, once the motion
        is periodic, the last one before the written frames, whose state is the same.
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
        if self._until and last and index < self._first and self.relative_difference <= PERIODIC:
            self.skipped = self._first - 1 - index
            self._until = False
            return self._first - 1
        return index

    def state(self) -> dict[str, Floats]:
        """The state that `load` restores."""
        if not self._cycle:
            return {}
        difference = np.nan if self.difference is None else self.difference
        numbers = np.array([self._now, difference, self.skipped])
        return {"period": numbers} | {f"period{k}": x for k, x in self._poses.items()}

    def load(self, state: Mapping[str, Floats]) -> None:
        """Restore `state`; other keys are ignored."""
        if not self._cycle:
            return
        now, difference, skipped = state["period"].tolist()
        self._now, self.skipped = now, int(skipped)
        self._until = self._until and not self.skipped
        self.difference = None if np.isnan(difference) else difference
        self._poses = {k: state[f"period{k}"] for k in self._phases if f"period{k}" in state}

    @property
    def relative_difference(self) -> float:
        """The difference over the radius; inf where no cycles were compared."""
        return np.inf if self.difference is None else self.difference / self._radius

    @property
    def cycles(self) -> int:
        """Number of simulated cycles, including the written one."""
        return (self._first - self._begin - self.skipped) // self._cycle + 1

    @property
    def health(self) -> dict[str, float | int]:
        """Health values of the period; {} where nothing was repeated."""
        if not self._cycle or self.difference is None:
            return {}
        return {
            "loop_cycles": self.cycles,
            "loop_difference_m": self.difference,
            "loop_difference_share": self.relative_difference,
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """A note on the periodicity."""
        if not self._cycle or self.difference is None:
            return ()
        share = percent_text(self.relative_difference)
        each = f"{length_text(self.difference)}, {share} of the radius"
        if self._until and self.relative_difference > PERIODIC:
            return (
                f"the written cycle is the last of {self.cycles}, the maximum of --loop auto, "
                f"and still differs from the previous one by {each}; up to"
                f" {100.0 * PERIODIC:g} % counts as periodic",
            )
        more = (
            "; a larger --loop reduces the difference"
            if self.relative_difference > NOT_PERIODIC
            else ""
        )
        return (
            f"the written cycle, number {self.cycles}, differs from the previous one by"
            f" {each}{more}",
        )
