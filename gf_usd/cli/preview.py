"""gf-usd preview: a stage as a picture, a contact sheet or a film.

gf-usd thumbnails: a small picture of each of many bakes, for the page of a batch.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

import typer

from gf_usd.api.drawing.options import Options, read_options
from gf_usd.cli.quiet import Quiet
from gf_usd.core.errors import GfUsdError, counted


def preview(
    stage: Annotated[Path, typer.Argument(help="USD file: a bake, or any other stage.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Picture (.png) or film (.mp4, .gif) to write; an existing file is replaced.",
            show_default="NAME.png in this folder",
        ),
    ] = None,
    frame: Annotated[
        float | None,
        typer.Option(
            help="Draw a single picture at this time code.",
            show_default="the first time code of the stage",
        ),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(
            "--time-codes",
            metavar="A:B[:STEP]",
            help="Draw a film or a sheet of these time codes, including B; either end may be"
            " omitted.",
            show_default="the whole motion, each frame of playback",
        ),
    ] = None,
    show: Annotated[
        str | None,
        typer.Option(
            metavar="mesh|splats|gaussians|ellipsoids|points|both",
            help="What to draw: splats are captured Gaussians, ellipsoids are Gaussians at one"
            " standard deviation, both are mesh and gaussians.",
            show_default="the first of mesh, splats, gaussians, points that exists",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="WxH",
            help="Width and height of the picture [pixels], or of one tile of a sheet.",
            show_default="960x720; 480x360 for a gif, 320x240 for a tile",
        ),
    ] = None,
    sheet: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Draw a contact sheet of N frames as PNG: spaced by the amount of motion, or"
            " evenly over --time-codes.",
        ),
    ] = None,
    columns: Annotated[
        int | None,
        typer.Option(help="Number of columns of the sheet.", show_default="about 3:2 overall"),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Frames per second of the film; a lower rate plays the same frames slower.",
            show_default="real time",
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="PRIM",
            help="Use this camera of the stage, which may be animated.",
            show_default="fitted to the whole motion",
        ),
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Draw this variant of a bake: one of its materials, or none for the asset itself.",
            show_default="the one selected in the file",
        ),
    ] = None,
    color: Annotated[
        str,
        typer.Option(
            "--color",
            metavar="none|strain|elastic|plastic|stress",
            help="Color by the largest |stretch - 1| (strain), its elastic or plastic part (of a"
            " bake with --internal) or the von Mises stress (of a bake with --stress); none"
            " keeps the asset's own colors.",
        ),
    ] = "none",
    limits: Annotated[
        str | None,
        typer.Option(
            "--color-range",
            metavar="LOW:HIGH",
            help="Values of the first and the last color: dimensionless for strains, [Pa] for"
            " stress.",
            show_default="from 0 to the value that 99 % of the particles stay below in every frame",
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Draw a picture, a contact sheet or a film of a stage, on the CPU and without a window."""
    quantity = None if color == "none" else color
    options = read_options(
        output or Path(f"{stage.stem}.png"),
        size=size,
        frame=frame,
        frames=frames,
        sheet=sheet,
        columns=columns,
        fps=fps,
        color=quantity,
        limits=limits,
    )
    lines = draw(stage, options, show, camera, quantity, variant, shown=not quiet)
    for line in () if quiet else lines:
        typer.echo(line, err=True)


def draw(
    path: Path,
    options: Options,
    show: str | None,
    camera: str | None,
    color: str | None,
    variant: str | None = None,
    *,
    shown: bool = True,
) -> list[str]:
    """Draw the requested pictures; returns the messages about them.

    shown : print the progress of a film.

    Raises
    ------
    UsageError : times outside the motion, an impossible size, or a folder that cannot be written.
    InputError : the stage cannot be read, or does not contain what should be shown.
    """
    # pxr and taichi take a second to import, which --help must not wait for
    from gf_usd.api.drawing.preview import draw as draw_preview

    with progress() if options.film and shown else nullcontext() as advance:
        done = draw_preview(
            path,
            options,
            show=show,
            camera=camera,
            color=color,
            variant=variant,
            progress=advance,
        )
    width, height = done.size
    made = f"{done.path}: {width}x{height}"
    if done.fps is not None:
        made += f", {counted(done.frames, 'frame')}, {done.fps:g} per second"
    return [made, *(f"note: {note}" for note in done.notes)]


@contextmanager
def progress() -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal, elsewhere a line after each tenth of the frames; both on stderr."""
    if not sys.stderr.isatty():

        def plain(done: int, total: int) -> None:
            if done % max(1, total // 10) == 0 or done == total:
                typer.echo(f"frame {done}/{total}", err=True)

        yield plain
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Left

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Left())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("drawing", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


SIZE = (192, 144)


def thumbnails(
    roots: Annotated[list[Path], typer.Argument(help="Root layers of bakes.")],
) -> None:
    """Draw the middle frame of each as NAME.png next to it; print a line of JSON for each."""
    for root in roots:
        try:
            target = thumbnail(root)
        except GfUsdError as error:
            row = {"root": str(root), "error": error.message}
        else:
            row = {"root": str(root), "picture": str(target)}
        typer.echo(json.dumps(row))


def thumbnail(root: Path) -> Path:
    """The picture of one stage.  Raises InputError for what cannot be drawn."""
    from gf_usd.api.drawing.pictures import Drawing
    from gf_usd.readers.pictures.scene import PictureStage
    from gf_usd.view.render.image import write_png

    source = PictureStage(root, None)
    codes = source.motion.time_codes
    target = root.with_suffix(".png")
    write_png(target, Drawing(source, SIZE)(codes[len(codes) // 2] if codes else None))
    return target
