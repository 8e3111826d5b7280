"""Simulates one variant of a plan into its cache.

`_begin` makes the objects of a `VariantRun`, `_simulate` passes their samples to the cache, and
`_outcome` sums up what was written.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from gf_usd.core.errors import SolverError
from gf_usd.core.frames.frame import BakedFrame, BakeInfo
from gf_usd.core.frames.settings import Settings, sampled, shortened
from gf_usd.pipeline.checkpoint import Checkpoint
from gf_usd.pipeline.cost.budget import ResourceGuard
from gf_usd.pipeline.cost.forecast import SIMULATING, WRITING
from gf_usd.pipeline.frames.attachments import tet_attachments
from gf_usd.pipeline.frames.builder import FrameBuilder, with_lead_frames
from gf_usd.pipeline.frames.captured import SplatDeformer
from gf_usd.pipeline.frames.period import Period
from gf_usd.pipeline.health.log import HealthLog
from gf_usd.pipeline.health.warnings import health_warnings, plan_warnings
from gf_usd.pipeline.measures.observe import Observer
from gf_usd.pipeline.measures.rest import Rest
from gf_usd.pipeline.prepared import Prepared
from gf_usd.pipeline.result import VariantResult
from gf_usd.pipeline.run.coarse import CoarseRuns, run_coarser
from gf_usd.pipeline.run.control import Control
from gf_usd.pipeline.run.parts import (
    bake_info,
    end_of,
    frame_builder,
    health_log,
    observer_of,
    period_of,
    resource_guard,
    splat_deformer,
)
from gf_usd.prepare.outputs.outputs import clear
from gf_usd.prepare.plan import Plan, Variant
from gf_usd.system.atomic_files import partial_path

if TYPE_CHECKING:
    from gf_usd.layers.cache import CacheSummary, CacheWriter
    from gf_usd.layers.variants import BakedVariant


@dataclass(frozen=True, kw_only=True)
class VariantRun:
    """One variant, and the objects that simulate, measure and write it."""

    plan: Plan
    number: int  # of the variant in the plan
    variant: Variant
    settings: Settings  # as `sampled`
    info: BakeInfo
    since: Checkpoint | None  # that it resumes from
    log: HealthLog
    period: Period
    coarse: CoarseRuns
    splats: SplatDeformer
    observer: Observer | None  # of --certify
    builder: FrameBuilder
    guard: ResourceGuard
    rest: Rest | None  # that ends it; None: it has a fixed length

    @property
    def frames(self) -> int:
        """The largest number of frames."""
        return self.plan.settings.frames

    @property
    def samples_per_frame(self) -> int:
        """The number of samples from one frame to the next."""
        return self.plan.settings.samples_per_frame

    @property
    def frames_of_all(self) -> int:
        """The largest number of frames of all variants together."""
        return self.frames * len(self.plan.materials)

    @property
    def frames_before(self) -> int:
        """The largest number of frames of the variants before this one."""
        return self.number * self.frames

    @property
    def writes_rest_only(self) -> bool:
        """Whether only the state at rest is written: --settle-only."""
        return self.plan.choices.settled

    def is_whole_frame(self, index: int) -> bool:
        """Whether a sample is the first of its frame."""
        return index % self.samples_per_frame == 0


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """How the simulation of a variant ended, and what its cache contains."""

    settled: bool  # at rest, before the last frame
    error: SolverError | None
    cache: CacheSummary


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The result of a variant, and its variant of the root layer.

    After an error of the solver, both cover the frames before it; without a single frame, both are
    None.
    """

    result: VariantResult | None = None
    baked: BakedVariant | None = None
    notes: tuple[str, ...] = ()
    error: SolverError | None = None


