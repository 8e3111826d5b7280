"""Makes a plan from the arguments of ``batch``, and lists, runs or exports its jobs and shows their
results.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import typer

from gf_usd.batch import run
from gf_usd.batch.board import (
    PAGE,
    SUMMARY,
    Board,
    counts,
    earlier_run,
    failed_in,
    not_run,
    ordered,
    rerun_command,
    summary_line,
    write_summary,
)
from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.manifest import (
    OUT,
    SUFFIXES,
    Manifest,
    absolute,
    clean,
    make_group,
    parse,
    read_manifest,
)
from gf_usd.batch.openjd import FLAT, TEMPLATE, write_bundle
from gf_usd.batch.plan import (
    BatchPlan,
    choose,
    is_bundle,
    make_plan,
    parse_task_range,
    read_jobs,
    with_mapped_paths,
    with_output_folder,
)
from gf_usd.batch.record import InputTable
from gf_usd.batch.run import collect_outcomes, run_locally
from gf_usd.batch.slices import Part, exit_status, failing_outcomes, require_clips
from gf_usd.batch.task import Limits
from gf_usd.cli.batch_console import voice
from gf_usd.cli.streams import outlived
from gf_usd.core.errors import BakeError, UsageError, counted
from gf_usd.system.processes import Children


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Arguments of the command line in addition to the manifest or the assets."""

    materials: str | None = None
    seeds: str | None = None
    settings: Mapping[str, Any] | None = None  # --particles, --frames and --set
    name: str | None = None
    out: Path | None = None
    timeout: float | None = None
    retries: int | None = None
    path_mapping: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Which jobs of a plan."""

    select: tuple[str, ...] = ()
    failed: bool = False
    tasks: str | None = None


def require_company(options: Mapping[str, Any], needed: str, there: object) -> None:
    """Raise UsageError for options that say nothing without another one.

    options : values by flag.
    there : the value of the flag `needed`.
    """
    for flag, value in options.items():
        if value and there is None:
            raise UsageError(f"{flag} is given without {needed}", f"give {needed}, or omit {flag}")


def chosen(plan: BatchPlan, choice: Choice) -> tuple[Job, ...]:
    """The selected jobs.  Raises UsageError for a name or number without a job."""
    jobs = choose(plan, choice.select) if choice.select else plan.jobs
    if choice.failed:
        known = earlier_run(plan.out / f"{plan.title}{SUMMARY}", plan.jobs, "--failed")
        bad = set(failed_in(known, plan.jobs))
        if left := not_run(known, jobs):
            typer.echo(
                f"note: --failed leaves out {counted(left, 'job')} that no run has ended", err=True
            )
        jobs = tuple(job for job in jobs if job.name in bad)
        if not jobs:
            typer.echo(f"note: no {'selected job' if bad else 'job'} has failed", err=True)
    if choice.tasks is not None:
        wanted = {
            plan.jobs[number].name for number in parse_task_range(choice.tasks, len(plan.jobs))
        }
        jobs = tuple(job for job in jobs if job.name in wanted)
    return jobs


def plan_of(sources: Sequence[str], asked: Asked) -> BatchPlan:
    """The plan that a manifest, the jobs of a bundle, or assets come to.

    Raises UsageError, or InputError for a manifest that cannot be read.
    """
    if asked.timeout is not None and not asked.timeout <= threading.TIMEOUT_MAX:
        raise UsageError(
            f"--timeout is {asked.timeout:g}", f"give seconds, up to {threading.TIMEOUT_MAX:.2g}"
        )
    kinds = [Path(source).suffix.lower() in SUFFIXES for source in sources]
    if any(kinds) and len(sources) > 1:
        raise UsageError(
            f"{len(sources)} files were given, but {sources[kinds.index(True)]} is a manifest",
            "give one manifest, or assets",
        )
    if kinds == [True] and is_bundle(Path(sources[0])):
        return _bundle(Path(sources[0]), asked)
    if asked.path_mapping is not None:
        raise UsageError(
            "--path-mapping applies only to the jobs of a bundle", "give the bundle's jobs.json"
        )
    manifest = read_manifest(Path(sources[0])) if kinds == [True] else _of_assets(sources, asked)
    if kinds == [True]:
        manifest = _overridden(manifest, asked)
    if asked.out is not None:
        manifest = replace(manifest, out=absolute(asked.out))
    if asked.timeout is not None:
        manifest = replace(manifest, timeout=asked.timeout)
    if asked.retries is not None:
        manifest = replace(manifest, retries=asked.retries)
    return make_plan(manifest)


def parse_settings(pairs: Sequence[str], named: Mapping[str, Any]) -> dict[str, Any]:
    """NAME=VALUE pairs and options of their own.  Raises UsageError for what is no pair."""
    settings = {key: value for key, value in named.items() if value is not None}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign or not name:
            raise UsageError(f"--set {pair}: the value is missing", "give --set NAME=VALUE")
        settings[name] = parse(name, text, f"--set {pair}")
    return settings


def _axes(asked: Asked) -> dict[str, list[Any]]:
    """The axes that the command line names: it separates jobs, not variants, by commas."""
    axes: dict[str, list[Any]] = {}
    if asked.materials is not None:
        axes["material"] = [part.strip() for part in asked.materials.split(",")]
    if asked.seeds is not None:
        axes["seed"] = [parse("seed", part, "--seed") for part in asked.seeds.split(",")]
    return axes


def _of_assets(sources: Sequence[str], asked: Asked) -> Manifest:
    group = make_group(
        sources, settings=asked.settings or {}, matrix={"material": ["rubber"], **_axes(asked)},
        name=asked.name, folder=Path.cwd(), where="the command line",
    )  # fmt: skip
    out = absolute(asked.out or Path(OUT))
    return Manifest(groups=(group,), folder=Path.cwd(), title=out.name, out=out)


def _overridden(manifest: Manifest, asked: Asked) -> Manifest:
    """A manifest whose settings and axes are replaced by those of the command line."""
    axes = {
        key: [clean({key: value}, "the command line", Path.cwd())[key] for value in values]
        for key, values in _axes(asked).items()
    }
    settings = clean(asked.settings or {}, "the command line", Path.cwd())
    groups = []
    for group in manifest.groups:
        own = {k: v for k, v in {**group.settings, **settings}.items() if k not in axes}
        matrix = {k: v for k, v in {**group.matrix, **axes}.items() if k not in settings}
        groups.append(replace(group, settings=own, matrix=matrix, name=asked.name or group.name))
    return replace(manifest, groups=tuple(groups))


def _bundle(path: Path, asked: Asked) -> BatchPlan:
    """The jobs of a bundle as they are; only where and how they run may be said anew."""
    fixed = (asked.materials, asked.seeds, asked.settings or None, asked.name)
    if any(value is not None for value in fixed):
        raise UsageError(
            f"{path} contains jobs whose options cannot be changed",
            "write the bundle again with other options",
        )
    plan = read_jobs(path)
    if asked.path_mapping is not None:
        plan = with_mapped_paths(plan, asked.path_mapping)
    if asked.out is not None:
        plan = with_output_folder(plan, absolute(asked.out))
    if asked.timeout is not None:
        plan = replace(plan, timeout=asked.timeout)
    return plan if asked.retries is None else replace(plan, retries=asked.retries)


CHUNK = 4  # jobs in a task of a bundle
# arguments that choose jobs, with their values
SELF = ("--select", "--only", "--failed", "--tasks")


@dataclass(frozen=True, kw_only=True)
class How:
    """How jobs are run and talked about."""

    at_once: int | None = None
    memory: float | None = None  # [GB] of a job
    overwrite: bool = False
    warm: bool = True
    scheduler: str | None = None
    resources: tuple[str, ...] = ()
    report: bool = True
    tasks: bool = False  # by their numbers, as one of several runs of the plan
    as_json: bool = False
    openjd_lines: bool = False
    quiet: bool = False
    slice: int | None = None  # full clips of a job in this run
    part: Part | None = None  # which slice of its jobs it is, where all were counted


def listing(plan: BatchPlan, jobs: Sequence[Job], *, as_json: bool) -> None:
    """The jobs on stdout, by number as ``--tasks`` counts them."""
    names = {job.name for job in jobs}
    for number, job in enumerate(plan.jobs):
        if job.name in names:
            row = {"number": number, **job.as_json(), "command": job.command}
            typer.echo(
                json.dumps(row) if as_json else f"{number:4d}  {job.name}\n      {job.command}"
            )
    if not as_json:
        typer.echo(f"{counted(len(jobs), 'job')}, results in {plan.out}", err=True)


def bundle(
    plan: BatchPlan, jobs: Sequence[Job], folder: Path, *, chunk: int | None, program: str | None,
    slice: int | None,
) -> None:  # fmt: skip
    """Write a job bundle and say how to try it."""
    from dataclasses import replace

    table = InputTable(Children())
    chosen = replace(plan, jobs=tuple(jobs))
    chunk = chunk or (1 if slice else CHUNK)
    write_bundle(
        chosen, folder, chunk=chunk, program=program or sys.executable, table=table, slice=slice
    )
    parts = f", {counted(slice, 'clip')} of each job" if slice else ""
    typer.echo(
        f"{folder}: {counted(len(jobs), 'job')}, {chunk} per task{parts}\n"
        f"openjd run {folder / TEMPLATE} -p file://{(folder / FLAT).absolute()}",
        err=True,
    )


def go(plan: BatchPlan, jobs: Sequence[Job], how: How) -> int:
    """Run the jobs and sum up; the exit status.

    Records and page come before an error of stdout, and so does a status that says more than it.
    """
    with outlived() as fail_of_stdout:
        status = _go(plan, jobs, how)
        if status == 0:
            fail_of_stdout()
    return status


def _go(plan: BatchPlan, jobs: Sequence[Job], how: How) -> int:
    began = time.monotonic()
    run.require_processes()
    if how.slice:
        require_clips(jobs)
    at_once = how.at_once or run.processes(
        jobs, memory=None if how.memory is None else how.memory * 1e9
    )
    limits = Limits(
        timeout=plan.timeout, retries=plan.retries, overwrite=how.overwrite,
        threads=run.threads(jobs, at_once),
        slice=how.slice, continues=how.part is not None and how.part.number > 1,
    )  # fmt: skip
    children = Children()
    board = Board([job.name for job in jobs], at_once)
    with _stoppable(children) as stopped:
        with voice(board, as_json=how.as_json, openjd=how.openjd_lines, quiet=how.quiet) as tell:
            if how.as_json:
                typer.echo(json.dumps({"event": "planned", "jobs": len(jobs), "at_once": at_once,
                                       "out": str(plan.out), "notes": plan.notes}))  # fmt: skip
            if how.scheduler is not None:
                from gf_usd.batch.cluster import run_on_cluster

                events = run_on_cluster(
                    jobs, limits, address=how.scheduler, resources=how.resources, children=children
                )
            else:
                events = run_locally(
                    jobs, limits, at_once=at_once, children=children, warm=how.warm
                )
            outcomes = collect_outcomes(events, tell)
        asked, seconds = _without_choice(), time.monotonic() - began
        if stopped:  # a second signal does not keep what was stopped from being written
            _finish(plan, outcomes, how, asked=asked, seconds=seconds, pictures=False)
            return 128 + stopped[0]
    _finish(plan, outcomes, how, asked=asked, seconds=seconds, pictures=True)
    return exit_status(outcomes, how.part)


def page(plan: BatchPlan, jobs: Sequence[Job], how: How) -> None:
    """The summary and the page again, from the records of the jobs.

    Raises UsageError where nothing is known of any job.
    """
    del jobs
    earlier_run(plan.out / f"{plan.title}{SUMMARY}", plan.jobs, "--report-only")
    _finish(plan, [], how, asked=(), seconds=0.0, pictures=True)


def _finish(
    plan: BatchPlan, outcomes: Sequence[Outcome], how: How, *, asked: Sequence[str],
    seconds: float, pictures: bool,
) -> None:  # fmt: skip
    """Summary on stderr, and as files."""
    repeat = rerun_command(asked, outcomes)
    bad = [outcome for outcome in ordered(outcomes) if not outcome.good]
    if how.openjd_lines and (wrong := failing_outcomes(ordered(outcomes), how.part)):
        first = wrong[0]
        said = (
            f"{len(wrong)} of {counted(len(outcomes), 'job')} failed: {first.job}: {first.message}"
        )
        typer.echo(f"openjd_fail: {' '.join(said.split())}")
    for outcome in bad:
        typer.echo(f"{outcome.state}: {outcome.job}: {outcome.message}", err=True)
        if outcome.hint:
            typer.echo(f"  hint: {outcome.hint}", err=True)
    if outcomes:
        typer.echo(f"{summary_line(outcomes)}, {seconds:.0f} s; results in {plan.out}", err=True)
    if repeat:
        typer.echo(f"to repeat only these: {repeat}", err=True)
    if how.as_json:
        summary = {"event": "summary", "counts": counts(outcomes), "seconds": round(seconds, 3),
                   "repeat": repeat}  # fmt: skip
        typer.echo(json.dumps(summary))
    if how.tasks and not how.report:
        # one of many runs of the plan: each would read the records of all jobs
        return
    summary, target = (plan.out / f"{plan.title}{suffix}" for suffix in (SUMMARY, PAGE))
    try:
        entry = write_summary(summary, outcomes, asked=asked, seconds=seconds, jobs=plan.jobs)
        if not how.report:
            return
        from gf_usd.batch.page import write_page

        write_page(target, plan, entry, pictures=pictures)
    except BakeError as error:
        # the results are there, and each has its record: a page can be had later
        typer.echo(f"no {'page' if how.report else 'summary'}: {error}", err=True)
    else:
        typer.echo(f"{target}", err=True)


@contextmanager
def _stoppable(children: Children) -> Iterator[list[int]]:
    """SIGTERM and Ctrl-C end the bakes; the list then holds the signal's number.

    Only the first does: a handler runs in the middle of the one before, which holds locks that are
    not to be had twice, and the bakes are ended after their grace in any case.
    """
    stopped: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def stop(number: int, frame: object) -> None:
        del frame
        if not stopped:
            stopped.append(number)
            children.stop()

    for number in before:
        signal.signal(number, stop)
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _without_choice() -> list[str]:
    """This command's arguments, but for those that choose among its jobs."""
    kept, skip = ["gf-usd"], False
    for argument in sys.argv[1:]:
        if skip:
            skip = False
            continue
        name, sign, _ = argument.partition("=")
        if name in SELF:
            skip = not sign and name != "--failed"
            continue
        kept.append(argument)
    return kept
