"""The street: asset -> particles -> frames -> layers.  The only file that knows all of it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.core.errors import OutOfRoom, SolverError
from gf_usd.core.frames import BakeInfo, sampled
from gf_usd.core.materials import Material
from gf_usd.core.scene import Scene
from gf_usd.pipeline.budget import RoomWatch, require_affordable, require_room
from gf_usd.pipeline.checkpoint import Keeper, finished, going_on
from gf_usd.pipeline.deliver import alone, deliver, sweep, write_source
from gf_usd.pipeline.failure import leave
from gf_usd.pipeline.frames import Carrier, Moving, with_held
from gf_usd.pipeline.health import HealthLog, judge
from gf_usd.pipeline.result import BakeResult, LookResult, report_json, require_healthy
from gf_usd.prepare.options.option import takes
from gf_usd.prepare.options.table import MAX_HOURS, BakeOptions
from gf_usd.prepare.outputs import claim
from gf_usd.prepare.plan import Plan, input_hash
from gf_usd.prepare.prepare import prepare as prepare_plan
from gf_usd.system.atomic_files import partial_path, publish_text

if TYPE_CHECKING:
    from gf_usd.layers.variants import BakedLook


Progress = Callable[[int, int], None]  # (frames done, frames in all)


@takes(BakeOptions)
def bake(
    path: str | Path,
    *,
    strict: bool = False,
    max_hours: float = MAX_HOURS,
    slice: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> BakeResult:
    """Fill an asset with particles, simulate it and write its layers.

    Parameters
    ----------
    path : the asset; it is never written to.
    material : a preset (see ``gf-usd materials``), a USD file with a material, or several with
        commas between them, which become variants of one root layer; default what the stage says,
        else rubber.
    output : root layer, or a folder; default ``NAME.MATERIAL.usda`` in the current folder.
    law : constitutive law in place of the material's own: corotated or neoHookean.
    prims : prim paths to bake; default all under the default prim.
    overwrite : replace results of an earlier bake.
    meters_per_unit, up_axis : in place of what the file says or omits.
    repair : mend the triangles that are filled (`geometry.repair`); the asset keeps its own.
    strict : raise UnhealthyError where the finished bake has warnings.
    max_hours : refuse a bake whose estimate is longer.
    resume : go on from the checkpoints of this bake, if it ended early; see the guide.
    slice : full value clips after which it ends, to be resumed.
    limits : `sandbox.Limits` of a child process that reads the asset first; None: no such trial.
    progress : called after each frame with (frames done, frames in all).
    options : the fields of `Request`: particles, spacing [stage units], frames, fps,
        start [time code], drop ("3r" or stage units), gravity [m/s^2], seed, device, threads,
        filter_rate [1/T], damping_time [s], friction, restitution, time_scale, skin and so on.

    Raises
    ------
    UsageError : the options make no sense, or the output exists or cannot be written.
    InputError : the asset was refused; nothing was written.
    BakeError : the simulation failed; only ``*.partial.*`` files and the report remain.  It is a
        SolverError, with the frame and the particle, where the solver could not go on.
    Unfinished : the slice is done, and there are frames left.
    UnhealthyError : strict, and there are warnings; the files are written.
    """
    plan = prepare(path, **options)
    result = run(plan, progress, max_hours=max_hours, slice=slice)
    if strict:
        require_healthy(result)
    return result


def prepare(
    path: str | Path, *, overwrite: bool = False, resume: bool = False, **options: Any
) -> Plan:
    """The plan of a bake, with the checkpoints that it goes on from; see `bake`."""
    plan = prepare_plan(path, overwrite=overwrite, resume=resume, draw=draw, **options)
    return going_on(plan, overwrite=overwrite) if resume else plan


def draw(scene: Scene, size: tuple[int, int]) -> Any:
    """The picture of an asset that an advisor is shown."""
    from gf_usd.view.render.render import render

    return render(scene, size=size)


def run(
    plan: Plan,
    progress: Progress | None = None,
    *,
    max_hours: float = MAX_HOURS,
    slice: int | None = None,
) -> BakeResult:
    """Simulate and write a prepared bake.

    Raises InputError where it would take longer than max_hours, or more disk or memory than is
    free (see `room`), UsageError where another bake
    is writing the same (see `writing.alone`), SolverError where the simulation
    failed (see `failure.leave`), BakeError where the disk did.
    """
    keeper = Keeper(plan, slice)
    require_affordable(plan, max_hours)
    require_room(plan)
    with alone(plan):
        return _run_alone(plan, progress, keeper)


def _run_alone(plan: Plan, progress: Progress | None, keeper: Keeper) -> BakeResult:
    from gf_usd.layers.check.run import review

    earlier = sweep(plan)
    claim(plan.outputs)
    began = time.perf_counter()
    write_source(plan)
    results: list[LookResult] = []
    looks: list[BakedLook] = []
    notes = list(plan.notes)
    for number, material in enumerate(plan.materials):
        result, look, more, error = _run_look(plan, number, material, progress, keeper)
        results.append(result)
        looks.append(look)
        notes += more
        if error is not None:
            looks = [replace(look, cache=partial_path(look.cache)) for look in looks]
            results = [replace(r, cache=look.cache) for r, look in zip(results, looks)]
            if not isinstance(error, OutOfRoom):
                finished(plan.outputs)  # it would fail again
            seconds = time.perf_counter() - began
            raise leave(plan, results, looks, error, notes=notes, seconds=seconds) from error
    input_hash(plan)  # an asset that is gone is found out before a result has its final name
    notes += deliver(plan, looks, earlier)
    findings = review(plan.outputs.root, plan.source)
    seconds = time.perf_counter() - began
    report = report_json(plan, results, notes=notes, seconds=seconds, findings=findings)
    publish_text(plan.outputs.report, json.dumps(report, indent=1) + "\n")
    finished(plan.outputs)
    return BakeResult(
        root=plan.outputs.root,
        report=plan.outputs.report,
        bakes=tuple(results),
        particles=len(plan.particles),
        seconds=seconds,
        settings=plan.settings,
        notes=tuple(notes),
        findings=tuple(findings),
        outputs=(*plan.outputs.all, *(clip for r in results for clip in r.clips)),
    )


def _run_look(
    plan: Plan, number: int, material: Material, progress: Progress | None, keeper: Keeper
) -> tuple[LookResult, BakedLook, tuple[str, ...], SolverError | None]:
    """Simulate one material into its cache, which keeps its partial name.

    A failure of the solver is returned with what was had before it.
    """
    from gf_usd.layers.cache import CacheWriter
    from gf_usd.layers.variants import BakedLook

    total = plan.settings.frames
    settings = sampled(plan.settings_of(material))
    n = plan.settings.samples_per_frame
    info = BakeInfo(
        look=material.name,
        materials=plan.table(material),
        settings=plan.settings_of(material),
        command=plan.command,
        version=plan.version,
        input_hash=input_hash(plan),
    )
    log = HealthLog(
        plan.settings,
        spacing=plan.particles.spacing,
        drop=plan.drop,
        radius=plan.particles.radius,
        particles=len(plan.particles),
        held=bool(plan.pins),
        bodies=plan.bodies.count if plan.bodies else 1,
    )
    since = plan.standing[number] if plan.standing else None
    if since:
        log.recall(since.log)
    target = plan.outputs.caches[number]
    carrier = Carrier(plan, number, since)
    moving = Moving(plan, material, carrier, since)
    room = RoomWatch(plan)
    failure = None
    with CacheWriter(
        target,
        plan.asset,
        plan.particles,
        info,
        source=plan.source,
        choices=plan.choices,
        since=since.cache if since else None,
    ) as cache:
        try:
            for baked in with_held(moving.samples(), settings):
                if baked.index < 0 and baked.splats:
                    baked = carrier.held(baked)
                if baked.index >= settings.first:
                    room.require(baked.index, cache.unsaved)
                    cache.write(baked)
                    if baked.index % n == 0:
                        carrier.export(baked, (baked.index - settings.first) // n)
                if baked.index < 0:
                    continue
                log.add(baked.health)
                if progress and baked.index % n == 0:
                    done = number * total + baked.index // n + 1
                    progress(done, total * len(plan.materials))
                if cache.full:
                    keeper.keep(
                        number,
                        baked.index,
                        {
                            "last": baked.health,
                            "log": log.state(),
                            "cache": cache.state(),
                            "solver": moving.solver.standing(),
                            "track": {**moving.track.state(), **carrier.state()},
                        },
                    )
        except SolverError as error:
            failure = error
        summary = cache.close()
    health = log.summary()
    result = LookResult(
        look=material.name,
        cache=plan.outputs.root if plan.outputs.flat else target,
        material=material,
        frames=summary.frames,
        clips=summary.clips,
        health=health,
        per_frame=log.per_frame(),
        warnings=judge(health),
    )
    look = BakedLook(
        name=material.name,
        cache=target,
        info=info,
        health=_plain(health),
        warnings=tuple(caution.message for caution in result.warnings),
        failure="" if failure is None else failure.message,
    )
    return result, look, (*summary.notes, *carrier.notes), failure


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Without None, which layer metadata cannot hold."""
    return {key: value for key, value in values.items() if value is not None}
