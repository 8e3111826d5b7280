"""What ``batch`` does with its jobs: list them, run them, hand them on, show what came of them."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import typer

from gf_usd.batch import resources
from gf_usd.batch.board import Board
from gf_usd.batch.child import Children
from gf_usd.batch.inputs import InputTable
from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.openjd import FLAT, TEMPLATE, write_bundle
from gf_usd.batch.plan import BatchPlan
from gf_usd.batch.run import collect, run_here
from gf_usd.batch.slices import Part, exit_status, faults, require_clips
from gf_usd.batch.summary import PAGE, SUMMARY, again, counts, ordered, words, write_summary
from gf_usd.batch.task import Limits
from gf_usd.cli.batch_talk import voice
from gf_usd.errors import BakeError

CHUNK = 4  # jobs in a task of a bundle
SELF = ("--only", "--failed", "--tasks")  # words that choose jobs, with their values


@dataclass(frozen=True, kw_only=True)
class How:
    """How jobs are run and talked about."""

    at_once: int | None = None
    memory: float | None = None  # [GB] of a job
    overwrite: bool = False
    scheduler: str | None = None
    resources: tuple[str, ...] = ()
    report: bool = True
    as_json: bool = False
    openjd_lines: bool = False
    quiet: bool = False
    slice: int | None = None  # full clips of a job in this run
    part: Part | None = None  # which slice of its jobs it is, where all were counted


def listing(plan: BatchPlan, jobs: Sequence[Job], *, as_json: bool) -> None:
    """The jobs on stdout, by number as ``--tasks`` counts them."""
    for number, job in enumerate(plan.jobs):
        if job in jobs:
            row = {"number": number, **job.as_json(), "command": job.command}
            typer.echo(
                json.dumps(row) if as_json else f"{number:4d}  {job.name}\n      {job.command}"
            )
    if not as_json:
        typer.echo(f"{len(jobs)} jobs, results in {plan.out}", err=True)


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
    parts = f", {slice} clips of each" if slice else ""
    typer.echo(
        f"{folder}: {len(jobs)} jobs, {chunk} in a task{parts}\n"
        f"openjd run {folder / TEMPLATE} -p file://{(folder / FLAT).absolute()}",
        err=True,
    )


def go(plan: BatchPlan, jobs: Sequence[Job], how: How) -> int:
    """Run the jobs and sum up; the exit status."""
    began = time.monotonic()
    if how.slice:
        require_clips(jobs)
    at_once = how.at_once or resources.processes(
        jobs, memory=None if how.memory is None else how.memory * 1e9
    )
    limits = Limits(
        timeout=plan.timeout, retries=plan.retries, overwrite=how.overwrite,
        threads=resources.threads(jobs, at_once),
        slice=how.slice, later=how.part is not None and how.part.number > 1,
    )  # fmt: skip
    children = Children()
    board = Board([job.name for job in jobs], at_once)
    with (
        _stoppable(children) as stopped,
        voice(board, as_json=how.as_json, openjd=how.openjd_lines, quiet=how.quiet) as tell,
    ):
        if how.as_json:
            typer.echo(json.dumps({"event": "planned", "jobs": len(jobs), "at_once": at_once,
                                   "out": str(plan.out)}))  # fmt: skip
        if how.scheduler is not None:
            from gf_usd.batch.cluster import run_there

            events = run_there(jobs, limits, address=how.scheduler, resources=how.resources,
                               children=children)  # fmt: skip
        else:
            events = run_here(jobs, limits, at_once=at_once, children=children)
        outcomes = collect(events, tell)
    repeat = again(_without_choice(), outcomes)
    _finish(plan, outcomes, how, repeat=repeat, seconds=time.monotonic() - began,
            pictures=not stopped)  # fmt: skip
    if stopped:
        return 128 + stopped[0]
    return exit_status(outcomes, how.part)


def page(plan: BatchPlan, jobs: Sequence[Job], how: How) -> None:
    """The summary and the page again, from the records of the jobs."""
    del jobs
    _finish(plan, [], how, repeat="", seconds=0.0, pictures=True)


def _finish(
    plan: BatchPlan, outcomes: Sequence[Outcome], how: How, *, repeat: str, seconds: float,
    pictures: bool,
) -> None:  # fmt: skip
    """Summary on stderr, and as files."""
    bad = [outcome for outcome in ordered(outcomes) if not outcome.good]
    if how.openjd_lines and (wrong := faults(ordered(outcomes), how.part)):
        first = wrong[0]
        said = f"{len(wrong)} of {len(outcomes)} jobs are not good: {first.job}: {first.message}"
        typer.echo(f"openjd_fail: {' '.join(said.split())}")
    for outcome in bad:
        typer.echo(f"{outcome.state}: {outcome.job}: {outcome.message}", err=True)
        if outcome.hint:
            typer.echo(f"  hint: {outcome.hint}", err=True)
    if outcomes:
        typer.echo(f"{words(outcomes)}, {seconds:.0f} s; results in {plan.out}", err=True)
    if repeat:
        typer.echo(f"to repeat just these: {repeat}", err=True)
    if how.as_json:
        summary = {"event": "summary", "counts": counts(outcomes), "seconds": round(seconds, 3),
                   "repeat": repeat}  # fmt: skip
        typer.echo(json.dumps(summary))
    if not how.report:
        return
    from gf_usd.batch.page import write_page

    target = plan.out / f"{plan.title}{PAGE}"
    try:
        entry = write_summary(
            plan.out / f"{plan.title}{SUMMARY}", outcomes, repeat=repeat, seconds=seconds,
            jobs=plan.jobs,
        )  # fmt: skip
        write_page(target, plan, entry, pictures=pictures)
    except BakeError as error:
        # the results are there, and each has its record: a page can be had later
        typer.echo(f"no page: {error}", err=True)
    else:
        typer.echo(f"{target}", err=True)


@contextmanager
def _stoppable(children: Children) -> Iterator[list[int]]:
    """SIGTERM and Ctrl-C end the bakes; the list then holds the signal's number."""
    stopped: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def stop(number: int, frame: object) -> None:
        del frame
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
    """This command's words, but for those that choose among its jobs."""
    kept, skip = ["gf-usd"], False
    for word in sys.argv[1:]:
        if skip:
            skip = False
            continue
        name, sign, _ = word.partition("=")
        if name in SELF:
            skip = not sign and name != "--failed"
            continue
        kept.append(word)
    return kept
