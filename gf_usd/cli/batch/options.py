"""The options of gf-usd batch, as annotations of the parameters of `command.batch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gf_usd.cli.help import METAVARS

# the jobs
Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="MANIFEST|ASSETS...",
        help="A manifest (.toml or .json), or assets or glob patterns.",
    ),
]
Material = Annotated[
    str | None,
    typer.Option(
        "--material",
        "-m",
        metavar="PRESET|FILE|auto",
        help="Materials, separated by commas; one job for each.",
        show_default="the manifest's, else rubber",
    ),
]
Seed = Annotated[
    str | None,
    typer.Option(metavar="N,...", help="Seeds, separated by commas; one job for each."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FOLDER",
        help="Folder for the results.",
        show_default="the manifest's, else baked",
    ),
]
Name = Annotated[
    str | None,
    typer.Option(
        metavar="TEMPLATE",
        help="Template for the names of the results, such as {folder}/{asset}.{material}.",
        show_default="the manifest's",
    ),
]
Particles = Annotated[int | None, typer.Option(help="Particles of each bake, as in gf-usd bake.")]
Frames = Annotated[
    str | None,
    typer.Option(metavar=METAVARS["frames"], help="Frames of each bake, as in gf-usd bake."),
]
Setting = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", help="Set any option of bake, such as drop=2r; repeatable."
    ),
]
Timeout = Annotated[float | None, typer.Option(min=0.1, help="End a job after this time [s].")]
Retries = Annotated[
    int | None,
    typer.Option(
        min=0, help="How often to repeat a job that crashed or timed out.", show_default="1"
    ),
]
PathMapping = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Path mapping rules of an Open Job Description session."),
]

# which of the jobs
Select = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME|PATTERN", help="Run only jobs that match this name or pattern; repeatable."
    ),
]
Failed = Annotated[
    bool,
    typer.Option("--failed", help="Run only jobs that did not succeed in the last run."),
]
Tasks = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBERS", help="Run only jobs with these numbers, counted from 0: 0,3-5."
    ),
]

# how they run
AtOnce = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        min=1,
        help="Number of processes to run in parallel.",
        show_default="by cores and memory",
    ),
]
Memory = Annotated[
    float | None,
    typer.Option(
        min=0.01,
        help="Memory that one job needs [GB]; limits parallel jobs.",
        show_default="estimated",
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Bake finished jobs again.")]
Warm = Annotated[
    bool,
    typer.Option(
        "--warm/--no-warm", help="Keep processes running between jobs, which saves start-up time."
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Run on the Dask cluster at this address: tcp://HOST:8786."
    ),
]
Resource = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=AMOUNT", help="Dask resource that each job uses; repeatable."),
]
Slice = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="End each job after this many value clips (status 5 if frames remain), or"
        " make bundle tasks of this size.",
        show_default="the whole job",
    ),
]
Part = Annotated[
    str | None,
    typer.Option(metavar="K/N", help="Part of the jobs that a bundle task bakes: 2/5."),
]

# the bundle for a render farm
OpenJD = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Write an Open Job Description bundle to this folder, without baking.",
    ),
]
Chunk = Annotated[
    int | None,
    typer.Option(min=1, help="Jobs per task of the bundle.", show_default="4; 1 with --slice"),
]
Program = Annotated[
    str | None,
    typer.Option(
        metavar="COMMAND",
        help="Python with gf-usd on the bundle's workers.",
        show_default="this one",
    ),
]

# output
NoReport = Annotated[
    bool, typer.Option("--no-report", help="Do not write the HTML page and its pictures.")
]
ReportOnly = Annotated[
    bool, typer.Option("--report-only", help="Only write the HTML page again, without baking.")
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="List the jobs without baking.")]
AsJSON = Annotated[
    bool, typer.Option("--json", help="Print one JSON object per line for each event.")
]
OpenJDLines = Annotated[
    bool, typer.Option("--openjd-lines", help="Print openjd_progress and similar lines.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only the summary.")]
