"""Plots of a fit: the targets, and the motions of the fitted and of the initial material."""

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


def draw_fit(
    path: Path,
    result: FitResult,
    targets: Sequence[Target],
    observation: Observation,
    start: Observation | None,
) -> Path:
    """Write the plots (.png) and return the path.

    start : the observation of the initial material; None where its simulation failed.
    """
    panels: list[Panel | Rows] = []
    first = 0
    for target in targets:
        if isinstance(target, Motion):
            panels += _motion_panels(target, first, observation, start)
        first += sum(len(reproduced.vertices) for reproduced in target.tracked)
    if numbers := _number_rows(result, targets):
        panels.append(numbers)
    return write_panels(path, panels)


def _motion_panels(
    target: Motion, first: int, observation: Observation, start: Observation | None
) -> list[Panel]:
    up = observation.series.up
    points = slice(first, first + target.x.shape[1])
    runs = [("start", start)] if start is not None else []
    runs.append(("fit", observation))

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
    deviations = [
        Curve(kind=kind, x=target.seconds, y=target.distance(run, first)) for kind, run in runs
    ]
    return [
        Panel(title=f"{target.name}: mean height of the points", unit="m", curves=mean),
        Panel(title="extent of the points along up", unit="m", curves=extent),
        Panel(title="rms distance to the target", unit="m", curves=deviations),
    ]


def _number_rows(result: FitResult, targets: Sequence[Target]) -> Rows | None:
    rows, texts = [], []
    for reproduced, target in zip(result.targets, targets):
        if not isinstance(target, Number):
            continue
        deviations = [
            (value - reproduced.target) / reproduced.sigma
            for value in (reproduced.start, reproduced.fitted)
        ]
        rows.append((target.figure, 1.0, *deviations))
        unit = FIGURES[target.figure].unit
        texts.append(f"{reproduced.target:.4g}, fitted {reproduced.fitted:.4g} {unit}".rstrip())
    title = "numbers: distances from their targets, in standard deviations"
    return Rows(title=title, rows=rows, texts=texts) if rows else None
