"""Shows the jobs of a batch, or writes them as a bundle, without baking."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import typer

from gf_usd.batch.job import Job
from gf_usd.batch.openjd import FLAT, TEMPLATE, write_bundle
from gf_usd.batch.plan import BatchPlan
from gf_usd.batch.record import InputTable
from gf_usd.core.errors import counted
from gf_usd.system.processes import Children

CHUNK = 4  # jobs in a task of a bundle


def list_jobs(plan: BatchPlan, jobs: Sequence[Job], *, as_json: bool) -> None:
    """Print the jobs to stdout, each with the number that ``--tasks`` takes."""
    names = {job.name for job in jobs}
    for number, job in enumerate(plan.jobs):
        if job.name in names:
            row = {"number": number, **job.as_json(), "command": job.command}
            typer.echo(
                json.dumps(row) if as_json else f"{number:4d}  {job.name}\n      {job.command}"
            )
    if not as_json:
        typer.echo(f"{counted(len(jobs), 'job')}, results in {plan.out}", err=True)


@dataclass(frozen=True, kw_only=True)
class BundleOptions:
    """The form of a job bundle."""

    folder: Path
    chunk: int | None = None  # jobs per task
    program: str | None = None  # Python of the workers
    slice: int | None = None  # value clips per task


def export_bundle(plan: BatchPlan, jobs: Sequence[Job], options: BundleOptions) -> None:
    """Write a job bundle, and print the command that runs it."""
    folder, slice = options.folder, options.slice
    chunk = options.chunk or (1 if slice else CHUNK)
    write_bundle(
        replace(plan, jobs=tuple(jobs)), folder, chunk=chunk,
        program=options.program or sys.executable, table=InputTable(Children()), slice=slice,
    )  # fmt: skip
    parts = f", {counted(slice, 'clip')} of each job" if slice else ""
    typer.echo(
        f"{folder}: {counted(len(jobs), 'job')}, {chunk} per task{parts}\n"
        f"openjd run {folder / TEMPLATE} -p file://{(folder / FLAT).absolute()}",
        err=True,
    )
