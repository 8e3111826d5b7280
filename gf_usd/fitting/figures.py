"""Measured quantities of a motion ("figures") that can be targets, one row of a table each.

Quantities at a time are interpolated between frames.  Those at rest are means over the second half
of the simulated time with Hann weights 1 - cos(2 pi s), which average vibrations out: the body need
not be at rest in any frame, and the values are smooth functions of the material.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError, did_you_mean
from gf_usd.core.units import code_text, length_text
from gf_usd.fitting.observation import Observation, Scene, TrackedPoints, vertices_as_points
from gf_usd.fitting.targets import SIGMA, TargetSpec
from gf_usd.pipeline.measures.figures import figures

UNDEFINED = float("nan")  # the quantity does not occur in a simulation
SETTLED_SHARE = 0.05  # of the largest deviation from the height at rest
ZERO_PADDING = 16  # length of the zero-padded signal over its own, to interpolate the spectrum


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A measured quantity that can be a target."""

    text: str
    unit: str  # SI; "" for a pure number
    # f(observation, index of its point, playback time [s] or None) -> value
    of: Callable[[Observation, int, float | None], float]
    position: bool = False  # requires a point
    at_time: bool = False  # accepts a time code; default: the last frame


def _measured_figure(name: str) -> Callable[[Observation, int, float | None], float]:
    def of(observation: Observation, point: int, seconds: float | None) -> float:
        del point, seconds
        found = figures(observation.series)[name]
        if found is None:
            # a body that lands and stays on the floor has a rebound of 0
            return (
                0.0 if name == "rebound" and observation.series.landing is not None else UNDEFINED
            )
        return float(found[0])

    return of


def _height(observation: Observation, point: int, seconds: float | None) -> float:
    del point
    series = observation.series
    return _interpolate_at(
        observation, series.high - series.low, series.high_rate - series.low_rate, seconds
    )


def _sag(observation: Observation, point: int, seconds: float | None) -> float:
    del point
    series = observation.series
    return _interpolate_at(observation, series.low[0] - series.low, -series.low_rate, seconds)


def _deflection(observation: Observation, point: int, seconds: float | None) -> float:
    up = observation.series.up
    rate = -(observation.v[:, point] @ up)
    if seconds is None:
        return _mean_at_rest((observation.x[0, point] - observation.x[:, point]) @ up)
    return _interpolate_at(
        observation, (observation.x[0, point] - observation.x[:, point]) @ up, rate, seconds
    )


def _settled_height(observation: Observation, point: int, seconds: float | None) -> float:
    del point, seconds
    return _mean_at_rest(observation.series.high - observation.series.low)


def _settled_sag(observation: Observation, point: int, seconds: float | None) -> float:
    del point, seconds
    return _mean_at_rest(observation.series.low[0] - observation.series.low)


def _settling_time(observation: Observation, point: int, seconds: float | None) -> float:
    """The last time at which the height deviates from that at rest by SETTLED_SHARE or more.

    Linear interpolation of the deviations between frames.
    """
    del point, seconds
    height = observation.series.high - observation.series.low
    deviation = np.abs(height - _mean_at_rest(height))
    limit = SETTLED_SHARE * deviation.max()
    over = np.flatnonzero(deviation > limit)
    last = int(over[-1])
    if last == len(deviation) - 1:
        return UNDEFINED
    fraction = (deviation[last] - limit) / (deviation[last] - deviation[last + 1])
    return float(
        observation.series.times[last] + fraction * np.diff(observation.series.times)[last]
    )


def _frequency(observation: Observation, point: int, seconds: float | None) -> float:
    """Frequency of the spectral peak of a point's motion along up, from a time on.

    Hann window, and a parabola through the logarithms around the peak: the error is below 1 % of
    the line spacing for two periods or more [Gasior and Gonzalez 2004].
    """
    t = observation.series.times
    after_start = t >= t[0] + (seconds or 0.0) - 1e-9
    y = (observation.x[:, point] @ observation.series.up)[after_start]
    if len(y) < 8:
        return UNDEFINED
    y = y - np.polyval(np.polyfit(np.arange(len(y)), y, 1), np.arange(len(y)))
    power = np.abs(np.fft.rfft(y * np.hanning(len(y)), ZERO_PADDING * len(y))) ** 2
    k = int(np.argmax(power[1:-1])) + 1
    a, b, c = np.log(power[k - 1 : k + 2] + np.finfo(float).tiny)
    peak = k + 0.5 * (a - c) / (a - 2.0 * b + c)
    return float(peak / (ZERO_PADDING * len(y) * (t[1] - t[0])))


def _interpolate_at(
    observation: Observation, y: Floats, rate: Floats, seconds: float | None
) -> float:
    """Cubic Hermite interpolation of y with its rate at a playback time; None: the last frame."""
    if seconds is None:
        return float(y[-1])
    from scipy.interpolate import CubicHermiteSpline

    scale = (observation.series.times[-1] - observation.series.times[0]) / (
        observation.seconds[-1] - observation.seconds[0]
    )
    at = min(max(seconds, observation.seconds[0]), observation.seconds[-1])
    return float(CubicHermiteSpline(observation.seconds, y, rate * scale)(at))


