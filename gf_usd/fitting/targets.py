"""Targets of a fit: points over time and numbers, each with its standard deviation."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.fitting.observation import Observation, Scene, TrackedPoints

SIGMA = 0.01  # default standard deviation, relative to a number or to the body's radius
HINT = "give FILE.usda for points, or NAME=VALUE: rebound=0.6, height=0.15+-0.002@12"


class Target(Protocol):
    """An observation that a fit reproduces."""

    @property
    def name(self) -> str: ...

    @property
    def stated(self) -> bool:
        """Whether its standard deviation was given."""
        ...

    @property
    def tracked(self) -> tuple[TrackedPoints, ...]:
        """The points whose motion the residual needs."""
        ...

    def residual(self, observation: Observation, first: int) -> Floats:
        """Whitened residuals (m,): (simulated - observed) / standard deviation.

        first : index of its first point in the observation.
        """
        ...

    def clusters(self) -> tuple[Ints, Ints]:
        """Labels (m,) and (m,) of the point and the time that each residual belongs to."""
        ...


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Observed points over time: a point cache, keyed poses, or tracks."""

    name: str
    tracked: tuple[TrackedPoints, ...]
    seconds: Floats  # (T,) [s] of playback since the first frame
    x: Floats  # (T, P, 3) [m]; NaN where a point is not observed
    sigma: float  # [m] of each coordinate
    stated: bool

    def residual(self, observation: Observation, first: int) -> Floats:
        """See `Target`."""
        return (self._deviation(observation, first) / self.sigma)[self._observed]

    def clusters(self) -> tuple[Ints, Ints]:
        """See `Target`."""
        times, points, _ = np.nonzero(self._observed)
        return points, times

    def distance(self, observation: Observation, first: int) -> Floats:
        """Root mean square distance (T,) [m] over the observed points."""
        square = np.sum(self._deviation(observation, first) ** 2, axis=2)
        return np.sqrt(np.nanmean(square, axis=1))

    @property
    def _observed(self) -> np.ndarray:
        return np.isfinite(self.x)

    def _deviation(self, observation: Observation, first: int) -> Floats:
        return observation.at(self.seconds)[:, first : first + self.x.shape[1]] - self.x


@dataclass(frozen=True, kw_only=True)
class TargetSpec:
    """The parsed text of a target."""

    text: str
    file: Path | None = None
    figure: str = ""  # of `figures.FIGURES`
    value: float = 0.0  # in the unit of the figure
    sigma: float | None = None  # in that unit, or in stage units of points; None: not stated
    share: bool = False  # sigma is relative to the value, or to the radius
    position: tuple[float, float, float] | None = None  # [stage units]
    time_code: float | None = None


NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
SIGMA_PATTERN = rf"(?:(?:\+-|±)(?P<sigma>{NUMBER_PATTERN})(?P<percent>%?))?"
FILE_PATTERN = re.compile(rf"(?P<file>.+?\.(?:usd|usda|usdc|usdz)){SIGMA_PATTERN}", re.IGNORECASE)
FIGURE_PATTERN = re.compile(
    rf"(?P<figure>[a-z_]+)=(?P<value>{NUMBER_PATTERN}){SIGMA_PATTERN}"
    rf"(?::at=(?P<x>{NUMBER_PATTERN}),(?P<y>{NUMBER_PATTERN}),(?P<z>{NUMBER_PATTERN}))?"
    rf"(?:@(?P<code>{NUMBER_PATTERN}))?"
)


def parse(text: str) -> TargetSpec:
    """Parse a ``--target``.  Raises UsageError for invalid syntax."""
    match = FILE_PATTERN.fullmatch(text.strip())
    if match:
        sigma, share = _parse_sigma(text, match)
        return TargetSpec(text=text, file=Path(match["file"]), sigma=sigma, share=share)
    match = FIGURE_PATTERN.fullmatch(text.strip().replace(" ", ""))
    if not match:
        raise UsageError(f"--target {text!r} is not a target", HINT)
    sigma, share = _parse_sigma(text, match)
    position = None
    if match["x"] is not None:
        position = (float(match["x"]), float(match["y"]), float(match["z"]))
    return TargetSpec(
        text=text,
        figure=match["figure"],
        value=float(match["value"]),
        position=position,
        time_code=None if match["code"] is None else float(match["code"]),
        sigma=sigma,
        share=share,
    )


def _parse_sigma(text: str, match: re.Match[str]) -> tuple[float | None, bool]:
    if match["sigma"] is None:
        return None, False
    sigma = float(match["sigma"])
    if not sigma > 0.0:
        raise UsageError(
            f"--target {text!r}: its standard deviation is {sigma:g}", "give a number above 0"
        )
    percent = match["percent"] == "%"
    return 0.01 * sigma if percent else sigma, percent


def points_sigma(spec: TargetSpec, scene: Scene) -> float:
    """Standard deviation [m] of each coordinate of the points of a file."""
    if spec.sigma is None:
        return SIGMA * scene.radius
    return spec.sigma * (scene.radius if spec.share else scene.unit)


def residuals(targets: Sequence[Target], observation: Observation) -> Floats:
    """Concatenated whitened residuals (m,) of all targets."""
    rows, first = [], 0
    for target in targets:
        rows.append(target.residual(observation, first))
        first += sum(len(points.vertices) for points in target.tracked)
    return np.concatenate(rows)


def clusters(targets: Sequence[Target]) -> list[Ints]:
    """Labels (m,) of points and of times of all residuals; empty if all are independent."""
    points, times, offset = [], [], 0
    for target in targets:
        of_points, of_times = target.clusters()
        points.append(of_points + offset)
        times.append(of_times + offset)
        offset = 1 + max(points[-1].max(initial=offset), times[-1].max(initial=offset))
    labels = [np.concatenate(points), np.concatenate(times)]
    all_independent = all(len(np.unique(points)) == len(points) for points in labels)
    return [] if all_independent else labels
