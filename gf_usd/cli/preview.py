"""gf-usd preview: one frame of a stage as a picture."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from gf_usd.errors import UsageError


def preview(
    stage: Annotated[Path, typer.Argument(help="USD file: a bake, or any other stage.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="PNG file.", show_default="NAME.png in this folder"),
    ] = None,
    frame: Annotated[
        float | None,
        typer.Option(help="Time code to draw.", show_default="the first of the stage"),
    ] = None,
    show: Annotated[
        str | None,
        typer.Option(
            help="mesh, gaussians, ellipsoids (one standard deviation), points, or both (mesh and "
            "gaussians).",
            show_default="the first of mesh, gaussians, points that is there",
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Width x height in pixels.")] = "960x720",
) -> None:
    """Draw one frame, on the CPU and without a window; the camera is fitted to the whole motion."""
    width, height = parse_size(size)
    target = output or Path(f"{stage.stem}.png")
    if target.suffix.lower() != ".png":
        raise UsageError(f"{target} does not end in .png.", "preview writes PNG files: -o out.png")
    draw(stage, target, frame, show, (width, height))
    typer.echo(f"{target}: {width}x{height}", err=True)


def parse_size(text: str) -> tuple[int, int]:
    """ "640x480" -> (640, 480).

    Raises UsageError for anything else; the renderer holds the limits.
    """
    match = re.fullmatch(r"\s*(\d{1,6})\s*[xX×]\s*(\d{1,6})\s*", text)
    if match is None or 0 in (int(match[1]), int(match[2])):
        raise UsageError(
            f"--size {text} is not a size.", "give width x height, e.g. --size 640x480"
        )
    return int(match[1]), int(match[2])


def draw(
    path: Path, target: Path, frame: float | None, show: str | None, size: tuple[int, int]
) -> None:
    """Draw a stage at a time code into a PNG file, and say on stderr what was assumed.

    Raises
    ------
    UsageError : a frame outside the motion, an impossible size, or a folder that cannot be written.
    InputError : the stage cannot be read, or holds nothing to show.
    """
    # pxr and taichi take a second to import, which --help must not wait for
    from gf_usd.assets.usd_picture import PictureStage
    from gf_usd.view.camera import fit_camera
    from gf_usd.view.image import write_png
    from gf_usd.view.render import render

    source = PictureStage(path, show)
    motion = source.motion
    times = motion.time_codes
    if frame is not None and times and not times[0] <= frame <= times[-1]:
        raise UsageError(
            f"--frame {frame:g} is outside the motion of {path}.",
            f"its time codes run from {times[0]:g} to {times[-1]:g}",
        )
    scene = source.scene(frame)
    camera = None
    if motion.bounds is not None:
        camera = fit_camera(motion.bounds.corners, motion.up, size[0] / size[1])
    write_png(target, render(scene, camera, size))
    for note in scene.notes:
        typer.echo(f"note: {note}", err=True)