def _mean_at_rest(y: Floats) -> float:
    half = y[len(y) // 2 :]
    weights = 1.0 - np.cos(2.0 * np.pi * (np.arange(len(half)) + 0.5) / len(half))
    return float(weights @ half / weights.sum())


FIGURES: Mapping[str, Figure] = {
    "first_contact_time": Figure(
        text="time of the first contact", unit="s", of=_measured_figure("first_contact_time")
    ),
    "least_height": Figure(
        text="least height in the first contact", unit="m", of=_measured_figure("least_height")
    ),
    "squash": Figure(
        text="peak squash: 1 - least height / height", unit="", of=_measured_figure("squash")
    ),
    "rebound": Figure(
        text="rise of the center of mass after the first contact",
        unit="m", of=_measured_figure("rebound"),
    ),
    "peak_strain": Figure(
        text="largest strain of a particle", unit="", of=_measured_figure("peak_strain")
    ),
    "height": Figure(text="height at a time code", unit="m", of=_height, at_time=True),
    "sag": Figure(
        text="downward displacement of the lowest point at a time code",
        unit="m", of=_sag, at_time=True,
    ),
    "settled_height": Figure(text="height at rest", unit="m", of=_settled_height),
    "settled_sag": Figure(
        text="downward displacement of the lowest point at rest", unit="m", of=_settled_sag
    ),
    "settling_time": Figure(
        text="time until the height stays within 5 % of its largest deviation from the height "
        "at rest",
        unit="s", of=_settling_time,
    ),
    "deflection": Figure(
        text="downward displacement of a point, at rest or at a time code",
        unit="m", of=_deflection,
        position=True, at_time=True,
    ),
    "frequency": Figure(
        text="frequency at which a point vibrates, after a time code", unit="Hz", of=_frequency,
        position=True, at_time=True,
    ),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Number:
    """A measured quantity as a target."""

    name: str  # the text of the target
    figure: str  # of FIGURES
    value: float  # [SI]
    sigma: float  # [SI]
    stated: bool
    seconds: float | None  # of playback since the first frame
    point: TrackedPoints | None

    @property
    def tracked(self) -> tuple[TrackedPoints, ...]:
        """See `targets.Target`."""
        return () if self.point is None else (self.point,)

    def simulated(self, observation: Observation, first: int) -> float:
        """The value [SI] in a simulation; NaN where the quantity does not occur."""
        return FIGURES[self.figure].of(observation, first, self.seconds)

    def residual(self, observation: Observation, first: int) -> Floats:
        """See `targets.Target`."""
        return np.array([(self.simulated(observation, first) - self.value) / self.sigma])

    def clusters(self) -> tuple[Ints, Ints]:
        """See `targets.Target`."""
        return np.zeros(1, np.int64), np.zeros(1, np.int64)


def figure_named(name: str) -> Figure:
    """The figure of a name.  Raises UsageError for an unknown name."""
    if name in FIGURES:
        return FIGURES[name]
    guess = did_you_mean(name, FIGURES)
    raise UsageError(f"unknown figure {name!r}", f"{guess}choose one of {', '.join(FIGURES)}")


def check_number(spec: TargetSpec) -> None:
    """Raise UsageError where a target lacks an argument of its figure, or has one too many."""
    figure = figure_named(spec.figure)
    if figure.position != (spec.position is not None):
        verb, hint = ("needs", "add") if figure.position else ("has no", "leave out")
        raise UsageError(
            f"--target {spec.text!r}: {spec.figure} {verb} a point",
            f"{hint} :at=X,Y,Z, a point on the mesh at rest [stage units]",
        )
    if spec.time_code is not None and not figure.at_time:
        raise UsageError(
            f"--target {spec.text!r}: {spec.figure} does not take a time code",
            f"leave out @{code_text(spec.time_code)}",
        )
    if spec.share and not spec.value:
        raise UsageError(
            f"--target {spec.text!r}: a standard deviation cannot be a share of 0",
            f"give a number: {spec.figure}=0+-0.01",
        )


def number(spec: TargetSpec, scene: Scene) -> Number:
    """The target of a parsed text.  Raises UsageError for a time code before the first frame."""
    figure = FIGURES[spec.figure]
    scale = scene.unit if figure.unit == "m" else 1.0
    sigma = SIGMA * abs(spec.value) or SIGMA
    if spec.sigma is not None:
        sigma = spec.sigma * (abs(spec.value) if spec.share else 1.0)
    seconds = None
    if spec.time_code is not None:
        seconds = (spec.time_code - scene.start) / scene.time_codes_per_second
        if seconds < 0.0:
            raise UsageError(
                f"--target {spec.text!r}: time code {code_text(spec.time_code)} is before the first"
                f" frame, {code_text(scene.start)}",
                "--start sets the time code of the first frame",
            )
    return Number(
        name=spec.text,
        figure=spec.figure,
        value=scale * spec.value,
        sigma=scale * sigma,
        stated=spec.sigma is not None,
        seconds=seconds,
        point=None if spec.position is None else _nearest_vertex(spec, scene),
    )


def _nearest_vertex(spec: TargetSpec, scene: Scene) -> TrackedPoints:
    """The vertex nearest to a position, in the frame of the asset file."""
    position = scene.unit * np.array(spec.position)
    nearest, distance = None, np.inf
    for path, x in scene.surfaces.items():
        deviation = np.linalg.norm(x - scene.lift - position, axis=1)
        if deviation.min() < distance:
            nearest, distance = (
                vertices_as_points(path, np.array([int(deviation.argmin())])),
                float(deviation.min()),
            )
    if nearest is None or distance > scene.radius:
        raise UsageError(
            f"--target {spec.text!r}: the nearest vertex is {length_text(distance)} away, but the"
            f" body has a radius of {length_text(scene.radius)}",
            "give a point on the mesh of the asset, in units of the asset",
        )
    return nearest
