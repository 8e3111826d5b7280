"""The fit of material values to targets: simulations, least squares, intervals and output files."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import BakeError, UsageError
from gf_usd.fitting.figures import Number, check_number, number
from gf_usd.fitting.observation import Observation, Scene
from gf_usd.fitting.read_targets import read_motion
from gf_usd.fitting.result import (
    FitResult,
    Reproduced,
    at_bounds,
    estimates,
    fit_metadata,
    not_identifiable,
    reproduced,
)
from gf_usd.fitting.search import DESIGN, PRIOR, AllSimulationsFailed, Minimum, search
from gf_usd.fitting.targets import Motion, Target, TargetSpec, clusters, parse, residuals
from gf_usd.fitting.uncertainty import uncertainty
from gf_usd.fitting.unknowns import (
    ELASTIC,
    SHORT_NAMES,
    Unknown,
    starts,
    unknowns,
    values_at,
    with_values,
)
from gf_usd.fitting.workers import Simulations, simulations
from gf_usd.layers.materials import write_material_file

TYPICAL_STEPS = 14  # of a search, each with a Jacobian
MISFIT = 2.0  # [standard deviations] larger residuals are reported
FIXED_BY_OPTION = (
    "damping_time",
    "friction",
    "restitution",
)  # values that have an option of their own

# (number of simulations so far, rms of the best whitened residuals)
Progress = Callable[[int, float], None]


@dataclass(frozen=True, kw_only=True)
class FitRequest:
    """The arguments of a fit."""

    asset: Path
    targets: Sequence[str]
    unknowns: Sequence[str] = ()  # empty: those of `unknowns.ELASTIC`
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # [SI]
    layer: Path | None = None  # output file of the material
    picture: Path | None = None
    evaluations: Path | None = None  # folder of the cache of simulations
    max_minutes: float = 10.0
    processes: int = 2
    options: Mapping[str, Any] = field(default_factory=dict)  # of the simulated bake


def fit(request: FitRequest, progress: Progress | None = None) -> FitResult:
    """Estimate the material values for which a simulation of the asset reproduces the targets.

    Raises UsageError for invalid targets or unknowns, InputError for an invalid asset or target
    file, and BakeError where all simulations fail.
    """
    start_time = time.monotonic()
    specs = [parse(text) for text in request.targets]
    if not specs:
        raise UsageError("no target was given", "give what was observed: --target rebound=0.6")
    for spec in specs:
        if spec.file is None:
            check_number(spec)
    for name in request.unknowns:
        full_name = SHORT_NAMES.get(name, name)
        if full_name in FIXED_BY_OPTION and request.options.get(full_name) is not None:
            raise UsageError(
                f"{full_name} is to be fitted, but it is also given with "
                f"--{full_name.replace('_', '-')}",
                "leave out one of the two; --bounds sets the range of the search",
            )
    options = {**request.options, "overwrite": True, "threads": 1}
    with simulations(request.processes, request.evaluations) as processes:
        scene = processes.prepare(request.asset, options)
        free = tuple(
            row
            for row in unknowns(scene.material, scene.radius, request.unknowns, request.bounds)
            if request.unknowns or request.options.get(row.name) is None
        )
        targets, notes = read_targets(specs, scene)
        frames = frames_of(targets, scene, stated=request.options.get("frames") is not None)
        targets, cut = _cut_at_end(targets, (frames - 1) / scene.fps)
        tracked = [point for target in targets for point in target.tracked]
        scene = processes.prepare(request.asset, {**options, "frames": frames}, tracked)
        processes.deadline = start_time + 60.0 * request.max_minutes
        return _search_and_report(
            request,
            processes,
            scene,
            free,
            targets,
            (*scene.notes, *notes, *cut),
            start_time,
            progress,
        )


def fit_counted(
    request: FitRequest, progress: Callable[[int, int], None] | None = None
) -> FitResult:
    """As `fit`; progress : receives the number of simulations and their typical total."""
    if progress is None:
        return fit(request)
    count = len(request.unknowns) or len(ELASTIC)
    typical = DESIGN * count + TYPICAL_STEPS * (count + 1)
    return fit(request, lambda done, best: progress(done, max(done, typical)))


def read_targets(specs: Sequence[TargetSpec], scene: Scene) -> tuple[list[Target], tuple[str, ...]]:
    """The targets of parsed texts, and notes on assumptions about them."""
    targets: list[Target] = []
    notes: list[str] = []
    for spec in specs:
        if spec.file is None:
            targets.append(number(spec, scene))
        else:
            motion, assumptions = read_motion(spec, scene)
            targets.append(motion)
            notes += assumptions
    return targets, tuple(notes)


def frames_of(targets: Sequence[Target], scene: Scene, *, stated: bool) -> int:
    """The number of frames to simulate: as stated, or up to the latest time of a target.

    A number without a time needs all frames of the bake.
    """
    if stated:
        return scene.frames
    last = 0
    for target in targets:
        if isinstance(target, Motion):
            last = max(last, math.ceil(target.seconds[-1] * scene.fps - 1e-6))
        elif isinstance(target, Number) and target.seconds is not None and _is_at_its_time(target):
            last = max(last, math.ceil(target.seconds * scene.fps - 1e-6))
        else:
            last = max(last, scene.frames - 1)
    return max(last, 1) + 1


def _is_at_its_time(target: Number) -> bool:
    return target.figure != "frequency"  # a frequency is that of the motion after its time


def _cut_at_end(targets: Sequence[Target], end: float) -> tuple[list[Target], tuple[str, ...]]:
    """The targets without times after the last frame, at `end` [s], and notes on those."""
    kept: list[Target] = []
    notes = []
    for target in targets:
        if isinstance(target, Motion) and target.seconds[-1] > end + 1e-6:
            inside = target.seconds <= end + 1e-6
            notes.append(
                f"{target.name}: {int((~inside).sum())} of {len(inside)} times are after the "
                f"last frame and are left out"
            )
            target = replace(target, seconds=target.seconds[inside], x=target.x[inside])
        kept.append(target)
    return kept, tuple(notes)


def _search_and_report(
    request: FitRequest,
    processes: Simulations,
    scene: Scene,
    rows: Sequence[Unknown],
    targets: Sequence[Target],
    notes: tuple[str, ...],
    start_time: float,
    progress: Progress | None,
) -> FitResult:
    best = np.inf

    def evaluate(points: Sequence[Floats], late: bool) -> list[Floats | None]:
        nonlocal best
        rows_or_none = []
        for observation in processes.run([values_at(rows, z) for z in points], late=late):
            row = None if observation is None else residuals(targets, observation)
            rows_or_none.append(row if row is not None and np.isfinite(row).all() else None)
        for row in rows_or_none:
            if row is not None:
                best = min(best, float(np.sqrt(np.mean(row**2))))
        if progress:
            progress(processes.simulated + processes.read, best)
        return rows_or_none

    try:
        minimum = search(evaluate, starts(rows))
    except AllSimulationsFailed as error:
        raise BakeError(
            f"{request.asset}: in no simulation with values within the bounds do the targets "
            f"occur: {', '.join(target.name for target in targets)}",
            "inspect a bake with --material first; try more --frames, another --drop or other "
            "--bounds",
        ) from error
    intervals = uncertainty(
        minimum.jacobian, minimum.residual, clusters(targets), prior=PRIOR,
        stated=all(target.stated for target in targets),
    )  # fmt: skip
    points = [values_at(rows, z) for z in (minimum.z, starts(rows))]
    observation, start = processes.run(points, late=True)
    assert observation is not None
    reproduced_targets = reproduced(targets, rows, minimum.jacobian, observation, start)
    name = f"{scene.material.name}_fit"
    result = FitResult(
        material=replace(with_values(scene.material, points[0]), name=name),
        estimates=estimates(rows, minimum, intervals),
        targets=reproduced_targets,
        not_identifiable=not_identifiable(rows, intervals),
        correlation=tuple(tuple(map(float, row)) for row in intervals.correlation),
        noise=float(np.sqrt(np.mean(minimum.residual**2))),
        converged=minimum.converged,
        simulations=processes.simulated,
        read=processes.read,
        seconds=time.monotonic() - start_time,
        particles=scene.particles,
        frames=scene.frames,
        layer=request.layer,
        picture=request.picture,
        notes=(*notes, *_result_notes(request, targets, reproduced_targets, rows, minimum)),
    )
    return _write_files(request, result, targets, observation, start)


def _result_notes(
    request: FitRequest,
    targets: Sequence[Target],
    reproduced_targets: Sequence[Reproduced],
    rows: Sequence[Unknown],
    minimum: Minimum,
) -> list[str]:
    notes = list(at_bounds(rows, minimum.z))
    assumed = [target.name for target in targets if not target.stated]
    if assumed:
        notes.append(
            f"no standard deviation is stated for {', '.join(assumed)}: 1 % was used as their "
            f"relative weight, and the intervals are computed from the residuals"
        )
    notes += [
        f"{fitted.name} is {abs(deviation):.3g} standard deviations away: it contradicts the other "
        "targets, or no material within the bounds reaches it"
        for fitted, target in zip(reproduced_targets, targets)
        if isinstance(target, Number)
        and abs(deviation := (fitted.fitted - fitted.target) / fitted.sigma) > MISFIT
    ]
    scatter = float(np.sqrt(np.mean(minimum.residual**2)))
    if all(target.stated for target in targets) and scatter > MISFIT:
        notes.append(
            f"the targets are not reproduced within their standard deviations: the residuals "
            f"are {scatter:.3g} times as large, and the intervals were enlarged by this factor"
        )
    if not minimum.converged:
        notes.append(
            f"the search ended after {request.max_minutes:g} minutes before it converged; a "
            f"larger --max-minutes continues it"
            + (" from what was simulated" if request.evaluations else "")
        )
    return notes


def _write_files(
    request: FitRequest,
    result: FitResult,
    targets: Sequence[Target],
    observation: Observation,
    start: Observation | None,
) -> FitResult:
    if request.layer is not None:
        metadata = fit_metadata(result, command_of(request))
        write_material_file(request.layer, result.material, metadata, source=request.asset)
    if request.picture is not None:
        from gf_usd.fitting.picture import draw_fit

        draw_fit(request.picture, result, targets, observation, start)
    return result


def command_of(request: FitRequest) -> str:
    """The equivalent ``gf-usd fit`` command."""
    from gf_usd.prepare.options.table import arguments

    command = ["gf-usd", "fit", request.asset.name]
    for text in request.targets:
        command += ["--target", text]
    if request.unknowns:
        command += ["--unknowns", ",".join(request.unknowns)]
    for name, (low, high) in request.bounds.items():
        command += ["--bounds", f"{name}={low:g}:{high:g}"]
    options = {k: v for k, v in request.options.items() if k != "limits"}
    return shlex.join([*command, *arguments(options)])
