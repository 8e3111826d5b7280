"""The pipeline: asset -> particles -> frames -> layers.  The one file that takes a plan apart."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.core.errors import BakeError, OutOfResources, SolverError, UsageError
from gf_usd.core.frames import BakeInfo, Health, sampled, shortened
from gf_usd.core.scene import Scene
from gf_usd.pipeline.budget import (
    Cost,
    ResourceGuard,
    Solvers,
    estimate,
    first_contact,
    require_affordable,
    require_resources,
    reserve,
)
from gf_usd.pipeline.checkpoint import CheckpointWriter, Resume, find_resume, finished, identity
from gf_usd.pipeline.deliver import Delivery, output_lock, sweep
from gf_usd.pipeline.failure import leave, place
from gf_usd.pipeline.forecast import (
    CERTIFYING,
    CHECKING,
    FILLING,
    READING,
    SIMULATING,
    WRITING,
    Forecast,
    Stages,
    Watch,
)
from gf_usd.pipeline.frames import (
    FrameBuilder,
    Period,
    Rest,
    SplatDeformer,
    with_held,
)
from gf_usd.pipeline.health import HealthLog, health_warnings, plan_warnings
from gf_usd.pipeline.measures.certify import certify, coarser
from gf_usd.pipeline.measures.observe import Observed, Observer
from gf_usd.pipeline.result import BakeResult, VariantResult, report_json
from gf_usd.prepare.options.table import MAX_HOURS
from gf_usd.prepare.outputs import claim, clear
from gf_usd.prepare.plan import Plan, Variant, describe, input_hash
from gf_usd.prepare.prepare import Refill
from gf_usd.prepare.prepare import prepare as prepare_plan
from gf_usd.system.atomic_files import partial_path, publish_text
from gf_usd.system.taichi_runtime import watching

if TYPE_CHECKING:
    from gf_usd.layers.usd_warnings import Warned
    from gf_usd.layers.variants import BakedVariant
    from gf_usd.physics.frame_loop import Solver
    from gf_usd.readers.mesh.to_usd import MeshSource


Progress = Callable[[int, int], None]  # (frames done, frames in all)
Remark = Callable[[str], None]  # told, in words, what turns out while it runs


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A bake that is ready to run: its plan, and what is there only while the process is."""

    plan: Plan
    converted: MeshSource | None = None  # of an asset that is not USD; holds a temporary folder
    resume: Resume = field(default_factory=Resume)
    refill: Refill | None = None  # fills the same asset more coarsely; None: nobody needs it
    warned: frozenset[str] = frozenset()  # what USD warned of, told in the plan's notes

    @cached_property
    def solvers(self) -> Solvers:
        """The solvers of its variants."""
        return Solvers(partial(solver_of, self.plan), len(self.plan.particles))

    @cached_property
    def cost(self) -> Cost:
        """Of `budget.estimate`; builds the solvers."""
        plan = self.plan
        setup = plan.contact_setup
        samples = plan.settings.samples_per_frame
        surfaces = plan.asset.surfaces
        return estimate(
            plan.settings,
            plan.materials,
            [samples * self.solvers.substeps(variant) for variant in plan.variants],
            particles=len(plan.particles),
            vertices=sum(len(s.points if s.splats is None else s.splats) for s in surfaces),
            paired=len(plan.samples.X) if setup and setup.any else 0,
            frame_bytes=plan.frame_bytes,
            first_contact=None if _pushed(plan) else first_contact(plan.settings, plan.drop),
            flying=_flying(plan),
            fall=0.0 if plan.held or plan.goals else max(0.0, plan.drop),
            damping=[self.solvers.damping(variant) for variant in plan.variants],
            crowd=bool(setup and (setup.colliders or len(setup.skins) > 1)),
        )


