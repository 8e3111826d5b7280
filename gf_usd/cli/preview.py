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
from gf_usd.core.errors import GfUsdError


def preview(
    stage: Annotated[Path, typer.Argument(help="USD file: a bake, or any other stage.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Picture (.png) or film (.mp4, .gif); a file of that name is replaced.",
            show_default="NAME.png in this folder",
        ),
    ] = None,
    frame: Annotated[
        float | None,
        typer.Option(help="Time code of a single picture.", show_default="the first of the stage"),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B[:STEP]",
            help="Time codes of a film or a sheet, B included; either end may be left out.",
            show_default="the whole motion, each frame of playback",
        ),
    ] = None,
    show: Annotated[
        str | None,
        typer.Option(
            help="mesh, splats (captured Gaussians), gaussians, ellipsoids (one standard"
            " deviation), points, or both (mesh and gaussians).",
            show_default="the first of mesh, splats, gaussians, points that is there",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="WxH",
            help="Pixels; of one tile for --sheet.",
            show_default="960x720; 480x360 for a gif, 320x240 for a tile",
        ),
    ] = None,
    sheet: Annotated[
        int | None,
        typer.Option(metavar="N", help="A contact sheet of N frames, evenly spread, as PNG."),
    ] = None,
    columns: Annotated[
        int | None, typer.Option(help="Of the sheet.", show_default="about 3:2 overall")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Frames per second of the film; fewer play it slower.", show_default="real time"
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="PRIM",
            help="Path of a camera in the stage, which may move.",
            show_default="one that is fitted to the whole motion",
        ),
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Variant of a bake to draw: one of its materials, or none (the asset itself).",
            show_default="the one that the file selects",
        ),
    ] = None,
    color: Annotated[
        str,
        typer.Option(
            help="strain (largest |stretch - 1|), elastic and plastic (bake with --internal),"
            " stress (von Mises; bake with --stress), or none: the asset's own colors."
        ),
    ] = "none",
    old_color: Annotated[str | None, typer.Option("--colour", hidden=True)] = None,
    limits: Annotated[
        str | None,
        typer.Option(
            "--range",
            metavar="LOW:HIGH",
            help="Of the colors: a pure number for strains, [Pa] for stress.",
            show_default="0 to what 99 % of the particles stay below in every frame",
        ),
    ] = None,
) -> None:
    """Draw a stage on the CPU and without a window: one frame, a contact sheet, or a film."""
    if old_color is not None:  # until 1.0
        typer.echo("note: --colour is now --color", err=True)
        color = old_color
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
    for line in draw(stage, options, show, camera, quantity, variant):
        typer.echo(line, err=True)


def draw(
    path: Path,
    options: Options,
    show: str | None,
    camera: str | None,
    color: str | None,
    variant: str | None = None,
) -> list[str]:
    """Draw what was asked for; returns what to say of it.

    Raises
    ------
    UsageError : times outside the motion, an impossible size, or a folder that cannot be written.
    InputError : the stage cannot be read, or does not hold what is to be shown.
    """
    # pxr and taichi take a second to import, which --help must not wait for
    from gf_usd.api.drawing.preview import draw as draw_preview

    with progress() if options.film else nullcontext() as advance:
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
        made += f", {done.frames} frames, {done.fps:g} a second"
    return [made, *(f"note: {note}" for note in done.notes)]


@contextmanager
def progress() -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal, a plain line every tenth of the way elsewhere; both on stderr."""
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
    from gf_usd.view.render.render import write_png

    source = PictureStage(root, None)
    codes = source.motion.time_codes
    target = root.with_suffix(".png")
    write_png(target, Drawing(source, SIZE)(codes[len(codes) // 2] if codes else None))
    return target
