"""The pipeline: asset -> particles -> frames -> layers. The only file that uses all parts of a
plan.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.errors import OutOfResources, SolverError, UsageError
from gf_usd.core.frames import BakeInfo, sampled, shortened
from gf_usd.pipeline.checkpoint import CheckpointWriter, remove_checkpoints
from gf_usd.pipeline.cost.budget import (
    ResourceGuard,
    require_affordable,
    require_resources,
    reserve,
)
from gf_usd.pipeline.cost.forecast import (
    CERTIFYING,
    CHECKING,
    SIMULATING,
    WRITING,
    Forecast,
    Stages,
    Watch,
)
from gf_usd.pipeline.deliver import Delivery, output_lock, sweep
from gf_usd.pipeline.failure import locate_failure, write_failure
from gf_usd.pipeline.frames.attachments import tet_attachments
from gf_usd.pipeline.frames.builder import FrameBuilder, with_lead_frames
from gf_usd.pipeline.frames.captured import SplatDeformer
from gf_usd.pipeline.frames.flows import FlowSurfaces
from gf_usd.pipeline.frames.period import Period
from gf_usd.pipeline.health.log import HealthLog
from gf_usd.pipeline.health.warnings import health_warnings, plan_warnings
from gf_usd.pipeline.measures.certify import certify, coarser
from gf_usd.pipeline.measures.observe import Observed, Observer
from gf_usd.pipeline.measures.rest import Rest
from gf_usd.pipeline.prepared import Prepared, has_driven_motion, identity_of, solver_of
from gf_usd.pipeline.result import BakeResult, VariantResult, report_json
from gf_usd.prepare.options.table import MAX_HOURS
from gf_usd.prepare.outputs import clear, create_output_folder
from gf_usd.prepare.plan import Plan, Variant, describe, input_hash
from gf_usd.system.atomic_files import partial_path, publish_text
from gf_usd.system.taichi_runtime import watching

if TYPE_CHECKING:
    from gf_usd.layers.usd_warnings import Warned
    from gf_usd.layers.variants import BakedVariant
    from gf_usd.physics.frame_loop import Solver


Progress = Callable[[int, int], None]  # (frames done, frames in all)
Remark = Callable[[str], None]  # called with messages during the run


def run(
    prepared: Prepared,
    progress: Progress | None = None,
    *,
    max_hours: float = MAX_HOURS,
    slice: int | None = None,
    remark: Remark | None = None,
    watch: Watch | None = None,
) -> BakeResult:
    """Simulate and write a prepared bake.

    slice : number of complete value clips after which it ends, to be resumed; None: it runs to its
    end.
    remark : called at once with each note that results from the run: see `Forecast`.
    watch : called with the current stage.

    Raises UsageError for a slice of a bake without clips, and where another bake is writing the
    same files (see `output_lock`); InputError where it would take longer than max_hours [h], or
    more disk or memory than is free; SolverError where the simulation failed (see
    `failure.write_failure`); BakeError where a file cannot be written; Unfinished where the slice
    is complete.
    """
    plan = prepared.plan
    if slice and not plan.choices.clip_frames:
        raise UsageError(
            f"--slice {slice} counts value clips, but this bake has none",
            "add --clip-frames, the number of frames per clip",
        )
    if slice and plan.choices.certify:
        raise UsageError(
            f"--slice {slice} cannot be combined with --certify, which needs all frames of one run",
            "leave out one of the two",
        )
    # read before the first frame, so that resuming detects files that changed meanwhile
    clipped = plan.variants if plan.choices.clip_frames else ()
    identities = [identity_of(plan, variant) for variant in clipped]
    checkpoints = CheckpointWriter(plan.outputs.checkpoints, identities, slice)
    path, settings = plan.asset.facts.path, plan.settings
    require_affordable(
        prepared.cost, max_hours, path=path, settings=settings, materials=plan.materials,
        particles=len(plan.particles), drop=plan.drop,
    )  # fmt: skip
    samples = settings.frames * settings.samples_per_frame
    since = [prepared.resume.of(number) for number in range(len(plan.materials))]
    require_resources(
        prepared.cost,
        path=path,
        folder=_folder(plan),
        frames=settings.frames,
        done=[min(1.0, one.index / samples) if one else 0.0 for one in since],
        copies=2 if plan.outputs.flat else 1,
    )
    sequences = [files.lock for each in plan.sequences for files in each]
    from gf_usd.layers.usd_warnings import gathered

    with output_lock(plan.outputs.root, sequences, plan.seen), gathered() as warned:
        forecast = Forecast(
            prepared.cost,
            sampled(settings).frames,
            max_hours,
            resume_hint=_resume_hint(plan),
            remark=remark,
        )
        stages = Stages(watch)
        with watching(stages.compile), watching(forecast.compile):
            return _run_locked(prepared, progress, checkpoints, forecast, warned, stages)


def _resume_hint(plan: Plan) -> str:
    """Text: how to continue a bake that ended early."""
    go_on = "run the same command with --resume to continue"
    return go_on if plan.choices.clip_frames else "bake again"


def _folder(plan: Plan) -> Path:
    """The folder of the results."""
    return plan.outputs.root.absolute().parent


def _run_locked(
    prepared: Prepared,
    progress: Progress | None,
    checkpoints: CheckpointWriter,
    forecast: Forecast,
    warned: Warned,
    stages: Stages,
) -> BakeResult:
    from gf_usd.layers.check.run import review

    plan = prepared.plan
    files = plan.outputs
    delivery = Delivery(
        files=files, asset=plan.asset, source=plan.source, choices=plan.choices,
        converted=prepared.converted,
    )  # fmt: skip
    earlier = sweep(files, prepared.resume)
    create_output_folder(files)
    began = time.perf_counter()
    delivery.write_source(plan.seen_source)
    results: list[VariantResult] = []
    baked: list[BakedVariant] = []
    notes = list(plan.notes)
    for number in range(len(plan.materials)):
        result, variant, more, error = _run_variant(
            prepared, number, progress, checkpoints, forecast, stages
        )
        if result is not None and variant is not None:
            results.append(result)
            baked.append(variant)
        notes += more
        if error is not None:
            notes += forecast.take_remarks()
            baked = [replace(one, cache=partial_path(one.cache)) for one in baked]
            results = [replace(r, cache=one.cache) for r, one in zip(results, baked)]
            if not isinstance(error, OutOfResources):
                remove_checkpoints(files)  # resuming would fail again
            seconds = time.perf_counter() - began
            failed = locate_failure(
                error, plan.variants[number].name, asset=plan.asset, embedded=plan.embedded,
                particles=plan.particles, settings=plan.settings,
            )  # fmt: skip
            report = partial(report_json, describe(plan), plan.settings, results, seconds)
            clips = [clip for one in results for clip in one.clips]
            raise write_failure(
                delivery, failed, error, variants=baked, clips=clips, notes=notes, report=report
            ) from error
    # detect a missing asset before a result has its final name
    input_hash(plan.asset.facts.path)
    stages.begin(WRITING)
    notes += delivery.publish(baked, earlier)
    stages.begin(CHECKING)
    findings = review(files.root, plan.source)
    notes += (*warned.lines(prepared.warned), *forecast.take_outcome())
    seconds = time.perf_counter() - began
    report = report_json(describe(plan), plan.settings, results, seconds, notes, findings)
    publish_text(files.report, json.dumps(report, indent=1) + "\n")
    remove_checkpoints(files)
    return BakeResult(
        root=files.root,
        report=files.report,
        bakes=tuple(results),
        particles=len(plan.particles),
        seconds=seconds,
        settings=plan.settings,
        notes=tuple(notes),
        findings=tuple(findings),
        outputs=(*files.all, *(clip for r in results for clip in r.clips)),
    )


def _run_variant(
    prepared: Prepared,
    number: int,
    progress: Progress | None,
    checkpoints: CheckpointWriter,
    forecast: Forecast,
    stages: Stages,
) -> tuple[VariantResult | None, BakedVariant | None, tuple[str, ...], SolverError | None]:
    """Simulate one variant into its cache, which keeps its partial name.

    An error of the solver is returned together with the frames before it: without a single frame,
    there is neither a result nor a cache.
    """
    from gf_usd.layers.cache import CacheWriter
    from gf_usd.layers.variants import BakedVariant

    plan, since = prepared.plan, prepared.resume.of(number)
    variant = plan.variants[number]
    total, n = plan.settings.frames, plan.settings.samples_per_frame
    settings = sampled(variant.settings)
    info = BakeInfo(
        look=variant.name,
        materials=variant.table,
        settings=variant.settings,
        command=plan.command,
        version=plan.version,
        input_hash=input_hash(plan.asset.facts.path),
    )
    log = HealthLog(
        plan.settings,
        spacing=plan.particles.spacing,
        drop=plan.drop,
        radius=plan.particles.radius,
        particles=len(plan.particles),
        held=has_driven_motion(plan),
        bodies=plan.bodies.count if plan.bodies else 1,
        obstacles=bool(plan.contact_setup and plan.contact_setup.colliders),
    )
    period = Period(
        plan.cycle * n, plan.repeats, settings.first, plan.particles.radius,
        until=plan.until_periodic,
    )  # fmt: skip
    if since is None:
        clear(variant.sequences)
    else:
        log.load(since.log)
        period.load(since.track)
    coarse, useless = _coarser(prepared, number, stages)
    stages.begin(
        SIMULATING, variant.name,
        done=number * total, total=total * len(plan.materials), left=forecast.left,
        ends_early=prepared.cost["ends_early"],
    )  # fmt: skip
    splats = splat_deformer(plan, variant)
    solver = prepared.solvers.take(variant)
    solver.on_launch = forecast.require
    forecast.begin(number, since.index if since else -1)
    observer = _observer(plan, variant) if plan.choices.certify else None
    builder = frame_builder(plan, variant, solver, splats, observer)
    guard = ResourceGuard(
        _folder(plan),
        plan.frame_bytes / n,
        reserve(total),
        _resume_hint(plan),
    )
    failure = None
    alone, ends = plan.choices.settled, plan.choices.settled or plan.choices.until_rest
    rest = _rest(plan) if ends else None
    if rest is not None and since is not None:
        rest.still = float(since.log["still"])
    settled = False
    with CacheWriter(
        variant.cache,
        plan.asset,
        plan.particles,
        info,
        source=plan.source,
        choices=plan.choices,
        tets=plan.tets,
        attachments=tet_attachments(plan.pins, plan.tets, plan.particles),
        since=since.cache if since else None,
    ) as cache:
        try:
            for sample in with_lead_frames(builder.samples(since, period), settings):
                index = sample.index
                if index < 0 and sample.splats:
                    sample = splats.held(sample)
                settled = rest is not None and rest.reached(sample.health, index)
                settled = settled and (alone or index % n == 0)
                if settled:
                    sample = builder.at_end(sample)
                if index >= settings.first and (settled or not alone):
                    guard.require(index, cache.unsaved)
                    cache.write(sample)
                    if index % n == 0:
                        splats.export(sample, 0 if alone else (index - settings.first) // n)
                if index < 0:
                    continue
                log.add(sample.health)
                frame = index // n + 1
                if progress and index % n == 0:
                    progress(number * total + frame, total * len(plan.materials))
                forecast.record_sample(
                    number, index, sample.health.substeps, builder.solver.substeps
                )
                if index % n == 0:
                    stages.begin(
                        SIMULATING, variant.name, done=number * total + frame, left=forecast.left
                    )
                if settled:
                    break
                if cache.full:
                    last, state = sample.health, builder.state()
                    seen = {**log.state(), "still": rest.still if rest else 0.0}
                    state["track"] |= period.state()
                    full = {"last": last, "log": seen, "cache": cache.state(), **state}
                    checkpoints.write(number, index, full)
                    left = index < settings.frames - 1 or number < len(plan.materials) - 1
                    if left and checkpoints.slice_done:
                        raise checkpoints.unfinished(number, variant.name, frame, total)
        except SolverError as error:
            failure = error
        if alone and rest is not None and not settled and failure is None:
            raise rest.refusal(variant.name, log.frames[-1], settings.frames, plan.asset.facts.path)
        stages.begin(WRITING, variant.name)
        summary = cache.close()
    if failure is not None and not log.frames:
        partial_path(variant.cache).unlink(missing_ok=True)
        return None, None, (), failure
    if period.skipped:
        log.skip_frames(period.skipped // n)
        info = replace(info, settings=shortened(info.settings, period.skipped // n))
    health = {**log.summary(), **period.health}
    at = ()
    if rest is not None:
        at = (rest.message(variant.name, log.frames, plan.settings.frames, settled=settled),)
    certificate = None
    if observer is not None and failure is None:
        certificate = certify(
            (observer.observed(), *coarse), held=has_driven_motion(plan) or bool(plan.goals),
            single=plan.bodies is None or plan.bodies.count == 1, reason=useless,
        )  # fmt: skip
    if plan.choices.until_rest:  # its layers end at its last frame
        info = replace(info, settings=replace(info.settings, frames=len(log.frames)))
    result = VariantResult(
        variant=variant.name,
        cache=plan.outputs.root if plan.outputs.flat else variant.cache,
        material=variant.material,
        frames=summary.frames,
        clips=summary.clips,
        at_rest=len(log.frames) if settled else None,
        health=health,
        per_frame=log.per_frame(),
        warnings=(
            *plan_warnings(plan.odd),
            *health_warnings(health, [m.law for m in variant.table]),
        ),
        certificate=certificate,
        storage=None if summary.storage is None else summary.storage.as_json(),
    )
    baked = BakedVariant(
        name=variant.name,
        cache=variant.cache,
        info=info,
        # layer metadata cannot hold None
        health={key: value for key, value in health.items() if value is not None},
        warnings=tuple(warning.message for warning in result.warnings),
        failure="" if failure is None else failure.message,
        certificate=None if certificate is None else certificate.as_json(),
        storage=result.storage,
    )
    return result, baked, (*at, *summary.notes, *splats.notes, *period.notes), failure


def _coarser(prepared: Prepared, number: int, stages: Stages) -> tuple[tuple[Observed, ...], str]:
    """Runs of a variant at lower resolutions, which write no files; or why they cannot be used."""
    plan, refill = prepared.plan, prepared.refill
    if refill is None:
        return (), ""

    def run(spacing: float) -> tuple[Observed, float]:
        # other settings that depend on the spacing, such as the number of frames, are kept
        coarse = replace(refill(spacing), settings=plan.settings, each=plan.each)
        variant = coarse.variants[number]
        observer = _observer(coarse, variant)
        solver = solver_of(coarse, variant)
        rest = _rest(plan)
        for frame in solver.frames():
            observer.add_frame(frame, frame.embedded)
            if rest.reached(frame.health, frame.index) and (
                plan.choices.until_rest or plan.choices.settled
            ):
                break
        return observer.observed(), coarse.particles.volume

    stages.begin(CERTIFYING, plan.variants[number].name)
    return coarser(plan.particles.lattice, plan.particles.volume, run)


def _observer(plan: Plan, variant: Variant) -> Observer:
    """The observer of a variant's frames."""
    carried = {path for path, _ in plan.embedded}
    paths = [s.path for s in plan.asset.surfaces if s.path not in carried]
    return Observer(plan.particles, sampled(variant.settings), paths)