def prepare(
    path: str | Path,
    *,
    overwrite: bool = False,
    resume: bool = False,
    watch: Watch | None = None,
    **options: Any,
) -> Prepared:
    """A bake with the checkpoints that it goes on from, ready to run; see `gf_usd.bake`.

    watch : is told what it is doing.
    """
    from gf_usd.layers.usd_warnings import gathered

    stages = Stages(watch)
    if resume and options.get("certify"):
        raise UsageError(
            "--certify does not go with --resume: it needs all frames of one run",
            "bake anew with --overwrite, or leave --certify out",
        )
    stages.begin(READING, Path(path).name)
    refills: list[Refill] = []
    with gathered() as warned, watching(stages.compile):
        plan, converted = prepare_plan(
            path, overwrite=overwrite, resume=resume, draw=draw,
            once_read=partial(stages.begin, FILLING), once_filled=refills.append, **options,
        )  # fmt: skip
    plan = replace(plan, notes=(*plan.notes, *warned.lines()))
    told = frozenset(warned.said)
    if not resume:
        refill = refills[0] if plan.choices.certify else None
        return Prepared(plan=plan, converted=converted, refill=refill, warned=told)
    clips = bool(plan.choices.clip_frames)
    identify = partial(_identity, plan)
    found = find_resume(plan.variants, identify, clips=clips, overwrite=overwrite)
    plan = replace(plan, notes=(*plan.notes, *found.notes))
    return Prepared(plan=plan, converted=converted, resume=found, warned=told)


def _identity(plan: Plan, variant: Variant) -> dict[str, str]:
    """Of a checkpoint of a variant."""
    return identity(
        variant.settings, variant.table, plan.choices, plan.particles,
        plan.contact_setup.colliders if plan.contact_setup else (),
        asset=plan.asset.facts.path, command=plan.command,
    )  # fmt: skip


