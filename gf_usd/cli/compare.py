"""gf-usd compare: compares two bakes, or a bake and the motion of another program, by points."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gf_usd.cli.quiet import QuietExceptJson
from gf_usd.core.errors import counted
from gf_usd.core.units import bytes_text, code_text

if TYPE_CHECKING:
    from gf_usd.view.compare import Comparison


def compare(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="Root layer of a bake, or any animated USD file.")
    ],
    second: Annotated[
        Path,
        typer.Argument(
            metavar="B",
            help="A second file with the same meshes: another bake, or another program's cache.",
        ),
    ],
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help="Write a page (.html), a film (.mp4, .gif) of A, B and their distance, or an "
            "image of the worst frame (.png); repeatable.",
        ),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Largest distance at which A and B count as equal: 2mm, 1cm, 0.01m, or 0.5% of"
            " the radius of a sphere of A's volume.",
            show_default="only report the distances; exit status 0",
        ),
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Variant of A.", show_default="the selected one"),
    ] = None,
    other_variant: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Variant of B.", show_default="the selected one"),
    ] = None,
    align: Annotated[
        str,
        typer.Option(
            metavar="time|start",
            help="Compare at equal times of the two stages, or from the first frame of each.",
        ),
    ] = "time",
    size: Annotated[
        str | None,
        typer.Option(
            metavar="WxH",
            help="Width and height of each of the three parts of a picture or film [pixels].",
            show_default="480x360; 360x270 for films",
        ),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(help="Frames per second of the film.", show_default="real time"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
    quiet: QuietExceptJson = False,
) -> None:
    """Compare two motions of the same meshes, point by point over time.

    Meshes are paired by prim path, else by name.  With --tolerance, the exit status is 1 if any
    point is ever farther apart, and 0 otherwise.
    """
    # pxr takes a second to import, which --help must not wait for
    from gf_usd.api.drawing.compare import FILMS, run
    from gf_usd.cli.preview import progress

    targets = output or []
    film = any(target.suffix.lower() in FILMS for target in targets)
    with progress() if film and not quiet else nullcontext() as advance:
        found = run(
            first, second, targets, tolerance=tolerance, variants=(variant, other_variant),
            align=align, size=size, fps=fps, progress=advance,
        )  # fmt: skip
    if not quiet:
        for note in found.notes:
            typer.echo(f"note: {note}", err=True)
    if as_json:
        typer.echo(json.dumps(as_data(found, first, second), indent=1))
    elif not quiet:
        for line in lines(found):
            typer.echo(line)
        for target in targets:
            typer.echo(f"{target}: {bytes_text(target.stat().st_size)}", err=True)
    if tolerance is not None and not found.same:
        raise typer.Exit(1)


def lines(found: Comparison) -> list[str]:
    """The results of a comparison as text."""
    worst, (mesh, point) = found.worst_frame, found.worst
    center = int(found.center.argmax())
    ratio = found.volumes[:, 1] / found.volumes[:, 0] if found.volumes.all() else None
    rows = [
        f"{counted(len(found.meshes), 'mesh', 'meshes')}, {counted(found.points, 'point')},"
        f" {counted(len(found.time_codes), 'frame')}; radius {length(found.radius)}",
        f"largest distance {length(found.error)} ({100 * found.error / found.radius:.3g} % of the"
        f" radius): point {point} of <{mesh}> at time code {code_text(found.time_codes[worst])}",
        f"largest rms distance {length(float(found.rms.max()))}, largest distance of the "
        f"centers of mass {length(float(found.center[center]))} (time code "
        f"{code_text(found.time_codes[center])})",
    ]
    if ratio is not None:
        rows.append(f"volume of B relative to A: {ratio.min():.4g} to {ratio.max():.4g}")
    if found.tolerance is not None:
        over = found.first_over
        rows.append(
            f"same: within {length(found.tolerance)} at all times"
            if over is None
            else f"different: distance above {length(found.tolerance)} from time code"
            f" {code_text(over)} on"
        )
    return rows


def length(meters: float) -> str:
    """A length in a unit that suits it."""
    for factor, unit in ((1.0, "m"), (1e-2, "cm"), (1e-3, "mm")):
        if meters >= factor:
            return f"{meters / factor:.3g} {unit}"
    return f"{meters / 1e-6:.3g} µm" if meters else "0"


def as_data(found: Comparison, first: Path, second: Path) -> dict[str, Any]:
    """The comparison for --json; lengths are meters."""
    return {
        "a": str(first),
        "b": str(second),
        "same": found.same,
        "tolerance": found.tolerance,
        "first_over": found.first_over,
        "largest": found.error,
        "worst": {
            "mesh": found.worst[0],
            "point": found.worst[1],
            "time_code": float(found.time_codes[found.worst_frame]),
        },
        "radius": found.radius,
        "points": found.points,
        "meshes": [{"a": a, "b": b} for a, b in found.meshes],
        "per_frame": [
            {
                "time_code": float(found.time_codes[i]),
                "largest": float(found.largest[i]),
                "rms": float(found.rms[i]),
                "center": float(found.center[i]),
                "volumes": found.volumes[i].tolist(),
            }
            for i in range(len(found.time_codes))
        ],
        "notes": list(found.notes),
    }
