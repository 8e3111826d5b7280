"""The pipeline: asset -> particles -> frames -> layers.

`run` checks the limits and locks the files. `_run_locked` simulates the variants in turn
(`variant.run_variant`), and publishes the files or, after an error of the solver, keeps what was
written.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.errors import OutOfResources, SolverError, UsageError
from gf_usd.core.frames.settings import sampled
from gf_usd.pipeline.checkpoint import CheckpointWriter, remove_checkpoints
from gf_usd.pipeline.cost.budget import require_affordable, require_resources
from gf_usd.pipeline.cost.forecast import CHECKING, WRITING, Forecast, Stages, Watch
from gf_usd.pipeline.deliver import Delivery, delete_interrupted_clips, output_lock
from gf_usd.pipeline.failure import locate_failure, write_failure
from gf_usd.pipeline.prepared import Prepared, identity_of
from gf_usd.pipeline.result import BakeResult, VariantResult, report_json
from gf_usd.pipeline.run.control import Control, Progress
from gf_usd.pipeline.run.parts import folder, resume_hint
from gf_usd.pipeline.run.variant import Outcome, run_variant
from gf_usd.prepare.options.table import MAX_HOURS
from gf_usd.prepare.outputs.outputs import create_output_folder
from gf_usd.prepare.plan import Plan, describe, input_hash
from gf_usd.system.atomic_files import partial_path, publish_text
from gf_usd.system.taichi_runtime import watching

if TYPE_CHECKING:
    from gf_usd.layers.usd_warnings import Warned
    from gf_usd.layers.variants import BakedVariant


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
    _require_sliceable(plan, slice)
    # read before the first frame, so that resuming detects files that changed meanwhile
    clipped = plan.variants if plan.choices.clip_frames else ()
    identities = [identity_of(plan, variant) for variant in clipped]
    checkpoints = CheckpointWriter(plan.outputs.checkpoints, identities, slice)
    _require_budget(prepared, max_hours)
    sequences = [files.lock for each in plan.sequences for files in each]
    from gf_usd.layers.usd_warnings import gathered

    with output_lock(plan.outputs.root, sequences, plan.seen), gathered() as warned:
        forecast = Forecast(
            prepared.cost,
            sampled(plan.settings).frames,
            max_hours,
            resume_hint=resume_hint(plan),
            remark=remark,
        )
        stages = Stages(watch)
        control = Control(
            progress=progress, checkpoints=checkpoints, forecast=forecast, stages=stages
        )
        with watching(stages.compile), watching(forecast.compile):
            return _run_locked(prepared, control, warned)


def _require_sliceable(plan: Plan, slice: int | None) -> None:
    """Raise UsageError for a slice of a bake that cannot be sliced."""
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


def _require_budget(prepared: Prepared, max_hours: float) -> None:
    """Raise InputError for a bake that needs more time, disk or memory than there is."""
    plan = prepared.plan
    path, settings = plan.asset.facts.path, plan.settings
    require_affordable(
        prepared.cost, max_hours, path=path, settings=settings, materials=plan.materials,
        tables=plan.used_tables, particles=len(plan.particles), drop=plan.drop,
        shortcuts=lambda: prepared.shortcuts,
    )  # fmt: skip
    samples = settings.frames * settings.samples_per_frame
    since = [prepared.resume.of(number) for number in range(len(plan.materials))]
    require_resources(
        prepared.cost,
        path=path,
        folder=folder(plan),
        frames=settings.frames,
        done=[min(1.0, one.index / samples) if one else 0.0 for one in since],
        copies=2 if plan.outputs.flat else 1,
    )


@dataclass(frozen=True, kw_only=True)
class Session:
    """A run that holds the lock of its files."""

    prepared: Prepared
    control: Control
    delivery: Delivery
    warned: Warned  # warnings of USD
    earlier: set[Path]  # folders of clips that the run replaces
    began: float  # [s] of `time.perf_counter`

    @property
    def plan(self) -> Plan:
        """The plan of the prepared bake."""
        return self.prepared.plan

    @property
    def seconds(self) -> float:
        """[s] since the run began."""
        return time.perf_counter() - self.began


@dataclass(frozen=True, kw_only=True)
class Finished:
    """What the simulated variants have together; those without a frame are left out."""

    results: list[VariantResult]
    baked: list[BakedVariant]
    notes: list[str]  # also those of the plan

    @property
    def clips(self) -> list[Path]:
        """The files next to the caches of all variants."""
        return [clip for one in self.results for clip in one.clips]


def _run_locked(prepared: Prepared, control: Control, warned: Warned) -> BakeResult:
    """Simulate all variants, and publish the files."""
    plan = prepared.plan
    delivery = Delivery(
        files=plan.outputs, asset=plan.asset, source=plan.source, choices=plan.choices,
        converted=prepared.converted,
    )  # fmt: skip
    earlier = delete_interrupted_clips(plan.outputs, prepared.resume)
    create_output_folder(plan.outputs)
    session = Session(
        prepared=prepared, control=control, delivery=delivery, warned=warned, earlier=earlier,
        began=time.perf_counter(),
    )  # fmt: skip
    delivery.write_source(plan.seen_source)
    outcomes: list[Outcome] = []
    for number in range(len(plan.materials)):
        outcome = run_variant(prepared, number, control)
        outcomes.append(outcome)
        if (error := outcome.error) is not None:
            raise _keep_partial_files(session, _finished(plan, outcomes), number, error) from error
    return _publish(session, _finished(plan, outcomes))


def _finished(plan: Plan, outcomes: Sequence[Outcome]) -> Finished:
    return Finished(
        results=[one.result for one in outcomes if one.result is not None],
        baked=[one.baked for one in outcomes if one.baked is not None],
        notes=[*plan.notes, *(note for one in outcomes for note in one.notes)],
    )


def _keep_partial_files(
    session: Session, finished: Finished, number: int, error: SolverError
) -> SolverError:
    """Write the report of a run that failed in a variant; returns the error to raise."""
    plan, files = session.plan, session.plan.outputs
    notes = [*finished.notes, *session.control.forecast.take_remarks()]
    baked = [replace(one, cache=partial_path(one.cache)) for one in finished.baked]
    results = [replace(r, cache=one.cache) for r, one in zip(finished.results, baked)]
    if not isinstance(error, OutOfResources):
        remove_checkpoints(files)  # resuming would fail again
    seconds = session.seconds
    failed = locate_failure(
        error, plan.variants[number].name, asset=plan.asset, embedded=plan.embedded,
        particles=plan.particles, settings=plan.settings,
    )  # fmt: skip
    report = partial(report_json, describe(plan), plan.settings, results, seconds)
    return write_failure(
        session.delivery, failed, error, variants=baked, clips=finished.clips, notes=notes,
        report=report,
    )  # fmt: skip


def _publish(session: Session, finished: Finished) -> BakeResult:
    """Give the files their final names, check them, and write the report."""
    from gf_usd.layers.check.run import review

    plan, files, control = session.plan, session.plan.outputs, session.control
    # detect a missing asset before a result has its final name
    input_hash(plan.asset.facts.path)
    control.stages.begin(WRITING)
    notes = [*finished.notes, *session.delivery.publish(finished.baked, session.earlier)]
    control.stages.begin(CHECKING)
    findings = review(files.root, plan.source)
    notes += session.warned.lines(session.prepared.warned, stated=plan.notes)
    notes += control.forecast.take_outcome()
    seconds = session.seconds
    report = report_json(describe(plan), plan.settings, finished.results, seconds, notes, findings)
    publish_text(files.report, json.dumps(report, indent=1) + "\n")
    remove_checkpoints(files)
    return BakeResult(
        root=files.root,
        report=files.report,
        bakes=tuple(finished.results),
        particles=len(plan.particles),
        seconds=seconds,
        settings=plan.settings,
        notes=tuple(notes),
        findings=tuple(findings),
        outputs=(*files.all, *finished.clips),
    )
