"""What a fit is to reproduce: points over time, and numbers; each with its standard deviation."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.fitting.observation import Followed, Observation, Scene

STAGES = (".usd", ".usda", ".usdc", ".usdz")
SIGMA = 0.01  # of a number, or of the body's radius, where nobody states a standard deviation
FORM = "give FILE.usda for points, or NAME=VALUE: rebound=0.6, height=0.15+-0.002@12"


class Target(Protocol):
    """Something that was observed."""

    @property
    def name(self) -> str: ...

    @property
    def stated(self) -> bool:
        """Its standard deviation was."""
        ...

    @property
    def followed(self) -> tuple[Followed, ...]:
        """The points whose motion it needs."""
        ...

    def residual(self, seen: Observation, first: int) -> Floats:
        """(m,) simulated less observed, over the standard deviation.

        first : of its points among those that the observation holds.
        """
        ...

    def clusters(self) -> tuple[Ints, Ints]:
        """(m,) and (m,): which residuals belong to a point, and which to a time."""
        ...


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Points over time: a cache, keyed poses, or tracks."""

    name: str
    followed: tuple[Followed, ...]
    seconds: Floats  # (T,) [s] of playback since the first frame
    x: Floats  # (T, P, 3) [m]; not a number where a point was not seen
    sigma: float  # [m] of each coordinate
    stated: bool

    def residual(self, seen: Observation, first: int) -> Floats:
        """See `Target`."""
        return (self._away(seen, first) / self.sigma)[self._seen]

    def clusters(self) -> tuple[Ints, Ints]:
        """See `Target`."""
        times, points, _ = np.nonzero(self._seen)
        return points, times

    def distance(self, seen: Observation, first: int) -> Floats:
        """(T,) [m] root of the mean square distance of the points that were seen."""
        square = np.sum(self._away(seen, first) ** 2, axis=2)
        return np.sqrt(np.nanmean(square, axis=1))

    @property
    def _seen(self) -> np.ndarray:
        return np.isfinite(self.x)

    def _away(self, seen: Observation, first: int) -> Floats:
        return seen.at(self.seconds)[:, first : first + self.x.shape[1]] - self.x


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The text of a target, taken apart."""

    text: str
    file: Path | None = None
    figure: str = ""  # of `figures.FIGURES`
    value: float = 0.0  # in the unit of the figure
    sigma: float | None = None  # in that unit, or in stage units of points; None: not stated
    share: bool = False  # sigma is a share of the value, or of the radius
    place: tuple[float, float, float] | None = None  # [stage units]
    time_code: float | None = None


NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
SPREAD = rf"(?:(?:\+-|±)(?P<sigma>{NUMBER})(?P<percent>%?))?"
FILE = re.compile(rf"(?P<file>.+?\.(?:usd|usda|usdc|usdz)){SPREAD}", re.IGNORECASE)
FIGURE = re.compile(
    rf"(?P<figure>[a-z_]+)=(?P<value>{NUMBER}){SPREAD}"
    rf"(?::at=(?P<x>{NUMBER}),(?P<y>{NUMBER}),(?P<z>{NUMBER}))?(?:@(?P<code>{NUMBER}))?"
)


def parse(text: str) -> Asked:
    """What a ``--target`` asks for.  Raises UsageError for a text that is none."""
    found = FILE.fullmatch(text.strip())
    if found:
        sigma, share = _spread(text, found)
        return Asked(text=text, file=Path(found["file"]), sigma=sigma, share=share)
    found = FIGURE.fullmatch(text.strip().replace(" ", ""))
    if not found:
        raise UsageError(f"--target {text!r} is not a target", FORM)
    sigma, share = _spread(text, found)
    place = None
    if found["x"] is not None:
        place = (float(found["x"]), float(found["y"]), float(found["z"]))
    return Asked(
        text=text,
        figure=found["figure"],
        value=float(found["value"]),
        place=place,
        time_code=None if found["code"] is None else float(found["code"]),
        sigma=sigma,
        share=share,
    )


def _spread(text: str, found: re.Match[str]) -> tuple[float | None, bool]:
    if found["sigma"] is None:
        return None, False
    sigma = float(found["sigma"])
    if not sigma > 0.0:
        raise UsageError(
            f"--target {text!r}: its standard deviation is {sigma:g}", "give a number above 0"
        )
    percent = found["percent"] == "%"
    return 0.01 * sigma if percent else sigma, percent


def points_sigma(asked: Asked, scene: Scene) -> float:
    """[m] of each coordinate of the points of a file."""
    if asked.sigma is None:
        return SIGMA * scene.radius
    return asked.sigma * (scene.radius if asked.share else scene.unit)


def residuals(targets: Sequence[Target], seen: Observation) -> Floats:
    """(m,) of all targets, one after the other."""
    rows, first = [], 0
    for target in targets:
        rows.append(target.residual(seen, first))
        first += sum(len(one.vertices) for one in target.followed)
    return np.concatenate(rows)


def clusters(targets: Sequence[Target]) -> list[Ints]:
    """(m,) points and (m,) times of all residuals; none where each is alone."""
    points, times, most = [], [], 0
    for target in targets:
        of_points, of_times = target.clusters()
        points.append(of_points + most)
        times.append(of_times + most)
        most = 1 + max(points[-1].max(initial=most), times[-1].max(initial=most))
    both = [np.concatenate(points), np.concatenate(times)]
    alone = all(len(np.unique(one)) == len(one) for one in both)
    return [] if alone else both
