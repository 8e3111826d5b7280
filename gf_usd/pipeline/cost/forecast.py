"""What a bake is doing, and what it takes in all, seen from the frames behind it.

The estimate before a bake has the substeps of the body at rest, and of the strain of a usual
landing.  They grow where it is strained more, and stay many where it is pressed flat for good:
cells that are a tenth as thick are crossed in a tenth of the time.  So the time that is left is
estimated anew after every sample,

    seconds = samples left * (seconds of a substep, of a sample as lately) * (substeps it asks for)

and a surprise is told once, and again when it doubles.  Compiling kernels, which the first bakes
after an installation do, counts as time spent but not as the pace of what follows.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gf_usd.core.errors import OutOfResources
from gf_usd.pipeline.cost.budget import Cost, duration

SURPRISE = 2.0  # times as long as was said last; the estimate holds within that (`budget`)
MATTERS = 60.0  # [s] longer, at least: less is no news
LATELY = 10  # samples: an impact is over, or what it did to the step stays
OVERRUN = 2.0  # times --max-hours at which a bake ends, since its estimate holds within that
MORE = 1.5  # times the substeps at rest, which then explain a surprise
FEW = 3  # samples with substeps that say more than the estimate

READING, FILLING, COMPILING = "reading", "filling", "compiling kernels"
SIMULATING, WRITING, CHECKING = "simulating", "writing", "checking"
CERTIFYING, DRAWING = "simulating coarsely", "drawing"


@dataclass(frozen=True, kw_only=True)
class Activity:
    """What a bake is doing now."""

    stage: str  # one of those above
    what: str = ""  # the file that is read, or the variant that is simulated
    done: int = 0  # frames of all variants
    total: int = 0
    left: float | None = None  # [s] until the end of the bake; None: not known yet
    ends_early: bool = False  # total and left are the most that it may take


Watch = Callable[[Activity], None]


class Stages:
    """Tells a watcher what a bake is doing.

    watch : is told at each change, and after each frame.
    """

    def __init__(self, watch: Watch | None = None) -> None:
        self._watch = watch
        self.now = Activity(stage=READING)

    def begin(self, stage: str, what: str = "", **values: Any) -> None:
        """The bake is at another stage, or further in the same; values : of `Activity`."""
        self.now = replace(self.now, stage=stage, what=what, **values)
        if self._watch:
            self._watch(self.now)

    def compile(self, compiles: bool) -> None:
        """Kernels are compiled from now on, or no longer: for `taichi_runtime.watching`."""
        if self._watch:
            self._watch(replace(self.now, stage=COMPILING) if compiles else self.now)


@dataclass(frozen=True)
class _Seen:
    seconds: float
    substeps: int


class Forecast:
    """Follows one bake.

    cost : of `budget.estimate`; samples : of each material, all together; max_hours : [h], of the
    command; again : how to go on after the end, in words; remark : is told of surprises; clock :
    [s].
    """

    def __init__(
        self,
        cost: Cost,
        samples: int,
        max_hours: float,
        *,
        again: str = "",
        remark: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._rows: Sequence[dict] = cost["per_material"]
        self._samples, self._limit, self._again = samples, max_hours * 3600.0, again
        self._clock = clock
        self._began = self._last = clock()
        self._said = max(float(cost["estimated_seconds"]), 1e-9)
        self._lately: deque[_Seen] = deque(maxlen=LATELY)
        self._idle: deque[float] = deque(maxlen=LATELY)  # [s] of samples without substeps
        self._material, self._index = -1, -1  # that the last sample is of, and its own number
        self._fresh = True  # no sample of the material was seen: the first also builds the solver
        self._compiled, self._compiles_since = 0.0, 0.0
        self._remark = remark
        self._surprises: list[str] = []
        self.left = float(cost["estimated_seconds"])  # [s] as it is known now

    def take(self) -> tuple[str, ...]:
        """The surprises since this was last asked."""
        taken, self._surprises = tuple(self._surprises), []
        return taken

    def compile(self, compiles: bool) -> None:
        """Kernels are compiled from now on, or no longer: for `taichi_runtime.watching`."""
        if compiles:
            self._compiles_since = self._clock()
        else:
            self._compiled += self._clock() - self._compiles_since

    def begin(self, material: int, index: int) -> None:
        """The samples of a material after number `index` come next; -1: all of them."""
        self._material, self._index, self._fresh = material, index, True
        self._lately.clear()
        self._idle.clear()

    def require(self) -> None:
        """Raise OutOfResources where the bake has taken OVERRUN times its limit.

        For every launch of kernels: a frame may take as long as all before it.
        """
        spent = self._clock() - self._began
        if spent <= OVERRUN * self._limit:
            return
        left = self._samples - 1 - self._index
        raise OutOfResources(
            f"the bake has taken {duration(spent)}, and --max-hours {self._limit / 3600.0:g}"
            f" lets it take {duration(OVERRUN * self._limit)} at most; {left} of"
            f" {self._samples} frames are left",
            f"raise --max-hours; {self._again}",
            frame=min(self._index + 1, self._samples - 1),
        )

    def after(self, material: int, index: int, substeps: int, following: int) -> None:
        """A sample is written: say so where the whole takes much longer than was said.

        material : number of it; index : of the sample; substeps : that it took; following : that
        the next one asks for.

        Raises OutOfResources as `require` does, but not after the last sample.
        """
        now = self._clock()
        if material != self._material:
            self.begin(material, index)
        self._index = index
        if self._fresh:
            self._fresh = False
        elif substeps:
            self._lately.append(_Seen(now - self._last - self._compiled, substeps))
        else:
            self._idle.append(now - self._last - self._compiled)
        self._last, self._compiled = now, 0.0
        left = self._samples - 1 - index
        later = sum(float(row["seconds"]) for row in self._rows[material + 1 :])
        spent = now - self._began
        if left + later > 0:
            self.require()
        row = self._rows[material]
        self.left = self._of_material(row, index, left, following) + later
        self.left += float(row.get("end_seconds", 0.0))
        known, seen = len(self._lately), sum(s.seconds for s in self._lately)
        if not left or not (known >= LATELY or (known >= FEW and seen > MATTERS)):
            return
        whole = spent + self.left
        if whole < SURPRISE * self._said or whole < self._said + MATTERS:
            return
        before, self._said = self._said, whole
        many = sum(s.substeps for s in self._lately) / len(self._lately)
        self._surprises.append(self._words(material, whole, before, many))
        if self._remark:
            self._remark(self._surprises[-1])

    def _of_material(self, row: dict, index: int, left: int, following: int) -> float:
        """[s] of the samples of a material after one, `left` of them."""
        flying = min(left, max(0, int(row.get("flying_samples", 0)) - index))
        idle = float(row.get("sample_seconds", 0.0))
        if self._idle:
            idle = sum(self._idle) / len(self._idle)
        if len(self._lately) < FEW:
            each = float(row.get("moving_seconds", row["seconds"] / self._samples))
            each += max(0.0, idle - float(row.get("sample_seconds", idle)))
        else:
            pace = sum(s.seconds for s in self._lately) / sum(s.substeps for s in self._lately)
            many = sum(s.substeps for s in self._lately) / len(self._lately)
            # The next sample alone may stand at a peak, and the mean may lie before one.
            each = pace * min(many, following)
        return flying * idle + (left - flying) * each

    def _words(self, material: int, whole: float, before: float, many: float) -> str:
        row = self._rows[material]
        rest = float(row["substeps_per_sample"])
        if many > MORE * rest:
            why = (
                f"in its current strain {row['name']} takes {many:.0f} substeps where it took"
                f" {rest:.0f} at rest"
            )
        else:
            why = "substeps take longer than estimated: other programs may be using this machine"
        limit = ""
        if whole > OVERRUN * self._limit:
            limit = f"; it ends after {duration(OVERRUN * self._limit)}, twice --max-hours"
        return f"the bake will take about {duration(whole)}, not {duration(before)}: {why}{limit}"
