"""Runs the jobs of a batch: in processes of this machine, or on a cluster."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import typer

from gf_usd.batch import run
from gf_usd.batch.board import Board
from gf_usd.batch.job import Job
from gf_usd.batch.plan import BatchPlan
from gf_usd.batch.run import collect_outcomes, run_locally
from gf_usd.batch.slices import exit_status, require_clips
from gf_usd.batch.task import Limits
from gf_usd.cli.batch.console import voice
from gf_usd.cli.batch.results import Ended, ResultOptions, show_results
from gf_usd.cli.batch.selection import command_without_selection
from gf_usd.cli.streams import outlived
from gf_usd.system.processes import Children


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How the jobs are run."""

    at_once: int | None = None
    memory: float | None = None  # [GB] of a job
    overwrite: bool = False
    warm: bool = True
    scheduler: str | None = None  # address of a cluster
    resources: tuple[str, ...] = ()  # of the cluster, that each job uses
    quiet: bool = False
    slice: int | None = None  # full clips of a job in this run
    results: ResultOptions = field(default_factory=ResultOptions)


def run_jobs(plan: BatchPlan, jobs: Sequence[Job], options: RunOptions) -> int:
    """Run the jobs and show their results; returns the exit status.

    An error of stdout is raised after the records and the page are written, and only where the
    status would be 0.
    """
    with outlived() as fail_of_stdout:
        status = _run_jobs(plan, jobs, options)
        if status == 0:
            fail_of_stdout()
    return status


def _run_jobs(plan: BatchPlan, jobs: Sequence[Job], options: RunOptions) -> int:
    began = time.monotonic()
    run.require_processes()
    if options.slice:
        require_clips(jobs)
    memory = None if options.memory is None else options.memory * 1e9
    at_once = options.at_once or run.process_count(jobs, memory=memory)
    limits, results = _limits(plan, jobs, options, at_once), options.results
    children = Children()
    board = Board([job.name for job in jobs], at_once)
    with _stoppable(children) as stopped:
        with voice(
            board, as_json=results.as_json, openjd=results.openjd_lines, quiet=options.quiet
        ) as tell:
            if results.as_json:
                typer.echo(json.dumps({"event": "planned", "jobs": len(jobs), "at_once": at_once,
                                       "out": str(plan.out), "notes": plan.notes}))  # fmt: skip
            events = _events(jobs, limits, options, at_once, children)
            outcomes = collect_outcomes(events, tell)
        ended = Ended(
            outcomes=outcomes, command=command_without_selection(),
            seconds=time.monotonic() - began,
        )  # fmt: skip
        if stopped:  # a second signal does not prevent the results from being written
            show_results(plan, replace(ended, pictures=False), results)
            return 128 + stopped[0]
    show_results(plan, ended, results)
    return exit_status(outcomes, results.part)


def _limits(plan: BatchPlan, jobs: Sequence[Job], options: RunOptions, at_once: int) -> Limits:
    """The limits of each job."""
    part = options.results.part
    return Limits(
        timeout=plan.timeout, retries=plan.retries, overwrite=options.overwrite,
        threads=run.threads_per_bake(jobs, at_once), slice=options.slice,
        continues=part is not None and part.number > 1,
    )  # fmt: skip


def _events(
    jobs: Sequence[Job], limits: Limits, options: RunOptions, at_once: int, children: Children
) -> Iterator[dict[str, Any] | None]:
    """Start the jobs; yields their events."""
    if options.scheduler is not None:
        from gf_usd.batch.cluster import run_on_cluster

        return run_on_cluster(
            jobs, limits, address=options.scheduler, resources=options.resources, children=children
        )
    return run_locally(jobs, limits, at_once=at_once, children=children, warm=options.warm)


@contextmanager
def _stoppable(children: Children) -> Iterator[list[int]]:
    """SIGTERM and Ctrl-C end the bakes; the list then contains the number of the signal.

    Only the first signal does so: the handler of a second one would interrupt that of the first,
    which holds locks that cannot be acquired twice.  The bakes end after their grace period in any
    case.
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
