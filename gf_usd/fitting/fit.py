"""A fit from its targets to its result: simulations, search, intervals, the layer."""

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
    about,
    at_bounds,
    estimates,
    not_identifiable,
    reproduced,
)
from gf_usd.fitting.search import DESIGN, PRIOR, Minimum, NothingRuns, search
from gf_usd.fitting.targets import Asked, Motion, Target, clusters, parse, residuals
from gf_usd.fitting.uncertainty import uncertainty
from gf_usd.fitting.unknowns import (
    ELASTIC,
    SHORT,
    Unknown,
    starts,
    unknowns,
    values_at,
    with_values,
)
from gf_usd.fitting.workers import Simulations, simulations
from gf_usd.layers.materials import write_material_file

USUAL_STEPS = 14  # of a search, with a Jacobian each
MISFIT = 2.0  # times their standard deviations: targets that are not reproduced
HELD = ("damping_time", "friction", "restitution")  # options that give a value

# (simulations so far, scatter of the best over the standard deviations)
Progress = Callable[[int, float], None]


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A fit as asked for."""

    asset: Path
    targets: Sequence[str]
    unknowns: Sequence[str] = ()  # none: those of `unknowns.ELASTIC`
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # [SI]
    layer: Path | None = None  # where the material is written
    picture: Path | None = None
    evaluations: Path | None = None  # folder in which simulations are kept
    max_minutes: float = 10.0
    processes: int = 2
    options: Mapping[str, Any] = field(default_factory=dict)  # of a bake: what decides the motion


def fit(wanted: Wanted, progress: Progress | None = None) -> FitResult:
    """Find the material values with which the asset does what was observed.

    Raises UsageError for targets or unknowns that make no sense, InputError where the asset or a
    target cannot be used, BakeError where no simulation runs through.
    """
    began = time.monotonic()
    asked = [parse(text) for text in wanted.targets]
    if not asked:
        raise UsageError("no target was given", "give what was observed: --target rebound=0.6")
    for one in asked:
        if one.file is None:
            check_number(one)
    for name in wanted.unknowns:
        held = SHORT.get(name, name)
        if held in HELD and wanted.options.get(held) is not None:
            raise UsageError(
                f"{held} is to be fitted, but it is also given with --{held.replace('_', '-')}",
                "leave out one of the two; --bounds sets the range of the search",
            )
    options = {**wanted.options, "overwrite": True, "threads": 1}
    with simulations(wanted.processes, wanted.evaluations) as processes:
        scene = processes.prepare(wanted.asset, options)
        free = tuple(
            row
            for row in unknowns(scene.material, scene.radius, wanted.unknowns, wanted.bounds)
            if wanted.unknowns or wanted.options.get(row.name) is None
        )
        targets, notes = read_targets(asked, scene)
        frames = frames_of(targets, scene, stated=wanted.options.get("frames") is not None)
        targets, cut = _within(targets, (frames - 1) / scene.fps)
        followed = [point for target in targets for point in target.followed]
        scene = processes.prepare(wanted.asset, {**options, "frames": frames}, followed)
        processes.deadline = began + 60.0 * wanted.max_minutes
        return _searched(
            wanted, processes, scene, free, targets, (*scene.notes, *notes, *cut), began, progress
        )


def fit_counted(wanted: Wanted, progress: Callable[[int, int], None] | None = None) -> FitResult:
    """See `fit`; progress : is told how many simulations there were, and how many are usual."""
    if progress is None:
        return fit(wanted)
    count = len(wanted.unknowns) or len(ELASTIC)
    usual = DESIGN * count + USUAL_STEPS * (count + 1)
    return fit(wanted, lambda done, best: progress(done, max(done, usual)))


def read_targets(asked: Sequence[Asked], scene: Scene) -> tuple[list[Target], tuple[str, ...]]:
    """The targets, and notes on what was assumed of them."""
    targets: list[Target] = []
    notes: list[str] = []
    for one in asked:
        if one.file is None:
            targets.append(number(one, scene))
        else:
            motion, said = read_motion(one, scene)
            targets.append(motion)
            notes += said
    return targets, tuple(notes)


def frames_of(targets: Sequence[Target], scene: Scene, *, stated: bool) -> int:
    """How many frames are simulated: as stated, or up to the last moment that a target looks at.

    A number without a moment of its own is looked for in all frames that a bake has.
    """
    if stated:
        return scene.frames
    last = 0
    for target in targets:
        if isinstance(target, Motion):
            last = max(last, math.ceil(target.seconds[-1] * scene.fps - 1e-6))
        elif isinstance(target, Number) and target.seconds is not None and _ends(target):
            last = max(last, math.ceil(target.seconds * scene.fps - 1e-6))
        else:
            last = max(last, scene.frames - 1)
    return max(last, 1) + 1


def _ends(target: Number) -> bool:
    return target.figure != "frequency"  # which is that after the moment


def _within(targets: Sequence[Target], end: float) -> tuple[list[Target], tuple[str, ...]]:
    """The targets without points after the last frame [s], and notes on those."""
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


def _searched(
    wanted: Wanted,
    processes: Simulations,
    scene: Scene,
    rows: Sequence[Unknown],
    targets: Sequence[Target],
    notes: tuple[str, ...],
    began: float,
    progress: Progress | None,
) -> FitResult:
    best = np.inf

    def evaluate(points: Sequence[Floats], late: bool) -> list[Floats | None]:
        nonlocal best
        found = []
        for seen in processes.run([values_at(rows, z) for z in points], late=late):
            row = None if seen is None else residuals(targets, seen)
            found.append(row if row is not None and np.isfinite(row).all() else None)
        for row in found:
            if row is not None:
                best = min(best, float(np.sqrt(np.mean(row**2))))
        if progress:
            progress(processes.simulated + processes.read, best)
        return found

    try:
        minimum = search(evaluate, starts(rows))
    except NothingRuns as error:
        raise BakeError(
            f"{wanted.asset}: in no simulation with values within the bounds do the targets "
            f"occur: {', '.join(target.name for target in targets)}",
            "look at a bake with --material first; try more --frames, another --drop or other "
            "--bounds",
        ) from error
    told = uncertainty(
        minimum.jacobian, minimum.residual, clusters(targets), prior=PRIOR,
        stated=all(target.stated for target in targets),
    )  # fmt: skip
    points = [values_at(rows, z) for z in (minimum.z, starts(rows))]
    seen, start = processes.run(points, late=True)
    assert seen is not None
    shown = reproduced(targets, rows, minimum.jacobian, seen, start)
    name = f"{scene.material.name}_fit"
    result = FitResult(
        material=replace(with_values(scene.material, points[0]), name=name),
        estimates=estimates(rows, minimum, told),
        targets=shown,
        not_identifiable=not_identifiable(rows, told),
        correlation=tuple(tuple(map(float, row)) for row in told.correlation),
        noise=float(np.sqrt(np.mean(minimum.residual**2))),
        converged=minimum.converged,
        simulations=processes.simulated,
        read=processes.read,
        seconds=time.monotonic() - began,
        particles=scene.particles,
        frames=scene.frames,
        layer=wanted.layer,
        picture=wanted.picture,
        notes=(*notes, *_remarks(wanted, targets, shown, rows, minimum)),
    )
    return _written(wanted, result, targets, seen, start)


def _remarks(
    wanted: Wanted,
    targets: Sequence[Target],
    found: Sequence[Reproduced],
    rows: Sequence[Unknown],
    minimum: Minimum,
) -> list[str]:
    said = list(at_bounds(rows, minimum.z))
    assumed = [target.name for target in targets if not target.stated]
    if assumed:
        said.append(
            f"no standard deviation is stated for {', '.join(assumed)}: 1 % was used as their "
            f"relative weight, and the intervals are computed from the residuals"
        )
    said += [
        f"{one.name} is {abs(away):.3g} standard deviations off: it contradicts the other targets,"
        " or no material within the bounds reaches it"
        for one, target in zip(found, targets)
        if isinstance(target, Number)
        and abs(away := (one.fitted - one.target) / one.sigma) > MISFIT
    ]
    scatter = float(np.sqrt(np.mean(minimum.residual**2)))
    if all(target.stated for target in targets) and scatter > MISFIT:
        said.append(
            f"the targets are not reproduced within their standard deviations: the residuals "
            f"are {scatter:.3g} times as large, and the intervals were enlarged by this factor"
        )
    if not minimum.converged:
        said.append(
            f"the search ended after {wanted.max_minutes:g} minutes before it converged; a "
            f"larger --max-minutes continues it"
            + (" from what was simulated" if wanted.evaluations else "")
        )
    return said


def _written(
    wanted: Wanted,
    result: FitResult,
    targets: Sequence[Target],
    seen: Observation,
    start: Observation | None,
) -> FitResult:
    if wanted.layer is not None:
        said = about(result, command_of(wanted))
        write_material_file(wanted.layer, result.material, said, source=wanted.asset)
    if wanted.picture is not None:
        from gf_usd.fitting.picture import draw

        draw(wanted.picture, result, targets, seen, start)
    return result


def command_of(wanted: Wanted) -> str:
    """The ``gf-usd fit`` that asks for the same."""
    from gf_usd.prepare.options.table import arguments

    words = ["gf-usd", "fit", wanted.asset.name]
    for text in wanted.targets:
        words += ["--target", text]
    if wanted.unknowns:
        words += ["--unknowns", ",".join(wanted.unknowns)]
    for name, (low, high) in wanted.bounds.items():
        words += ["--bounds", f"{name}={low:g}:{high:g}"]
    options = {k: v for k, v in wanted.options.items() if k != "limits"}
    return shlex.join([*words, *arguments(options)])
