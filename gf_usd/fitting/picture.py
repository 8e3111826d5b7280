"""The picture of a fit: the targets, the motion of the fitted material, and that of the start."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.fitting.figures import FIGURES, Number
from gf_usd.fitting.observation import Observation
from gf_usd.fitting.result import FitResult
from gf_usd.fitting.targets import Motion, Target
from gf_usd.view.curve_picture import Curve, Panel, Rows, write_panels


def draw(
    path: Path,
    result: FitResult,
    targets: Sequence[Target],
    seen: Observation,
    start: Observation | None,
) -> Path:
    """Write the picture (.png); start : None where that simulation failed."""
    panels: list[Panel | Rows] = []
    first = 0
    for target in targets:
        if isinstance(target, Motion):
            panels += _motion(target, first, seen, start)
        first += sum(len(one.vertices) for one in target.followed)
    if numbers := _numbers(result, targets):
        panels.append(numbers)
    return write_panels(path, panels)


def _motion(
    target: Motion, first: int, seen: Observation, start: Observation | None
) -> list[Panel]:
    up = seen.series.up
    points = slice(first, first + target.x.shape[1])
    runs = [("start", start)] if start is not None else []
    runs.append(("fit", seen))

    def heights(run: Observation) -> Floats:
        return run.x[:, points] @ up

    observed = target.x @ up
    mean = [
        *(Curve(kind=kind, x=run.seconds, y=heights(run).mean(1)) for kind, run in runs),
        Curve(kind="target", x=target.seconds, y=np.nanmean(observed, axis=1), dots=True),
    ]
    extent = [
        *(Curve(kind=kind, x=run.seconds, y=np.ptp(heights(run), axis=1)) for kind, run in runs),
        Curve(
            kind="target", x=target.seconds,
            y=np.nanmax(observed, axis=1) - np.nanmin(observed, axis=1), dots=True,
        ),
    ]  # fmt: skip
    away = [Curve(kind=kind, x=target.seconds, y=target.distance(run, first)) for kind, run in runs]
    return [
        Panel(title=f"{target.name}: mean height of the points", unit="m", curves=mean),
        Panel(title="extent of the points along up", unit="m", curves=extent),
        Panel(title="rms distance to the target", unit="m", curves=away),
    ]


def _numbers(result: FitResult, targets: Sequence[Target]) -> Rows | None:
    rows, words = [], []
    for one, target in zip(result.targets, targets):
        if not isinstance(target, Number):
            continue
        away = [(value - one.target) / one.sigma for value in (one.start, one.fitted)]
        rows.append((target.figure, 1.0, *away))
        unit = FIGURES[target.figure].unit
        words.append(f"{one.target:.4g}, fitted {one.fitted:.4g} {unit}".rstrip())
    title = "numbers: distances from their targets, in standard deviations"
    return Rows(title=title, rows=rows, words=words) if rows else None
