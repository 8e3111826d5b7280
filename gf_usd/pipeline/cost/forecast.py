"""The current stage of a bake, and a forecast of its remaining time.

The estimate before a bake assumes the substeps of the body at rest and of a typical impact. A body
that is strained more needs more substeps, and one that stays compressed keeps needing them: waves
cross cells of a tenth of the thickness in a tenth of the time. The remaining time is therefore
updated after every sample,

    remaining = samples left * (recent seconds per substep) * (substeps of the next sample)

where the substeps of the next sample are those that its strain requires, times what recent samples
took for each of those required: contact of bodies divides them (`physics.contact.stability`). A
remark is made where the total stays much longer than last announced. Compiling kernels, as
the first bakes after an installation do, counts as time spent but not in the seconds per substep.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gf_usd.core.errors import OutOfResources
from gf_usd.pipeline.cost.budget import Cost, duration

ANNOUNCED = 2.0  # times the total announced last; the accuracy of the estimate (`budget`)
MATTERS = 60.0  # [s] by which the total must grow to be announced again
LASTING = 300.0  # [s] after which a longer forecast is announced before WINDOW samples have passed
WINDOW = 10  # recent samples that are averaged: longer than an impact
OVERRUN = 2.0  # times --max-hours at which a bake ends; the accuracy of the estimate
MORE = 1.5  # times the substeps at rest: from here the remark names the strain as the cause
FEW = 3  # samples with substeps from which the forecast replaces the estimate

READING, FILLING, COMPILING = "reading", "filling", "compiling kernels"
SIMULATING, WRITING, CHECKING = "simulating", "writing", "checking"
CERTIFYING, DRAWING, INSPECTING = "simulating coarsely", "drawing", "inspecting"


@dataclass(frozen=True, kw_only=True)
class Activity:
    """The current stage of a bake and its progress."""

    stage: str  # one of the stages above
    what: str = ""  # the file that is read, the step of the fill, or the variant that is simulated
    done: int = 0  # frames of all variants
    total: int = 0
    left: float | None = None  # [s] until the end of the bake; None: not known yet
    ends_early: bool = False  # total and left are upper limits


Watch = Callable[[Activity], None]


class Stages:
    """Reports the stage of a bake to a watcher.

    watch : called at each change of the stage, and after each frame.
    """

    def __init__(self, watch: Watch | None = None) -> None:
        self._watch = watch
        self.now = Activity(stage=READING)

    def begin(self, stage: str, what: str = "", **values: Any) -> None:
        """Enter a stage, or report progress in the current one; values : fields of `Activity`."""
        self.now = replace(self.now, stage=stage, what=what, **values)
        if self._watch:
            self._watch(self.now)

    def compile(self, compiles: bool) -> None:
        """Kernels are being compiled, or no longer: for `taichi_runtime.watching`."""
        if self._watch:
            self._watch(replace(self.now, stage=COMPILING) if compiles else self.now)


@dataclass(frozen=True)
class _SampleCost:
    seconds: float
    substeps: int
    required: int  # by the strain before the sample, without contact between bodies; 0: unknown

    @property
    def divided(self) -> float:
        """Substeps for each of those required."""
        return self.substeps / self.required if self.required else 1.0


class Forecast:
    """The remaining time of one bake.

    cost : of `budget.estimate`; samples : of each material, in all its frames; max_hours : [h], of
        the command; resume_hint : how to continue after the end; remark : called with each
        announcement; clock : [s].
    """

    def __init__(
        self,
        cost: Cost,
        samples: int,
        max_hours: float,
        *,
        resume_hint: str = "",
        remark: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._rows: Sequence[dict] = cost["per_material"]
        self._samples, self._limit, self._resume_hint = samples, max_hours * 3600.0, resume_hint
        self._clock = clock
        self._began = self._last = clock()
        self._announced = self._estimate = max(float(cost["estimated_seconds"]), 1e-9)
        self._at_most = bool(cost.get("ends_early"))  # the frames, and so the time, are a limit
        self._recent: deque[_SampleCost] = deque(maxlen=WINDOW)
        self._idle: deque[float] = deque(maxlen=WINDOW)  # [s] of samples without substeps
        self._required = 0  # substeps of the next sample by its strain; 0: unknown
        self._material, self._index = -1, -1  # number of the material and of the last sample
        self._fresh = True  # before the first sample of a material, which also builds the solver
        self._compiled, self._compiles_since = 0.0, 0.0
        # sample and [s] from which on the forecast has been much longer than announced
        self._longer_since: tuple[int, float] | None = None
        self._remark = remark
        self._remarks: list[str] = []
        self._cause: tuple[str, str] | None = None  # of the last remark: now, and when it is over
        self.left = float(cost["estimated_seconds"])  # [s] current forecast

    def take_remarks(self) -> tuple[str, ...]:
        """The remarks since the last call."""
        taken, self._remarks = tuple(self._remarks), []
        return taken

    def take_outcome(self) -> tuple[str, ...]:
        """Instead of the remarks, after a complete bake: that it took longer than estimated.

        A bake that ended at rest may have taken less than the remarks expected.
        """
        self.take_remarks()
        spent = self._clock() - self._began
        if self._cause is None or spent < ANNOUNCED * self._estimate:
            return ()
        about = "at most " if self._at_most else ""
        return (
            f"the bake took {duration(spent)}, not {about}{duration(self._estimate)}:"
            f" {self._cause[1]}",
        )

    def compile(self, compiles: bool) -> None:
        """Kernels are being compiled, or no longer: for `taichi_runtime.watching`."""
        if compiles:
            self._compiles_since = self._clock()
        else:
            self._compiled += self._clock() - self._compiles_since

    def begin(self, material: int, index: int) -> None:
        """The next sample is the first one after number `index` of a material; -1: its first."""
        self._material, self._index, self._fresh = material, index, True
        self._longer_since, self._required = None, 0
        self._recent.clear()
        self._idle.clear()

    def require(self) -> None:
        """Raise OutOfResources where the bake has taken OVERRUN times its limit.

        Called before every kernel launch, since a single frame can be long.
        """
        spent = self._clock() - self._began
        if spent <= OVERRUN * self._limit:
            return
        left = self._samples - 1 - self._index
        raise OutOfResources(
            f"the bake has taken {duration(spent)}, and --max-hours {self._limit / 3600.0:g}"
            f" allows at most {duration(OVERRUN * self._limit)}; {left} of"
            f" {self._samples} frames are left",
            f"raise --max-hours; {self._resume_hint}",
            frame=min(self._index + 1, self._samples - 1),
        )

    def record_sample(self, material: int, index: int, substeps: int, following: int) -> None:
        """Update the forecast after a sample, and make a remark where the total has grown.

        material, index : number of the material and of the sample; substeps : of this sample;
            following : substeps that the strain requires of the next one.

        Raises OutOfResources as `require` does, but not after the last sample.
        """
        now = self._clock()
        if material != self._material:
            self.begin(material, index)
        self._index = index
        if self._fresh:
            self._fresh = False
        elif substeps:
            took = now - self._last - self._compiled
            self._recent.append(_SampleCost(took, substeps, self._required))
        else:
            self._idle.append(now - self._last - self._compiled)
        self._last, self._compiled, self._required = now, 0.0, following
        left = self._samples - 1 - index
        later = sum(float(row["seconds"]) for row in self._rows[material + 1 :])
        spent = now - self._began
        if left + later > 0:
            self.require()
        row = self._rows[material]
        self.left = self._of_material(row, index, left, following) + later
        self.left += float(row.get("end_seconds", 0.0))
        known, seen = len(self._recent), sum(s.seconds for s in self._recent)
        if not left or not (known >= WINDOW or (known >= FEW and seen > MATTERS)):
            return
        whole = spent + self.left
        if whole < ANNOUNCED * self._announced or whole < self._announced + MATTERS:
            self._longer_since = None
            return
        if self._longer_since is None:
            self._longer_since = index, now
        # an impact is over after WINDOW samples, and with it most of the substeps that it required
        first, when = self._longer_since
        if index - first < WINDOW and now - when < LASTING:
            return
        self._longer_since = None
        before, self._announced = self._announced, whole
        many = sum(s.substeps for s in self._recent) / len(self._recent)
        self._remarks.append(self._message(material, whole, before, many))
        if self._remark:
            self._remark(self._remarks[-1])

    def _of_material(self, row: dict, index: int, left: int, following: int) -> float:
        """[s] of the remaining samples of a material, `left` of them."""
        flying = min(left, max(0, int(row.get("flying_samples", 0)) - index))
        idle = float(row.get("sample_seconds", 0.0))
        if self._idle:
            idle = sum(self._idle) / len(self._idle)
        if len(self._recent) < FEW:
            each = float(row.get("moving_seconds", row["seconds"] / self._samples))
            each += max(0.0, idle - float(row.get("sample_seconds", idle)))
        else:
            pace = sum(s.seconds for s in self._recent) / sum(s.substeps for s in self._recent)
            many = sum(s.substeps for s in self._recent) / len(self._recent)
            divided = sum(s.divided for s in self._recent) / len(self._recent)
            # the next sample may be a peak, and the mean may be of samples before a peak
            each = pace * min(many, following * divided) * self._growth(row, index)
        return flying * idle + (left - flying) * each

    def _growth(self, row: dict, index: int) -> float:
        """Mean substeps of the remaining samples over those of the recent ones, as far as strain
        was foreseen: that of bodies that hang (`hanging`).
        """
        profile = row.get("strain_profile")
        if not profile or index >= self._samples - 1:
            return 1.0
        at = np.arange(1, self._samples) * len(profile) // self._samples
        many = np.asarray(profile, float)[at]
        return float(many[index:].mean() / many[max(0, index - len(self._recent)) : index].mean())

    def _message(self, material: int, whole: float, before: float, many: float) -> str:
        row = self._rows[material]
        rest = float(row["substeps_per_sample"])
        slow = "substeps {} longer than estimated: other programs may {} this machine"
        self._cause = slow.format("take", "be using"), slow.format("took", "have used")
        if many > MORE * rest:
            self._cause = (
                f"in its current strain {row['name']} takes {many:.0f} substeps where it took"
                f" {rest:.0f} at rest",
                f"strained, {row['name']} took {many:.0f} substeps where it took {rest:.0f} at"
                " rest",
            )
        limit = ""
        if whole > OVERRUN * self._limit:
            limit = f"; it ends after {duration(OVERRUN * self._limit)}, twice --max-hours"
        about = "at most" if self._at_most else "about"
        return (
            f"the bake will take {about} {duration(whole)}, not {duration(before)}:"
            f" {self._cause[0]}{limit}"
        )
