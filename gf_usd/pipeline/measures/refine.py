"""``--until``: the next resolution, so that figures become as certain as requested.

The interval of a figure of order p shrinks as h^p, so h (tolerance / width)^(1/p) is fine enough.
The work of a bake grows as h^-4: particles as h^-3, and time steps as h^-1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gf_usd.core.errors import UsageError
from gf_usd.core.units import length_text, percent_text
from gf_usd.pipeline.cost.budget import duration
from gf_usd.pipeline.measures.certify import Certificate
from gf_usd.pipeline.measures.convergence import HIGHEST, LOWEST
from gf_usd.pipeline.measures.figures import FIGURES

if TYPE_CHECKING:
    from gf_usd.pipeline.result import BakeResult

# The figures that are refined by default: those that describe the motion by one number.
USUAL = ("least_height", "squash", "rebound", "sag", "settled_height", "settled_sag")
MARGIN = 0.9  # safety factor on the spacing
FINEST, COARSEST = 0.5, 0.85  # spacing of the next bake over that of this one
WORK = 4.0  # power of 1 / h
HINT = "give a share such as 2%, or figures and a share: rebound,squash:2%"


@dataclass(frozen=True, kw_only=True)
class Until:
    """The requested accuracy."""

    names: tuple[str, ...]  # of FIGURES; (): USUAL
    share: float  # half width over magnitude

    @classmethod
    def of(cls, text: str) -> Until:
        """ "2%" or "rebound,squash:2%".  Raises UsageError for anything else."""
        named, colon, share = text.rpartition(":")
        names = tuple(name.strip().replace("-", "_") for name in named.split(",")) if colon else ()
        unknown = [name for name in names if name not in FIGURES]
        if unknown:
            raise UsageError(
                f"--until {text}: unknown figure {unknown[0]!r}",
                f"choose one of {', '.join(FIGURES)}",
            )
        try:
            value = float(share.strip().removesuffix("%")) / 100.0
        except ValueError:
            value = 0.0
        if not (share.strip().endswith("%") and 0.0 < value < 1.0):
            raise UsageError(f"--until is {text}", HINT)
        return cls(names=names, share=value)

    def of_certificates(self, found: Sequence[Certificate]) -> tuple[float, float, str] | None:
        """The widest relative half width of the requested figures, its order, and its name as text.

        The width is inf for a figure without an interval that was requested by name. None where no
        bake has any of the figures.
        """
        rows = []
        for one in found:
            for name in self.names or USUAL:
                interval = one.figures.get(name)
                if interval is None or not (interval.known or self.names or one.reason):
                    continue
                width = interval.relative if interval.known else float("inf")
                rows.append((width, interval.order or LOWEST, FIGURES[name].text))
        return max(rows, key=lambda row: row[0]) if rows else None


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """The spacing of the next bake, and why."""

    spacing: float | None  # [m] of the next bake; None: there is none
    reason: str  # as text


def next_step(
    until: Until, found: Sequence[Certificate], *, seconds: float, spent: float, budget: float
) -> Refinement:
    """The spacing of the next bake.

    Parameters
    ----------
    found : certificate of each variant of the last bake.
    seconds : [s] that it took; spent : [s] that all bakes took; budget : [s] for all.
    """
    target = f"{100.0 * until.share:g} %"
    widest = until.of_certificates(found)
    if widest is None:
        names = ", ".join(until.names or USUAL)
        return Refinement(
            spacing=None, reason=f"--until {target}: the bake has none of the figures {names}"
        )
    width, order, text = widest
    edge = found[0].runs[0][1]
    if width <= until.share:
        return Refinement(spacing=None, reason=f"--until {target}: {text} +- {percent_text(width)}")
    p = min(max(order, LOWEST), HIGHEST)
    ratio = min(max(MARGIN * (until.share / width) ** (1.0 / p), FINEST), COARSEST)
    needed = seconds * ratio**-WORK
    known = f"+- {percent_text(width)}" if width < float("inf") else "without an interval"
    if spent + needed > budget:
        return Refinement(
            spacing=None,
            reason=f"--until {target} was not reached: {text} is {known}, and the next bake would "
            f"take about {duration(needed)}, but --max-hours leaves"
            f" {duration(max(0.0, budget - spent))}",
        )
    return Refinement(
        spacing=ratio * edge,
        reason=f"{text} is {known}: baking again with particles {length_text(ratio * edge)} apart",
    )


class Refining:
    """Bakes one asset repeatedly, each time at a finer resolution.

    until : the requested accuracy; None: a single bake. max_hours : [h] for all bakes. options : of
        the first.
    Raises UsageError for an invalid `until`, or with options that it cannot be combined with.
    """

    def __init__(self, until: str | None, max_hours: float, options: Mapping[str, Any]) -> None:
        self._until = None if until is None else Until.of(until)
        self._budget, self._spent = 3600.0 * max_hours, 0.0
        self.options = dict(options)
        self.notes: list[str] = []
        if self._until is not None:
            self.options["certify"] = True

    @property
    def hours(self) -> float:
        """[h] of the budget that are left."""
        return (self._budget - self._spent) / 3600.0

    def bake_again(self, result: BakeResult, unit: float) -> bool:
        """Whether to bake again, with `options`; adds a note with the reason.

        unit : [m] of the stage.
        """
        if self._until is None:
            return False
        self._spent += result.seconds
        found = [bake.certificate for bake in result.bakes if bake.certificate is not None]
        step = next_step(
            self._until, found, seconds=result.seconds, spent=self._spent, budget=self._budget
        )
        self.notes.append(step.reason)
        if step.spacing is None:
            return False
        self.options |= {"particles": None, "spacing": step.spacing / unit, "overwrite": True}
        return True
