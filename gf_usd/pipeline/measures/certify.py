"""The numerical uncertainty of a bake's figures, from runs at a half and a quarter of its
resolution.

The coarser runs have 1/8 and 1/64 of the particles, and time steps twice and four times as long:
1/16 and 1/256 of the work. They write no files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError, SolverError
from gf_usd.core.units import length_text, length_unit, volume_text
from gf_usd.pipeline.measures.convergence import Band, Interval, band, capped, estimate, unknown
from gf_usd.pipeline.measures.figures import FIGURES, figures, highest_rebound, reached
from gf_usd.pipeline.measures.observe import Observed

COARSER = (2.0, 4.0)  # spacing of the coarser runs over that of the bake
# Particles that a run needs to resolve the body: a cube of 4 x 4 x 4.
FEWEST = 64
MOST_DIGITS = 5  # after the point, in texts
NOISE = 0.015  # of the lattice edge: least uncertainty of a length (tools/acceptance/certify.py)
VOLUME = 0.02  # relative volume by which the body of a coarser run may differ
COARSER_TEXTS = {2.0: "half of the resolution", 4.0: "a quarter of the resolution"}


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """The figures of one variant with their uncertainty."""

    runs: tuple[tuple[int, float], ...]  # particles, and lattice edge [m], finest first
    figures: Mapping[str, Interval]
    center: Band | None = field(default=None, repr=False)  # of the path of the center of mass
    contacts: tuple[int, ...] = ()  # frames in which a contact begins
    reason: str = ""  # why there are no intervals; "" where there are

    def as_json(self) -> dict[str, Any]:
        """Plain values; docs/guide/report.md has the keys."""
        out: dict[str, Any] = {
            "particles": [count for count, _ in self.runs],
            "spacing_m": [edge for _, edge in self.runs],
            "reason": self.reason,
            "figures": {
                name: {
                    "words": FIGURES[name].text,
                    "told": interval_text(name, one),
                    "unit": FIGURES[name].unit,
                    **one.as_json(),
                }
                for name, one in self.figures.items()
            },
        }
        if self.center is not None:
            until = self.center.until
            out["center"] = {
                "half_width": [float(half) for half in self.center.half[:until]],
                "frames": until,
                "contacts": list(self.contacts),
                "reason": self.center.reason,
                "told": self._path(self.center),
            }
        return out

    def lines(self) -> tuple[str, ...]:
        """A line of text per figure: its interval, or why it has none."""
        if self.reason:
            return (f"nothing is certified: {self.reason}",)
        sentences = [
            f"{FIGURES[name].text} {interval_text(name, one)}" for name, one in self.figures.items()
        ]
        return (
            (*sentences, self._path(self.center)) if self.center is not None else tuple(sentences)
        )

    def _path(self, center: Band) -> str:
        count = len(center.half)
        if center.until == count:
            most = length_text(float(center.half.max()))
            return f"path of the center of mass +- at most {most}, in all {count} frames"
        return (
            f"path of the center of mass known to frame {center.until - 1} of {count - 1};"
            f" {unknown_from(center, self.contacts)}"
        )


def interval_text(name: str, interval: Interval) -> str:
    """``0.43 +- 0.01 (order 1.6)``, or why there is no interval; lengths in the unit that fits."""
    scale, unit = 1.0, FIGURES[name].unit
    if unit == "m":
        known = [*interval.value, interval.half] if interval.known else interval.fine
        scale, unit = length_unit(max(map(abs, known)))
    unit = f" {unit}" if unit else ""
    if not interval.known:
        shown = ", ".join(f"{scale * x:.3g}" for x in interval.fine)
        return f"{shown}{unit}, not certified: {interval.reason}"
    half = scale * interval.half
    digits = max(0, min(MOST_DIGITS, 1 - _exponent(half)))
    shown = ", ".join(
        f"{scale * x:.{digits}f}".replace(f"-{0:.{digits}f}", f"{0:.{digits}f}")
        for x in interval.value
    )
    half = max(half, 0.1**digits)
    order = "" if interval.order is None else f" (order {interval.order:.1f})"
    return f"{shown} +- {half:.{digits}f}{unit}{order}"


def _exponent(x: float) -> int:
    return int(f"{x:e}".split("e")[1])


def unknown_from(center: Band, contacts: Sequence[int]) -> str:
    """Text: from which frame on the path is not certified, and why."""
    # each new contact amplifies small differences of the path
    since = [number for number, frame in enumerate(contacts, 1) if frame <= center.until]
    where = f", contact {since[-1]}" if since else ""
    how = "chaotic" if center.parts and len(since) > 1 else "not known"
    return f"{how} from frame {center.until}{where}: {center.reason}"


def coarser_runs(
    spacing: float, volume: float, run: Callable[[float], tuple[Observed, float]]
) -> tuple[tuple[Observed, ...], str]:
    """The runs at twice and four times a spacing [m], or () and why they cannot be used.

    run : simulates at a spacing; returns the run and the volume [m^3] of its particles.
    volume : [m^3] of the bake's particles.
    """
    found: list[Observed] = []
    for factor in COARSER:
        what = f"the run at {COARSER_TEXTS[factor]}"
        try:
            made, filled = run(factor * spacing)
        except (InputError, SolverError) as error:
            return (), f"{what} failed: {error.message}"
        if made.particles < FEWEST:
            many = int(FEWEST * COARSER[-1] ** 3)
            return (), (
                f"{what} has {made.particles} particles, fewer than {FEWEST}; give --particles"
                f" {many} or more"
            )
        if abs(filled - volume) > VOLUME * volume:
            return (), (
                f"{what} has a different body, of {volume_text(filled)} instead of"
                f" {volume_text(volume)}: each resolution closes a hole differently, and"
                " --repair makes sheets as thick as the spacing"
            )
        found.append(made)
    return tuple(found), ""


def certify(runs: Sequence[Observed], *, held: bool, single: bool, reason: str = "") -> Certificate:
    """The certificate of a bake, `runs[0]`, from the coarser `runs[1:]`.

    held : part of the body is driven; single : there is one body, so that a rebound is defined.
    reason : why the coarser runs cannot be used; "" where they can.
    """
    sizes = tuple((one.particles, one.spacing) for one in runs)
    fine = runs[0]
    values = [figures(one.series, held=held, at_rest=one.at_rest) for one in runs]
    wanted = {name: value for name, value in values[0].items() if value is not None}
    if not single:
        for name in ("least_height", "squash", "rebound"):
            wanted.pop(name, None)
    contacts = fine.series.starts
    if reason:
        return Certificate(
            runs=sizes, reason=reason, contacts=contacts,
            figures={name: unknown(value, reason) for name, value in wanted.items()},
        )  # fmt: skip
    center = band([one.series.centers for one in runs], fine.series.height)
    found = {}
    for name, value in wanted.items():
        others = [each[name] for each in values[1:]]
        found[name] = _interval(name, value, others, fine, center)
    return Certificate(runs=sizes, figures=found, center=center, contacts=contacts)


def _interval(
    name: str,
    value: Floats,
    others: Sequence[Floats | None],
    fine: Observed,
    center: Band,
) -> Interval:
    """The interval of one figure, or an interval with the reason why it is unknown."""
    series = fine.series
    absent = [COARSER_TEXTS[factor] for factor, one in zip(COARSER, others) if one is None]
    if absent:
        return unknown(value, f"there is none at {' and at '.join(absent)}")
    decided = reached(series, name)
    if decided > center.until and name != "settled_height":
        return unknown(
            value, f"it is reached in frame {decided}; {unknown_from(center, series.starts)}"
        )
    turned = next((i for i, count in enumerate(series.inverted) if count), None)
    if turned is not None and turned <= decided:
        return unknown(value, f"particles are inverted from frame {turned} on")
    known = [value, *(one for one in others if one is not None)]
    if FIGURES[name].unit == "s":
        return estimate(known, float(series.times[-1]))
    if FIGURES[name].unit == "m":
        interval = estimate(known, series.height, NOISE * fine.spacing)
        most = highest_rebound(series) if name == "rebound" else None
        return interval if most is None else capped(interval, most)
    return estimate(known, 1.0, NOISE * fine.spacing / series.height)
