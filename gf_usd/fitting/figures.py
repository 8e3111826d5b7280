"""Numbers of a motion that can be targets: one row each.

Figures of a moment are taken between the frames (`pipeline/measures`).  Those of rest are means
over the later half of the simulated time with the weights of Hann, 1 - cos(2 pi s), in which a
vibration cancels: they need no frame at which all has come to rest, and change smoothly with the
material.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.fitting.observation import Followed, Observation, Scene, corner
from gf_usd.fitting.targets import SIGMA, Asked
from gf_usd.pipeline.measures.figures import figures

NONE = float("nan")  # a simulation does not show it
SETTLED = 0.05  # of the largest deviation from the height at rest: what is less has settled
PADDING = 16  # times the length: the spectrum between its samples


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A number that a target can be."""

    words: str
    unit: str  # SI; "" for a pure number
    # (simulation, number of its point, [s] of playback at which it is asked for) to the number
    of: Callable[[Observation, int, float | None], float]
    place: bool = False  # of a point, which has to be named
    moment: bool = False  # at a time code, the last frame where none is named


def _shown(name: str) -> Callable[[Observation, int, float | None], float]:
    def of(seen: Observation, point: int, seconds: float | None) -> float:
        del point, seconds
        found = figures(seen.series)[name]
        if found is None:
            # what lands and does not leave the floor rises by nothing
            return 0.0 if name == "rebound" and seen.series.landing is not None else NONE
        return float(found[0])

    return of


def _height(seen: Observation, point: int, seconds: float | None) -> float:
    del point
    series = seen.series
    return _between(seen, series.high - series.low, series.high_rate - series.low_rate, seconds)


def _sag(seen: Observation, point: int, seconds: float | None) -> float:
    del point
    series = seen.series
    return _between(seen, series.low[0] - series.low, -series.low_rate, seconds)


def _deflection(seen: Observation, point: int, seconds: float | None) -> float:
    up = seen.series.up
    rate = -(seen.v[:, point] @ up)
    if seconds is None:
        return _at_rest((seen.x[0, point] - seen.x[:, point]) @ up)
    return _between(seen, (seen.x[0, point] - seen.x[:, point]) @ up, rate, seconds)


def _settled_height(seen: Observation, point: int, seconds: float | None) -> float:
    del point, seconds
    return _at_rest(seen.series.high - seen.series.low)


def _settled_sag(seen: Observation, point: int, seconds: float | None) -> float:
    del point, seconds
    return _at_rest(seen.series.low[0] - seen.series.low)


def _settling_time(seen: Observation, point: int, seconds: float | None) -> float:
    """The last time at which the height is farther than SETTLED from that at rest.

    By straight lines between the frames' deviations, whose envelope falls exponentially.
    """
    del point, seconds
    height = seen.series.high - seen.series.low
    away = np.abs(height - _at_rest(height))
    limit = SETTLED * away.max()
    over = np.flatnonzero(away > limit)
    last = int(over[-1])
    if last == len(away) - 1:
        return NONE
    share = (away[last] - limit) / (away[last] - away[last + 1])
    return float(seen.series.times[last] + share * np.diff(seen.series.times)[last])


def _frequency(seen: Observation, point: int, seconds: float | None) -> float:
    """The peak of the spectrum of the point's motion along up, from a time on.

    With the window of Hann and a parabola through the logarithms around the peak, whose error is
    below 1 % of a line's distance for two periods and more [Gasior and Gonzalez 2004].
    """
    t = seen.series.times
    part = t >= t[0] + (seconds or 0.0) - 1e-9
    y = (seen.x[:, point] @ seen.series.up)[part]
    if len(y) < 8:
        return NONE
    y = y - np.polyval(np.polyfit(np.arange(len(y)), y, 1), np.arange(len(y)))
    power = np.abs(np.fft.rfft(y * np.hanning(len(y)), PADDING * len(y))) ** 2
    k = int(np.argmax(power[1:-1])) + 1
    a, b, c = np.log(power[k - 1 : k + 2] + np.finfo(float).tiny)
    peak = k + 0.5 * (a - c) / (a - 2.0 * b + c)
    return float(peak / (PADDING * len(y) * (t[1] - t[0])))


def _between(seen: Observation, y: Floats, rate: Floats, seconds: float | None) -> float:
    """A curve of the frames at a time of playback: cubic Hermite; the last frame's for None."""
    if seconds is None:
        return float(y[-1])
    from scipy.interpolate import CubicHermiteSpline

    scale = (seen.series.times[-1] - seen.series.times[0]) / (seen.seconds[-1] - seen.seconds[0])
    at = min(max(seconds, seen.seconds[0]), seen.seconds[-1])
    return float(CubicHermiteSpline(seen.seconds, y, rate * scale)(at))


