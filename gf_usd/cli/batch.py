"""gf-usd batch: many bakes, of which none stops another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gf_usd.cli.help import METAVARS
from gf_usd.cli.options import LimitsOf


def batch(
    sources: Annotated[
        list[str],
        typer.Argument(metavar="MANIFEST|ASSETS...",
                       help="A manifest (.toml or .json), or assets or glob patterns.")
    ],
    material: Annotated[
        str | None,
        typer.Option("--material", "-m", metavar="PRESET|FILE|auto",
                     help="Materials, separated by commas; one job for each.",
                     show_default="the manifest's, else rubber"),
    ] = None,
    seed: Annotated[
        str | None,
        typer.Option(metavar="N,...", help="Seeds, separated by commas; one job for each."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder for the results.",
                     show_default="the manifest's, else baked"),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(metavar="TEMPLATE",
                     help="Template for the names of the results, such as"
                     " {folder}/{asset}.{material}.", show_default="the manifest's"),
    ] = None,
    particles: Annotated[
        int | None, typer.Option(help="Particles of each bake, as in gf-usd bake.")
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(metavar=METAVARS["frames"], help="Frames of each bake, as in gf-usd bake."),
    ] = None,
    limits: LimitsOf = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE",
                     help="Set any option of bake, such as drop=2r; repeatable."),
    ] = None,
    at_once: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, help="Number of processes to run in parallel.",
                     show_default="by cores and memory"),
    ] = None,
    memory: Annotated[
        float | None,
        typer.Option(min=0.01, help="Memory that one job needs [GB]; limits parallel jobs.",
                     show_default="estimated"),
    ] = None,
    timeout: Annotated[
        float | None, typer.Option(min=0.1, help="End a job after this time [s].")
    ] = None,
    retries: Annotated[
        int | None,
        typer.Option(min=0, help="How often to repeat a job that crashed or timed out.",
                     show_default="1"),
    ] = None,
    select: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME|PATTERN",
                     help="Run only jobs that match this name or pattern; repeatable."),
    ] = None,
    failed: Annotated[
        bool,
        typer.Option("--failed", help="Run only jobs that did not succeed in the last run."),
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Bake finished jobs again.")
    ] = False,
    warm: Annotated[
        bool,
        typer.Option("--warm/--no-warm",
                     help="Keep processes running between jobs, which saves start-up time."),
    ] = True,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS",
                     help="Run on the Dask cluster at this address: tcp://HOST:8786."),
    ] = None,
    resource: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=AMOUNT",
                     help="Dask resource that each job uses; repeatable."),
    ] = None,
    openjd: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER",
                     help="Write an Open Job Description bundle to this folder, without baking."),
    ] = None,
    chunk: Annotated[
        int | None,
        typer.Option(min=1, help="Jobs per task of the bundle.", show_default="4; 1 with --slice"),
    ] = None,
    slice: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="End each job after this many value clips (status 5 if frames remain), or"
            " make bundle tasks of this size.",
            show_default="the whole job",
        ),
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(metavar="K/N", help="Part of the jobs that a bundle task bakes: 2/5."),
    ] = None,
    program: Annotated[
        str | None,
        typer.Option(metavar="COMMAND", help="Python with gf-usd on the bundle's workers.",
                     show_default="this one"),
    ] = None,
    tasks: Annotated[
        str | None,
        typer.Option(metavar="NUMBERS",
                     help="Run only jobs with these numbers, counted from 0: 0,3-5."),
    ] = None,
    path_mapping: Annotated[
        Path | None,
        typer.Option(metavar="FILE",
                     help="Path mapping rules of an Open Job Description session."),
    ] = None,
    openjd_lines: Annotated[
        bool, typer.Option("--openjd-lines", help="Print openjd_progress and similar lines.")
    ] = False,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Do not write the HTML page and its pictures.")
    ] = False,
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Only write the HTML page again, without baking.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="List the jobs without baking.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object per line for each event.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only the summary.")] = False,
) -> None:  # fmt: skip
    """Bake many assets with many materials and settings, in parallel.

    Finished jobs whose inputs have not changed are skipped. The exit status is 1 if a job did not
    succeed, 5 if slices remain, 143 if terminated, 130 if interrupted; run the same command again
    to continue.
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
        require_company,
    )

    for needed, there, lone in (
        ("--scheduler", scheduler, {"--resource": resource}),
        ("--openjd", openjd, {"--chunk": chunk, "--program": program}),
    ):
        require_company(lone, needed, there)

    asked = Asked(
        materials=material, seeds=seed, name=name, out=out, timeout=timeout, retries=retries,
        settings=parse_settings(
            setting or (), {
                "particles": particles, "limits": limits,
                "frames": int(frames) if frames and frames.isdecimal() else frames,
            }
        ),
        path_mapping=path_mapping,
    )  # fmt: skip
    plan = plan_of(sources, asked)
    for note in plan.notes:
        typer.echo(f"note: {note}", err=True)
    jobs = chosen(plan, Choice(select=tuple(select or ()), failed=failed, tasks=tasks))
    how = How(
        at_once=at_once, memory=memory, overwrite=overwrite, scheduler=scheduler,
        resources=tuple(resource or ()), report=not no_report, as_json=as_json,
        openjd_lines=openjd_lines, quiet=quiet, slice=slice, warm=warm, tasks=tasks is not None,
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
