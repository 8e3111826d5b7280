"""Sums up a batch: on stderr, as messages of JSON or Open Job Description, and as files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import typer

from gf_usd.batch.board import (
    PAGE,
    SUMMARY,
    by_urgency,
    earlier_run,
    rerun_command,
    state_counts,
    summary_line,
    write_summary,
)
from gf_usd.batch.job import Outcome
from gf_usd.batch.plan import BatchPlan
from gf_usd.batch.slices import Part, failing_outcomes
from gf_usd.core.errors import BakeError, counted


@dataclass(frozen=True, kw_only=True)
class ResultOptions:
    """How the results of a batch are shown."""

    report: bool = True  # as an HTML page
    tasks: bool = False  # by their numbers, as one of several runs of the plan
    as_json: bool = False
    openjd_lines: bool = False
    part: Part | None = None  # the part of the jobs in this run, where all are counted


@dataclass(frozen=True, kw_only=True)
class Ended:
    """A run of a batch that has ended."""

    outcomes: Sequence[Outcome]
    command: Sequence[str] = ()  # that started it, without the options that select jobs
    seconds: float = 0.0
    pictures: bool = True  # draw them for the page


def write_page_again(plan: BatchPlan, options: ResultOptions) -> None:
    """Write the summary and the page again, from the records of the jobs.

    Raises UsageError where there is no record of any job.
    """
    earlier_run(plan.out / f"{plan.title}{SUMMARY}", plan.jobs, "--report-only")
    show_results(plan, Ended(outcomes=[]), options)


def show_results(plan: BatchPlan, ended: Ended, options: ResultOptions) -> None:
    """Print the summary of a run, and write it with the page."""
    repeat = rerun_command(ended.command, ended.outcomes)
    if options.openjd_lines:
        _print_openjd_failure(ended, options.part)
    _print_outcomes(plan, ended, repeat)
    if options.as_json:
        summary = {"event": "summary", "counts": state_counts(ended.outcomes),
                   "seconds": round(ended.seconds, 3), "repeat": repeat}  # fmt: skip
        typer.echo(json.dumps(summary))
    if options.tasks and not options.report:
        # one of many runs of the plan: each would read the records of all jobs
        return
    _write_files(plan, ended, report=options.report)


def _print_openjd_failure(ended: Ended, part: Part | None) -> None:
    """The message of Open Job Description that fails a task."""
    wrong = failing_outcomes(by_urgency(ended.outcomes), part)
    if not wrong:
        return
    first, count = wrong[0], counted(len(ended.outcomes), "job")
    failure = f"{len(wrong)} of {count} failed: {first.job}: {first.message}"
    typer.echo(f"openjd_fail: {' '.join(failure.split())}")


def _print_outcomes(plan: BatchPlan, ended: Ended, repeat: str) -> None:
    """The jobs that did not succeed, and the totals, on stderr."""
    for outcome in by_urgency(ended.outcomes):
        if outcome.good:
            continue
        typer.echo(f"{outcome.state}: {outcome.job}: {outcome.message}", err=True)
        if outcome.hint:
            typer.echo(f"  hint: {outcome.hint}", err=True)
    if ended.outcomes:
        totals = f"{summary_line(ended.outcomes)}, {ended.seconds:.0f} s"
        typer.echo(f"{totals}; results in {plan.out}", err=True)
    if repeat:
        typer.echo(f"to repeat only these: {repeat}", err=True)


def _write_files(plan: BatchPlan, ended: Ended, *, report: bool) -> None:
    """The summary and, with report, the page.  A file that cannot be written is no error."""
    summary, target = (plan.out / f"{plan.title}{suffix}" for suffix in (SUMMARY, PAGE))
    try:
        entry = write_summary(
            summary, ended.outcomes, arguments=ended.command, seconds=ended.seconds, jobs=plan.jobs
        )
        if not report:
            return
        from gf_usd.batch.page import write_page

        write_page(target, plan, entry, pictures=ended.pictures)
    except BakeError as error:
        # the results and their records are complete: --report-only writes the page later
        typer.echo(f"no {'page' if report else 'summary'}: {error}", err=True)
    else:
        typer.echo(f"{target}", err=True)
