"""gf-usd retime: writes a bake at another speed, without simulating it again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from gf_usd.cli.quiet import QuietExceptJson
from gf_usd.core.errors import counted
from gf_usd.core.units import bytes_text, code_text


def retime(
    bake: Annotated[Path, typer.Argument(help="Root layer of a bake.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Root layer to write: .usda, .usdc or .usd; its cache is written next to it."
            " Existing files are replaced.",
        ),
    ],
    speed: Annotated[
        float | None,
        typer.Option(
            metavar="FACTOR",
            help="Speed relative to the bake; 0.5 is slow motion. The animation of the source"
            " plays at the same speed.",
            show_default="none: give --speed or --keys",
        ),
    ] = None,
    keys: Annotated[
        str | None,
        typer.Option(
            metavar="NEW:OLD,...",
            help="Time codes of the result and of the bake: 1:1,48:24,60:48 plays the first second"
            " at half the speed, the next at twice. Equal OLD values hold a pose, decreasing"
            " ones play backwards. The animation of the source follows.",
            show_default="none",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
    quiet: QuietExceptJson = False,
) -> None:
    """Write a bake at another speed, without simulating again.

    Positions between frames follow their velocities, so that slow motion is smooth.
    """
    # pxr takes a second to import, which --help must not wait for
    from gf_usd.api.deliver import read_keys
    from gf_usd.delivery.retime import retime as write

    done = write(bake, output, speed=speed, keys=None if keys is None else read_keys(keys))
    if not quiet:
        for note in done.notes:
            typer.echo(f"note: {note}", err=True)
    if as_json:
        found = {
            "path": str(done.path),
            "caches": [str(path) for path in done.caches],
            "frames": done.frames,
            "start": done.start,
            "end": done.end,
            "notes": list(done.notes),
        }
        typer.echo(json.dumps(found, indent=1))
        return
    if quiet:
        return
    for path in (done.path, *done.caches):
        typer.echo(f"{path}  {bytes_text(path.stat().st_size)}")
    typer.echo(
        f"{counted(done.frames, 'frame')}, time codes {code_text(done.start)} to"
        f" {code_text(done.end)}"
    )