def _rest(plan: Plan) -> Rest:
    """The detector of rest, which accounts for moving obstacles."""
    settings, setup = sampled(plan.settings), plan.contact_setup
    obstacles = setup.colliders if setup else ()
    moving_frames = max((one.still_from for one in obstacles), default=0)
    return Rest(settings.frame_time, plan.particles.radius, moving_frames)


def splat_deformer(plan: Plan, variant: Variant) -> SplatDeformer:
    """The captured Gaussians of a plan, in their initial state."""
    surfaces = [s for s in plan.asset.surfaces if s.path in plan.points]
    return SplatDeformer(
        {s.path: s.splats for s in surfaces if s.splats is not None},
        plan.source,
        variant.settings,
        plan.asset.facts,
        plan.particles,
        variant.sequences,
    )


def frame_builder(
    plan: Plan,
    variant: Variant,
    solver: Solver,
    splats: SplatDeformer,
    observer: Observer | None = None,
) -> FrameBuilder:
    """The frame builder of a variant and its solver; an observer receives the frames."""
    from gf_usd.geometry.skinning import MeshSkin
    from gf_usd.physics.output.gaussians import GaussianTrack

    track = GaussianTrack(plan.particles.orientation, plan.particles.scale)
    skin = None
    if plan.points and plan.settings.skin != "embed":
        skin = MeshSkin(plan.settings.skin, plan.points, plan.particles.X)
    surfaces = [s for s in plan.asset.surfaces if plan.choices.drawn(s.path)]
    keys = [tets.key for tets in plan.tets]
    flows = None
    if plan.choices.flows:
        flows = FlowSurfaces(plan.particles, variant.table, variant.settings.time_scale)
    return FrameBuilder(
        solver, track, skin, surfaces, sampled(variant.settings), splats, keys, observer, flows,
        dict(plan.choices.converting),
        open_end=plan.choices.until_rest or plan.choices.settled,
    )  # fmt: skip