def _at_rest(y: Floats) -> float:
    half = y[len(y) // 2 :]
    weights = 1.0 - np.cos(2.0 * np.pi * (np.arange(len(half)) + 0.5) / len(half))
    return float(weights @ half / weights.sum())


FIGURES: Mapping[str, Figure] = {
    "first_contact_time": Figure(
        words="time of the first contact", unit="s", of=_shown("first_contact_time")
    ),
    "least_height": Figure(
        words="least height in the first contact", unit="m", of=_shown("least_height")
    ),
    "squash": Figure(
        words="peak squash: 1 - least height / height", unit="", of=_shown("squash")
    ),
    "rebound": Figure(
        words="rise of the center of mass after the first contact", unit="m", of=_shown("rebound")
    ),
    "peak_strain": Figure(
        words="largest strain of a particle", unit="", of=_shown("peak_strain")
    ),
    "height": Figure(words="height at a time code", unit="m", of=_height, moment=True),
    "sag": Figure(
        words="downward displacement of the lowest point at a time code",
        unit="m", of=_sag, moment=True,
    ),
    "settled_height": Figure(words="height at rest", unit="m", of=_settled_height),
    "settled_sag": Figure(
        words="downward displacement of the lowest point at rest", unit="m", of=_settled_sag
    ),
    "settling_time": Figure(
        words="time until the height stays within 5 % of its largest deviation from the height "
        "at rest",
        unit="s", of=_settling_time,
    ),
    "deflection": Figure(
        words="downward displacement of a point, at rest or at a time code",
        unit="m", of=_deflection,
        place=True, moment=True,
    ),
    "frequency": Figure(
        words="frequency at which a point vibrates, after a time code", unit="Hz", of=_frequency,
        place=True, moment=True,
    ),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Number:
    """A figure as a target."""

    name: str  # as it was asked for
    figure: str  # of FIGURES
    value: float  # [SI]
    sigma: float  # [SI]
    stated: bool
    seconds: float | None  # of playback since the first frame
    point: Followed | None

    @property
    def followed(self) -> tuple[Followed, ...]:
        """See `targets.Target`."""
        return () if self.point is None else (self.point,)

    def simulated(self, seen: Observation, first: int) -> float:
        """[SI] not a number where the simulation does not show it."""
        return FIGURES[self.figure].of(seen, first, self.seconds)

    def residual(self, seen: Observation, first: int) -> Floats:
        """See `targets.Target`."""
        return np.array([(self.simulated(seen, first) - self.value) / self.sigma])

    def clusters(self) -> tuple[Ints, Ints]:
        """See `targets.Target`."""
        return np.zeros(1, np.int64), np.zeros(1, np.int64)


def figure_named(name: str) -> Figure:
    """The figure of that name.  Raises UsageError with the nearest where there is none."""
    if name in FIGURES:
        return FIGURES[name]
    close = difflib.get_close_matches(name, FIGURES, n=1)
    guess = f"did you mean {close[0]}? " if close else ""
    raise UsageError(f"unknown figure {name!r}", f"{guess}choose one of {', '.join(FIGURES)}")


def check_number(asked: Asked) -> None:
    """Raise UsageError where a target lacks what its figure needs, or has what it does not know."""
    figure = figure_named(asked.figure)
    if figure.place != (asked.place is not None):
        verb, hint = ("needs", "add") if figure.place else ("has no", "leave out")
        raise UsageError(
            f"--target {asked.text!r}: {asked.figure} {verb} a point",
            f"{hint} :at=X,Y,Z, a point on the mesh at rest [stage units]",
        )
    if asked.time_code is not None and not figure.moment:
        raise UsageError(
            f"--target {asked.text!r}: {asked.figure} does not take a time code",
            f"leave out @{asked.time_code:g}",
        )
    if asked.share and not asked.value:
        raise UsageError(
            f"--target {asked.text!r}: a standard deviation cannot be a share of 0",
            f"give a number: {asked.figure}=0+-0.01",
        )


def number(asked: Asked, scene: Scene) -> Number:
    """The target of a text.  Raises UsageError for a time code before the first frame."""
    figure = FIGURES[asked.figure]
    scale = scene.unit if figure.unit == "m" else 1.0
    sigma = SIGMA * abs(asked.value) or SIGMA
    if asked.sigma is not None:
        sigma = asked.sigma * (abs(asked.value) if asked.share else 1.0)
    seconds = None
    if asked.time_code is not None:
        seconds = (asked.time_code - scene.start) / scene.time_codes_per_second
        if seconds < 0.0:
            raise UsageError(
                f"--target {asked.text!r}: time code {asked.time_code:g} is before the first"
                f" frame, {scene.start:g}",
                "--start sets the time code of the first frame",
            )
    return Number(
        name=asked.text,
        figure=asked.figure,
        value=scale * asked.value,
        sigma=scale * sigma,
        stated=asked.sigma is not None,
        seconds=seconds,
        point=None if asked.place is None else _nearest(asked, scene),
    )


def _nearest(asked: Asked, scene: Scene) -> Followed:
    """The vertex nearest to a place of the asset as it is in its file."""
    place = scene.unit * np.array(asked.place)
    best, least = None, np.inf
    for path, x in scene.surfaces.items():
        away = np.linalg.norm(x - scene.lift - place, axis=1)
        if away.min() < least:
            best, least = corner(path, np.array([int(away.argmin())])), float(away.min())
    if best is None or least > scene.radius:
        raise UsageError(
            f"--target {asked.text!r}: the nearest vertex is {least:.3g} m away, but the body "
            f"has a radius of {scene.radius:.3g} m",
            "give a point on the mesh of the asset, in units of the asset",
        )
    return best