def run_variant(prepared: Prepared, number: int, control: Control) -> Outcome:
    """Simulate one variant into its cache, which keeps its partial name.

    An error of the solver is returned in the outcome.
    """
    run = _begin(prepared, number, control)
    done = _write_cache(run, control)
    if done.error is not None and not run.log.frames:
        partial_path(run.variant.cache).unlink(missing_ok=True)
        return Outcome(error=done.error)
    if run.period.skipped:
        run.log.skip_frames(run.period.skipped // run.samples_per_frame)
    return _outcome(run, done)


def _begin(prepared: Prepared, number: int, control: Control) -> VariantRun:
    """The objects of a run. Runs the coarser simulations of --certify, and builds the solver."""
    plan, since = prepared.plan, prepared.resume.of(number)
    variant, total = plan.variants[number], plan.settings.frames
    info = bake_info(plan, variant)
    log, period = health_log(plan, since), period_of(plan, variant, since)
    if since is None:
        clear(variant.sequences)
    coarse = run_coarser(prepared, number, control.stages)
    control.stages.begin(
        SIMULATING, variant.name,
        done=number * total, total=total * len(plan.materials), left=control.forecast.left,
        ends_early=prepared.cost["ends_early"],
    )  # fmt: skip
    splats = splat_deformer(plan, variant)
    solver = prepared.solvers.take(variant)
    solver.on_launch = control.forecast.require
    control.forecast.begin(number, since.index if since else -1)
    observer = observer_of(plan, variant) if plan.choices.certify else None
    return VariantRun(
        plan=plan,
        number=number,
        variant=variant,
        settings=sampled(variant.settings),
        info=info,
        since=since,
        log=log,
        period=period,
        coarse=coarse,
        splats=splats,
        observer=observer,
        builder=frame_builder(plan, variant, solver, splats, observer),
        guard=resource_guard(plan),
        rest=end_of(plan, since),
    )


def _write_cache(run: VariantRun, control: Control) -> Simulated:
    """Simulate and write the cache; an error of the solver ends it early.

    Raises BakeError where --settle-only finds no rest; Unfinished where a slice is complete.
    """
    from gf_usd.layers.cache import CacheWriter

    plan, variant = run.plan, run.variant
    settled, failure = False, None
    with CacheWriter(
        variant.cache,
        plan.asset,
        plan.particles,
        run.info,
        source=plan.source,
        choices=plan.choices,
        tets=plan.tets,
        attachments=tet_attachments(plan.pins, plan.tets, plan.particles),
        since=run.since.cache if run.since else None,
    ) as cache:
        try:
            settled = _simulate(run, cache, control)
        except SolverError as error:
            failure = error
        if run.rest is not None and run.writes_rest_only and not settled and failure is None:
            raise run.rest.refusal(
                variant.name, run.log.frames[-1], run.settings.frames, plan.asset.facts.path
            )
        control.stages.begin(WRITING, variant.name)
        return Simulated(settled=settled, error=failure, cache=cache.close())


def _simulate(run: VariantRun, cache: CacheWriter, control: Control) -> bool:
    """Write all samples; True where the bake ends at rest, before its last frame."""
    for sample in with_lead_frames(run.builder.samples(run.since, run.period), run.settings):
        if sample.index < 0 and sample.splats:
            sample = run.splats.held(sample)
        settled = _ends_at(run, sample)
        if settled:
            sample = run.builder.at_end(sample)
        if sample.index >= run.settings.first and (settled or not run.writes_rest_only):
            _write_sample(run, cache, sample)
        if sample.index < 0:
            continue
        run.log.add(sample.health)
        _report_sample(run, control, sample)
        if settled:
            return True
        if cache.full:
            _write_checkpoint(run, cache, control, sample)
    return False


def _ends_at(run: VariantRun, sample: BakedFrame) -> bool:
    """Whether everything is at rest, so that a sample is the last one."""
    if run.rest is None or not run.rest.reached(sample.health, sample.index):
        return False
    return run.writes_rest_only or run.is_whole_frame(sample.index)


def _write_sample(run: VariantRun, cache: CacheWriter, sample: BakedFrame) -> None:
    """Write a sample to the cache and, for whole frames, to the splat sequences.

    Raises OutOfResources where the disk or the memory is nearly full.
    """
    index = sample.index
    run.guard.require(index, cache.unsaved)
    cache.write(sample)
    if run.is_whole_frame(index):
        frame = (index - run.settings.first) // run.samples_per_frame
        run.splats.export(sample, 0 if run.writes_rest_only else frame)


def _report_sample(run: VariantRun, control: Control, sample: BakedFrame) -> None:
    """Report progress, and record the cost of a sample for the forecast."""
    index, whole = sample.index, run.is_whole_frame(sample.index)
    done = run.frames_before + index // run.samples_per_frame + 1
    if control.progress and whole:
        control.progress(done, run.frames_of_all)
    control.forecast.record_sample(
        run.number, index, sample.health.substeps, run.builder.solver.substeps
    )
    if whole:
        control.stages.begin(SIMULATING, run.variant.name, done=done, left=control.forecast.left)


def _write_checkpoint(
    run: VariantRun, cache: CacheWriter, control: Control, sample: BakedFrame
) -> None:
    """Write the checkpoint after the last sample of a clip.

    Raises Unfinished where that completes the slice and samples remain.
    """
    index, state = sample.index, run.builder.state()
    state["track"] |= run.period.state()
    log = {**run.log.state(), "still": run.rest.still if run.rest else 0.0}
    control.checkpoints.write(
        run.number, index, {"last": sample.health, "log": log, "cache": cache.state(), **state}
    )
    remain = index < run.settings.frames - 1 or run.number < len(run.plan.materials) - 1
    if remain and control.checkpoints.slice_done:
        frame = index // run.samples_per_frame + 1
        raise control.checkpoints.unfinished(run.number, run.variant.name, frame, run.frames)


def _outcome(run: VariantRun, done: Simulated) -> Outcome:
    """The outcome of a run that has at least one frame."""
    from gf_usd.layers.variants import BakedVariant

    plan, variant, rest, frames = run.plan, run.variant, run.rest, run.log.frames
    health = {
        **run.log.summary(),
        "outside_meshes": list(run.builder.coarse) or None,
        **run.period.health,
    }
    certificate = None
    if run.observer is not None and done.error is None:
        certificate = run.coarse.certificate(plan, run.observer.observed())
    result = VariantResult(
        variant=variant.name,
        cache=plan.outputs.root if plan.outputs.flat else variant.cache,
        material=variant.material,
        frames=done.cache.frames,
        clips=done.cache.clips,
        at_rest=len(frames) if done.settled else None,
        health=health,
        per_frame=run.log.per_frame(),
        warnings=(
            *plan_warnings(plan.odd, plan.heavy, plan.stated_heavy),
            *health_warnings(
                health, [m.law for m in variant.table], sampled(plan.settings).time_code
            ),
        ),
        certificate=certificate,
        storage=None if done.cache.storage is None else done.cache.storage.as_json(),
    )
    baked = BakedVariant(
        name=variant.name,
        cache=variant.cache,
        info=_written_info(run),
        # layer metadata cannot hold None
        health={key: value for key, value in health.items() if value is not None},
        warnings=tuple(warning.message for warning in result.warnings),
        failure="" if done.error is None else done.error.message,
        certificate=None if certificate is None else certificate.as_json(),
        storage=result.storage,
    )
    at = ()
    if rest is not None:
        at = (
            rest.message(
                variant.name, frames, run.frames, settled=done.settled, summary=result.health
            ),
        )
    notes = (*at, *done.cache.notes, *run.splats.notes, *run.period.notes)
    return Outcome(result=result, baked=baked, notes=notes, error=done.error)


def _written_info(run: VariantRun) -> BakeInfo:
    """The record of the bake, with the settings of the frames that were written."""
    info = run.info
    if run.period.skipped:
        skipped = run.period.skipped // run.samples_per_frame
        info = replace(info, settings=shortened(info.settings, skipped))
    if run.plan.choices.until_rest:  # its layers end at its last frame
        info = replace(info, settings=replace(info.settings, frames=len(run.log.frames)))
    return info
