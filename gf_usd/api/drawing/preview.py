"""`gf_usd.preview`: renders a stage as an image, a contact sheet or a film."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from gf_usd.api.call import asset_path, keywords
from gf_usd.api.drawing.options import Options, joined, read_options, time_codes
from gf_usd.api.host.guest import run_here_or_separately
from gf_usd.core.errors import UsageError
from gf_usd.prepare.options import values

T = TypeVar("T")
# (first, last) or (first, last, step)
TimeCodes = (
    tuple[float | None, float | None] | tuple[float | None, float | None, float] | str | None
)
Show = Literal["mesh", "splats", "gaussians", "ellipsoids", "points", "both"]
SHOWN = ("mesh", "splats", "gaussians", "ellipsoids", "points", "both")
COLORS = ("strain", "elastic", "plastic", "stress")
UNWRITTEN = Path("picture.png")  # stands for a target where there is none


@dataclass(frozen=True, kw_only=True)
class Preview:
    """The rendered result.  Notebooks display images automatically."""

    path: Path | None  # the file; None: none was requested
    pixels: NDArray[np.uint8] | None  # (H, W, 3) sRGB of a picture or a sheet; None: a film
    size: tuple[int, int]  # (width, height) [pixels]
    frames: int = 1  # of a film
    fps: float | None = None  # of a film
    notes: tuple[str, ...] = ()  # assumptions, as text

    def _repr_png_(self) -> bytes | None:
        if self.pixels is None:
            return None
        from PIL import Image

        file = io.BytesIO()
        Image.fromarray(self.pixels).save(file, format="PNG")
        return file.getvalue()


def preview(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    frame: float | None = None,
    time_codes: TimeCodes = None,
    show: Show | None = None,
    size: tuple[int, int] | str | None = None,
    sheet: int | None = None,
    columns: int | None = None,
    fps: float | None = None,
    camera: str | None = None,
    variant: str | None = None,
    color: Literal["none", "strain", "elastic", "plastic", "stress"] | None = None,
    color_range: tuple[float, float] | str | None = None,
    progress: Callable[[int, int], None] | None = None,
    frames: TimeCodes = None,
    range: tuple[float, float] | str | None = None,
) -> Preview:
    """Render a stage on the CPU, without a window.

    >>> gf_usd.preview(result.root, size=(160, 120)).pixels.shape
    (120, 160, 3)

    Parameters
    ----------
    path : a bake, or any other USD stage.
    output : image (.png) or film (.mp4, .gif); an existing file is replaced.  None: the image is
        returned and nothing is written.
    frame : time code of a single image; None: the first of the stage.
    time_codes : (first, last) or (first, last, step), time codes of a film or a sheet, including
        the last; None for an open end.  Or a string: "1:24:2".  None: the whole motion.
    show : mesh, splats (captured Gaussians), gaussians, ellipsoids (one standard deviation), points
        or both (mesh and gaussians); None: the first of mesh, splats, gaussians, points that
        exists.
    size : (width, height) [pixels], or "640x480"; of one tile for a sheet.
    sheet : number of frames of a contact sheet, spaced by the amount of motion, or evenly over
        `time_codes`; columns : of the sheet.
    fps : frames per second of the film; None: real time.
    camera : path of a camera in the stage; None: a camera fitted to the whole motion.
    variant : of a bake: one of its materials, or "none" for the asset itself; None: the one
        selected in the file.
    color : strain (largest |stretch - 1|), elastic or plastic (its parts, of a bake with internal),
        or stress (von Mises, of a bake with stress); None or none: the asset's own colors.
    color_range : (low, high) values of the first and the last color, dimensionless for strains,
        [Pa] for stress; or a string: "0:0.5".
    progress : called after each frame of a film with (frames done, total frames).
    frames, range : former names of `time_codes` and `color_range`, which work until 1.0.

    Returns
    -------
    Preview : the file, or the pixels.

    Raises
    ------
    UsageError : times outside the motion, an impossible size, or a folder that cannot be written.
    InputError : the stage cannot be read, or does not contain what should be shown.
    """
    with keywords(
        "frame", "show", "size", "sheet", "columns", "fps", "camera", "variant", "color",
        "time_codes", "color_range",
    ) as names:  # fmt: skip
        codes = _renamed("frames", frames, "time_codes", time_codes)
        limits = _renamed("range", range, "color_range", color_range)
        target = None if output is None else Path(values.path("output", output))
        for name, value in (("frame", frame), ("fps", fps)):
            if value is not None:
                values.real(name, value)
        for name, value in (("sheet", sheet), ("columns", columns)):
            if value is not None:
                values.whole(name, value)
        if show is not None and show not in SHOWN:
            raise UsageError(f"show is {show!r}", f"give one of {', '.join(SHOWN)}")
        color = None if color == "none" else color
        if color not in (None, *COLORS):
            raise UsageError(
                f"color is {color!r}", f"give {', '.join(map(repr, COLORS))}, or leave it out"
            )
        if camera is not None:
            camera = values.prim("camera", camera, "the path of a camera, such as '/World/Camera'")
        values.variant("variant", variant)
        options = read_options(
            target or UNWRITTEN,
            size=None if size is None else joined("size", size, "x", (2,)),
            frame=frame,
            frames=None if codes is None else joined("time_codes", codes, ":", (2, 3)),
            sheet=sheet,
            columns=columns,
            fps=fps,
            color=color,
            limits=None if limits is None else joined("color_range", limits, ":", (2,)),
        )
        arguments = {
            "path": asset_path(path), "options": options, "show": show, "camera": camera,
            "color": color, "variant": variant, "write": target is not None,
        }  # fmt: skip
        task = "gf_usd.api.drawing.preview:draw"
        progress = values.progress_callback("progress", progress)
        drawn, _ = run_here_or_separately(task, arguments, progress, schema=False)
        return names.in_notes(drawn)


def _renamed(former: str, old: T | None, name: str, new: T | None) -> T | None:
    """The value of a keyword that may have been given by its former name."""
    if old is None:
        return new
    if new is not None:
        raise UsageError(f"{name} and {former} mean the same", f"leave {former} out")
    message = f"{former} is now called {name}; the old name works until 1.0"
    warnings.warn(message, FutureWarning, stacklevel=3)  # the line that calls `preview`
    return old


def draw(
    path: Path,
    options: Options,
    *,
    show: str | None = None,
    camera: str | None = None,
    color: str | None = None,
    variant: str | None = None,
    write: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Preview:
    """Draw the requested pictures; see `preview`.

    variant : of a bake, instead of the one that the file selects.
    write : write the file of the options; False: a picture or a sheet is only returned.
    """
    from gf_usd.api.drawing import pictures as drawing
    from gf_usd.readers.pictures.scene import PictureStage
    from gf_usd.view.film import require_folder
    from gf_usd.view.render.image import write_png

    if write:
        require_folder(options.target)
    notes: list[str] = []
    if options.target.suffix.lower() == ".mp4" and (options.size[0] % 2 or options.size[1] % 2):
        width, height = (n + n % 2 for n in options.size)
        options = replace(options, size=(width, height))
        notes.append(f"H.264 needs an even width and height: {width}x{height} is used")
    source = PictureStage(path, show, camera=camera, color=color, variant=variant)
    motion = source.motion
    if options.film:
        codes = _time_codes(source, options, path)
        paint = drawing.Drawing(source, options.size, options.limits)
        rate = drawing.film_rate(codes, motion.time_codes_per_second, options)
        if options.target.suffix.lower() == ".gif":
            total = len(codes)
            codes, rate = drawing.thin_for_gif(codes, rate)
            if len(codes) < total:
                notes.append(f"a GIF has at most 50 frames per second: {rate:g} are kept")
        drawing.write_film(paint, codes, rate, options, progress or (lambda done, total: None))
        return Preview(
            path=options.target, pixels=None, size=options.size, frames=len(codes), fps=rate,
            notes=(*notes, *paint.notes),
        )  # fmt: skip
    if options.sheet is not None:
        codes = _time_codes(source, options, path)
        paint = drawing.Drawing(source, options.size, options.limits)
        pixels = drawing.write_sheet(paint, codes, options)
    else:
        source.require_time(options.frame)
        paint = drawing.Drawing(source, options.size, options.limits)
        pixels = paint(options.frame)
    if write:
        write_png(options.target, pixels)
    return Preview(
        path=options.target if write else None, pixels=pixels,
        size=(pixels.shape[1], pixels.shape[0]), notes=(*notes, *paint.notes),
    )  # fmt: skip


def _time_codes(source: Any, options: Options, path: Path) -> list[float]:
    motion = source.motion
    step = motion.time_codes_per_second / motion.frames_per_second
    return time_codes(options.span, motion.time_codes, step, path)