def draw(scene: Scene, size: tuple[int, int]) -> Any:
    """The picture of an asset that an advisor is shown."""
    from gf_usd.view.render.render import render

    return render(scene, size=size)


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

    slice : full value clips after which it ends, to be resumed; None: at its end.
    remark : is told at once what the result's notes hold in the end: see `Forecast`.
    watch : is told what it is doing.

    Raises UsageError for a slice of a bake without clips, and where another bake is writing the
    same (see `output_lock`); InputError where it would take longer than max_hours [h], or more disk
    or memory than is free; SolverError where the simulation failed (see `failure.leave`);
    BakeError where the disk did; Unfinished where the slice is done.
    """
    plan = prepared.plan
    if slice and not plan.choices.clip_frames:
        raise UsageError(
            f"--slice {slice} counts value clips, and this bake has none",
            "add --clip-frames, the frames of a clip",
        )
    if slice and plan.choices.certify:
        raise UsageError(
            f"--slice {slice} does not go with --certify: it needs all frames of one run",
            "leave one of the two out",
        )
    # read before the first frame: a file that changes meanwhile is found by who resumes
    clipped = plan.variants if plan.choices.clip_frames else ()
    identities = [_identity(plan, variant) for variant in clipped]
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
        done=[min(1.0, one.index / samples) if one else 0.0 for one in since],
        copies=2 if plan.outputs.flat else 1,
    )
    sequences = [files.lock for each in plan.sequences for files in each]
    from gf_usd.layers.usd_warnings import gathered

    with output_lock(plan.outputs.root, sequences, plan.seen), gathered() as warned:
        forecast = Forecast(
            prepared.cost, sampled(settings).frames, max_hours, again=_again(plan), remark=remark
        )
        stages = Stages(watch)
        with watching(stages.compile), watching(forecast.compile):
            return _run_locked(prepared, progress, checkpoints, forecast, warned, stages)


def _again(plan: Plan) -> str:
    """How to have the rest of a bake that ended early, in words."""
    go_on = "the same command with --resume goes on"
    return go_on if plan.choices.clip_frames else "bake again"


def _pushed(plan: Plan) -> bool:
    """Whether more than gravity and contact moves the bodies."""
    return plan.held or bool(plan.settings.fields)


def _flying(plan: Plan) -> int:
    """Frames at the start that need no substeps, since all bodies are in free flight."""
    from gf_usd.physics.total_lagrangian.shape_correction import acts

    s = plan.settings
    held = plan.pins or plan.goals or s.fields or any(map(callable, plan.velocity))
    if held or not s.shortcuts or s.solver != "tl" or s.drag or acts(s):
        return 0
    if plan.contact_setup is not None and plan.contact_setup.colliders:
        return 0
    frame = first_contact(s, plan.drop)
    return s.frames if frame is None else max(0, frame - 2)  # one more is near enough


def _folder(plan: Plan) -> Path:
    """Of the results."""
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
    claim(files)
    began = time.perf_counter()
    delivery.write_source(plan.seen_source)
    results: list[VariantResult] = []
    baked: list[BakedVariant] = []
    notes = list(plan.notes)
    for number in range(len(plan.materials)):
        result, variant, more, error = _run_variant(
            prepared, number, progress, checkpoints, forecast, stages
        )
        results.append(result)
        baked.append(variant)
        notes += (*more, *forecast.take())
        if error is not None:
            baked = [replace(one, cache=partial_path(one.cache)) for one in baked]
            results = [replace(r, cache=one.cache) for r, one in zip(results, baked)]
            if not isinstance(error, OutOfResources):
                finished(files)  # it would fail again
            seconds = time.perf_counter() - began
            failed = place(
                error, variant.name, asset=plan.asset, embedded=plan.embedded,
                particles=plan.particles, settings=plan.settings,
            )  # fmt: skip
            report = partial(report_json, describe(plan), plan.settings, results, seconds)
            clips = [clip for one in results for clip in one.clips]
            raise leave(
                delivery, failed, error, variants=baked, clips=clips, notes=notes, report=report
            ) from error
    # an asset that is gone is found out before a result has its final name
    input_hash(plan.asset.facts.path)
    stages.begin(WRITING)
    notes += delivery.publish(baked, earlier)
    stages.begin(CHECKING)
    findings = review(files.root, plan.source)
    notes += warned.lines(prepared.warned)
    seconds = time.perf_counter() - began
    report = report_json(describe(plan), plan.settings, results, seconds, notes, findings)
    publish_text(files.report, json.dumps(report, indent=1) + "\n")
    finished(files)
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
) -> tuple[VariantResult, BakedVariant, tuple[str, ...], SolverError | None]:
    """Simulate one variant into its cache, which keeps its partial name.

    A failure of the solver is returned with what was had before it.
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
        held=_pushed(plan),
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
        _again(plan),
    )
    failure = None
    alone, ends = plan.choices.settled, plan.choices.settled or plan.choices.until_rest
    rest = Rest(settings.frame_time, plan.particles.radius) if ends else None
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
        since=since.cache if since else None,
    ) as cache:
        try:
            for sample in with_held(builder.samples(since, period), settings):
                index = sample.index
                if index < 0 and sample.splats:
                    sample = splats.held(sample)
                settled = rest is not None and rest.reached(sample.health)
                settled = settled and (alone or index % n == 0)
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
                forecast.after(number, index, sample.health.substeps, builder.solver.substeps)
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
                    if left and checkpoints.sliced:
                        raise checkpoints.unfinished(number, variant.name, frame, total)
        except SolverError as error:
            failure = error
        if alone and rest is not None and not settled and failure is None:
            raise _restless(plan, variant.name, rest, log.frames[-1])
        stages.begin(WRITING, variant.name)
        summary = cache.close()
    if period.skipped:
        log.leave_out(period.skipped // n)
        info = replace(info, settings=shortened(info.settings, period.skipped // n))
    health = {**log.summary(), **period.health}
    at = _when_at_rest(plan, variant.name, rest, log, settled=settled) if rest else ()
    certificate = None
    if observer is not None and failure is None:
        certificate = certify(
            (observer.observed(), *coarse), held=_pushed(plan) or bool(plan.goals),
            single=plan.bodies is None or plan.bodies.count == 1, reason=useless,
        )  # fmt: skip
    if plan.choices.until_rest:  # its layers end where it ended
        info = replace(info, settings=replace(info.settings, frames=len(log.frames)))
    result = VariantResult(
        look=variant.name,
        cache=plan.outputs.root if plan.outputs.flat else variant.cache,
        material=variant.material,
        frames=summary.frames,
        clips=summary.clips,
        at_rest=len(log.frames) if settled else None,
        health=health,
        per_frame=log.per_frame(),
        warnings=(*plan_warnings(plan.odd), *health_warnings(health)),
        certificate=certificate,
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
    )
    return result, baked, (*at, *summary.notes, *splats.notes, *period.notes), failure


def _coarser(prepared: Prepared, number: int, stages: Stages) -> tuple[tuple[Observed, ...], str]:
    """A variant at lower resolutions, without writing anything, and why that is of no use."""
    plan, refill = prepared.plan, prepared.refill
    if refill is None:
        return (), ""

    def run(spacing: float) -> tuple[Observed, float]:
        # what else follows from the spacing, such as the frames of a body of another volume, stays
        coarse = replace(refill(spacing), settings=plan.settings, each=plan.each)
        variant = coarse.variants[number]
        observer = _observer(coarse, variant)
        solver = solver_of(coarse, variant)
        rest = Rest(plan.settings.frame_time, plan.particles.radius)
        for frame in solver.frames():
            observer.see(frame, frame.embedded)
            if rest.reached(frame.health) and (plan.choices.until_rest or plan.choices.settled):
                break
        return observer.observed(), coarse.particles.volume

    stages.begin(CERTIFYING, plan.variants[number].name)
    return coarser(plan.particles.lattice, plan.particles.volume, run)


def _observer(plan: Plan, variant: Variant) -> Observer:
    """What is shown the frames of a variant."""
    carried = {path for path, _ in plan.embedded}
    paths = [s.path for s in plan.asset.surfaces if s.path not in carried]
    return Observer(plan.particles, sampled(variant.settings), paths)


def _when_at_rest(
    plan: Plan, look: str, rest: Rest, log: HealthLog, *, settled: bool
) -> tuple[str, ...]:
    """When a material came to rest, in words."""
    if settled:
        return (f"{look}: at rest at frame {len(log.frames)}",)
    last = log.frames[-1]
    return (
        f"{look}: not at rest within {plan.settings.frames} frames: the kinetic energy of the last"
        f" one is {last.kinetic:.3g} J, and {rest.limit(last):.3g} J counts as rest;"
        f" --frames rest:{2 * plan.settings.frames} simulates longer",
    )


def _restless(plan: Plan, look: str, rest: Rest, last: Health) -> BakeError:
    """For --settle-only where something still moves in the last frame."""
    frames = plan.settings.frames
    return BakeError(
        f"{plan.asset.facts.path}, {look}: not at rest within {frames} frames: the kinetic energy"
        f" of the last one is {last.kinetic:.3g} J, and {rest.limit(last):.3g} J counts as rest",
        f"simulate longer with --frames {2 * frames}, or calm it with --drag, --friction or another"
        " material; what is driven by a moving pin or obstacle, or drifts without gravity, never"
        " rests",
    )


def solver_of(plan: Plan, variant: Variant) -> Solver:
    """The solver of a variant, at its start."""
    from gf_usd.physics.solvers import make_solver

    more: dict[str, Any] = {}
    if plan.velocity:
        more["velocity"] = list(plan.velocity) if plan.velocity[1:] else plan.velocity[0]
    if plan.settings.solver == "tl" and plan.bodies is not None:
        more |= {
            "contact_setup": plan.contact_setup,
            "goals": plan.goals,
            "embedded_body": {**plan.bodies.embedded, **{t.key: t.body for t in plan.tets}},
            "embedded_copy": plan.embedded_copies,
        }
    return make_solver(
        sampled(variant.settings),
        plan.particles,
        variant.table,
        samples=plan.samples,
        embedded=plan.points if plan.settings.skin == "embed" else {},
        pins=plan.pins,
        **more,
    )


def splat_deformer(plan: Plan, variant: Variant) -> SplatDeformer:
    """The captured Gaussians of a plan, at their start."""
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
    """What makes samples of the frames of a variant's solver, which an observer is shown."""
    from gf_usd.geometry.skinning import MeshSkin
    from gf_usd.physics.gaussians import GaussianTrack

    track = GaussianTrack(plan.particles.orientation, plan.particles.scale)
    skin = None
    if plan.points and plan.settings.skin != "embed":
        skin = MeshSkin(plan.settings.skin, plan.points, plan.particles.X)
    surfaces = plan.asset.surfaces if plan.choices.mesh else ()
    keys = [tets.key for tets in plan.tets]
    return FrameBuilder(
        solver, track, skin, surfaces, sampled(variant.settings), splats, keys, observer
    )
