"""Selects jobs of a batch: --select, --failed, --tasks."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import typer

from gf_usd.batch.board import SUMMARY, earlier_run, failed_in, not_run
from gf_usd.batch.job import Job
from gf_usd.batch.plan import BatchPlan, jobs_matching, parse_task_range
from gf_usd.core.errors import counted

# options that select jobs
OPTIONS = ("--select", "--only", "--failed", "--tasks")


@dataclass(frozen=True, kw_only=True)
class Selection:
    """The options that select jobs of a plan."""

    names: tuple[str, ...] = ()  # or patterns
    failed: bool = False  # only jobs that did not succeed in the last run
    tasks: str | None = None  # numbers of jobs


def selected_jobs(plan: BatchPlan, selection: Selection) -> tuple[Job, ...]:
    """The selected jobs.  Raises UsageError for a name or number without a job."""
    jobs = jobs_matching(plan, selection.names) if selection.names else plan.jobs
    if selection.failed:
        jobs = _failed_jobs(plan, jobs)
    if selection.tasks is not None:
        numbers = parse_task_range(selection.tasks, len(plan.jobs))
        wanted = {plan.jobs[number].name for number in numbers}
        jobs = tuple(job for job in jobs if job.name in wanted)
    return jobs


def _failed_jobs(plan: BatchPlan, jobs: tuple[Job, ...]) -> tuple[Job, ...]:
    """Those of the jobs that did not succeed in the last run; notes on the others go to stderr."""
    known = earlier_run(plan.out / f"{plan.title}{SUMMARY}", plan.jobs, "--failed")
    bad = set(failed_in(known, plan.jobs))
    if left := not_run(known, jobs):
        typer.echo(
            f"note: --failed leaves out {counted(left, 'job')} that no run has ended", err=True
        )
    jobs = tuple(job for job in jobs if job.name in bad)
    if not jobs:
        typer.echo(f"note: no {'selected job' if bad else 'job'} has failed", err=True)
    return jobs


def command_without_selection() -> list[str]:
    """The arguments of this command, without the options that select jobs."""
    kept, skip = ["gf-usd"], False
    for argument in sys.argv[1:]:
        if skip:
            skip = False
            continue
        name, sign, _ = argument.partition("=")
        if name in OPTIONS:
            skip = not sign and name != "--failed"
            continue
        kept.append(argument)
    return kept
