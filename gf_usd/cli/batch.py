"""gf-usd batch: many bakes, of which none stops another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gf_usd.cli.options import LimitsOf


def batch(
    sources: Annotated[
        list[str], typer.Argument(help="A manifest (.toml, .json), or assets and patterns of them.")
    ],
    material: Annotated[
        str | None,
        typer.Option("--material", "-m", help="A job for each of these, with commas between.",
                     show_default="the manifest's, else rubber"),
    ] = None,
    seed: Annotated[
        str | None, typer.Option(help="A job for each of these, with commas between.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder of the results.",
                     show_default="the manifest's, else baked"),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(help="Template of the results' names, e.g. {folder}/{asset}.{material}."),
    ] = None,
    particles: Annotated[int | None, typer.Option(help="As for bake.")] = None,
    frames: Annotated[int | None, typer.Option(help="As for bake.")] = None,
    limits: LimitsOf = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="NAME=VALUE, any option of bake; repeatable."),
    ] = None,
    at_once: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, help="Processes at once.",
                     show_default="by cores and memory"),
    ] = None,
    memory: Annotated[
        float | None,
        typer.Option(min=0.01, help="Memory of one job [GB], to fit processes into the machine.",
                     show_default="estimated"),
    ] = None,
    timeout: Annotated[
        float | None, typer.Option(min=0.1, help="Of one attempt at a job [s].")
    ] = None,
    retries: Annotated[
        int | None,
        typer.Option(min=0, help="More attempts where a process died or took too long.",
                     show_default="1"),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="Only jobs of this name or pattern; repeatable.")
    ] = None,
    failed: Annotated[
        bool, typer.Option("--failed", help="Only jobs that were not good the last time.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Bake also what is done already.")
    ] = False,
    warm: Annotated[
        bool,
        typer.Option("--warm/--no-warm",
                     help="Let processes bake one job after the other, which saves their start."),
    ] = True,
    scheduler: Annotated[
        str | None, typer.Option(help="Run on a dask.distributed cluster: tcp://HOST:8786.")
    ] = None,
    resource: Annotated[
        list[str] | None,
        typer.Option(help="NAME=AMOUNT of a Dask worker that a job takes; repeatable."),
    ] = None,
    openjd: Annotated[
        Path | None,
        typer.Option(help="Run nothing: write a job bundle of Open Job Description here."),
    ] = None,
    chunk: Annotated[
        int | None,
        typer.Option(min=1, help="Jobs in a task of the bundle.", show_default="4; 1 with --slice"),
    ] = None,
    slice: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Value clips of each job in this run (status 5 where frames are left), or in a"
            " task of the bundle.",
            show_default="the whole job",
        ),
    ] = None,
    part: Annotated[
        str | None, typer.Option(help="Which slice of its jobs a task of a bundle is: 2/5.")
    ] = None,
    program: Annotated[
        str | None,
        typer.Option(help="Python that has gf-usd on the bundle's workers.",
                     show_default="this one"),
    ] = None,
    tasks: Annotated[
        str | None, typer.Option(help="Only the jobs of these numbers, from 0: 0,3-5.")
    ] = None,
    path_mapping: Annotated[
        Path | None, typer.Option(help="Path mapping rules of an Open Job Description session.")
    ] = None,
    openjd_lines: Annotated[
        bool, typer.Option("--openjd-lines", help="Tell openjd_progress and so on, on stdout.")
    ] = False,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Make no page, and no pictures for it.")
    ] = False,
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Bake nothing, make the page again.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the jobs.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on a line for each event.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only the summary.")] = False,
) -> None:  # fmt: skip
    """Bake many assets with many materials and settings, several at once.

    What is done already and still the same is kept. Exit status 1 if any job is not good, 5 if
    nothing but slices are left, 143 and 130 if it was terminated or interrupted; the same command
    goes on from there.
    """
    from gf_usd.batch.slices import parse_part
    from gf_usd.cli.batch_run import (
        Asked,
        Choice,
        How,
        bundle,
        chosen,
        go,
        listing,
        page,
        parse_settings,
        plan_of,
    )

    asked = Asked(
        materials=material, seeds=seed, name=name, out=out, timeout=timeout, retries=retries,
        settings=parse_settings(
            setting or (), {"particles": particles, "frames": frames, "limits": limits}
        ),
        path_mapping=path_mapping,
    )  # fmt: skip
    plan = plan_of(sources, asked)
    jobs = chosen(plan, Choice(only=tuple(only or ()), failed=failed, tasks=tasks))
    how = How(
        at_once=at_once, memory=memory, overwrite=overwrite, scheduler=scheduler,
        resources=tuple(resource or ()), report=not no_report, as_json=as_json,
        openjd_lines=openjd_lines, quiet=quiet, slice=slice, warm=warm,
        part=None if part is None else parse_part(part, slice),
    )  # fmt: skip
    if dry_run:
        listing(plan, jobs, as_json=as_json)
    elif openjd is not None:
        bundle(plan, jobs, openjd, chunk=chunk, program=program, slice=slice)
    elif report_only:
        page(plan, jobs, how)
    else:
        raise typer.Exit(go(plan, jobs, how))
