"""`gf_usd.report`: a bake as a single page for a browser."""

from __future__ import annotations

import os
from pathlib import Path

from gf_usd.api.call import asset_path, keywords
from gf_usd.api.host.guest import run_here_or_separately
from gf_usd.core.errors import UsageError
from gf_usd.prepare.options import values

MOST_VERTICES = 20_000
MOST_FRAMES = 240
MOST_SPLATS = 100_000


def report(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    variant: str | None = None,
    max_vertices: int = MOST_VERTICES,
    max_frames: int = MOST_FRAMES,
    splats: bool = False,
    max_splats: int = MOST_SPLATS,
) -> Path:
    """Write an offline page that plays the motion in a browser and shows the measurements.

    >>> gf_usd.report(result.root, "page.html").name
    'page.html'

    Parameters
    ----------
    path : root layer of a bake, or any moving USD file.
    output : the HTML file; None: NAME.html in the current folder, NAME.splats.html with `splats`.
    variant : show only this variant; None: all, with a switch between them.
    max_vertices : maximum number of mesh vertices to keep, and of Gaussians.
    max_frames : maximum number of frames to keep.
    splats : write a page that plays Gaussians as sorted and blended splats instead of the report:
        the captured ones or, if there are none, those of the bake.
    max_splats : maximum number of Gaussians to keep on such a page; fewer if it would exceed 20 MB.

    Returns
    -------
    Path : the page.

    Raises
    ------
    UsageError : no such variant, the page is an input, or its folder does not exist.
    InputError : the file cannot be read, nothing in it moves, or it contains no Gaussians.
    BakeError : a file cannot be written.
    """
    with keywords("max_vertices", "max_frames", "max_splats", "variant"):
        source = asset_path(path)
        splats = values.switch("splats", splats)
        variant = values.variant("variant", variant)
        target = (
            default_page(source, splats) if output is None else Path(values.path("output", output))
        )
        vertices = values.whole("max_vertices", max_vertices)
        frames = values.whole("max_frames", max_frames)
        most = values.whole("max_splats", max_splats)
        limits = (("vertices", vertices, 100), ("frames", frames, 2), ("splats", most, 100))
        for name, count, least in limits:
            if count < least:
                raise UsageError(f"max_{name} is {count}", f"give {least} or more")
        if splats:
            arguments = {
                "path": source, "target": target, "variant": variant, "splats": most,
                "frames": frames,
            }  # fmt: skip
            run_here_or_separately("gf_usd.api.report:write_splats", arguments, schema=False)
            return target
        arguments = {
            "path": source, "target": target, "variant": variant, "vertices": vertices,
            "frames": frames,
        }  # fmt: skip
        run_here_or_separately("gf_usd.api.report:write", arguments, schema=False)
        return target


def write(path: Path, target: Path, variant: str | None, vertices: int, frames: int) -> None:
    """Write the page of a bake, all its variants or one; see `report`."""
    # pxr and taichi take a second to import, which --help must not wait for
    from gf_usd.readers.pictures.obstacles import Read
    from gf_usd.readers.pictures.recording import BakedMotion
    from gf_usd.system.atomic_files import publish_text
    from gf_usd.view.report.record import load_report, report_path
    from gf_usd.view.report.report import Limits, build_report

    require_target(target, (path, report_path(path)))
    obstacles: Read = {}  # read once for all variants
    first = BakedMotion(path, variant, displayed=True, obstacles=obstacles)
    # the variant that is selected in the file comes first
    names = [first.variant]
    if variant is None:
        names += [name for name in first.variants if name != first.variant]
    others = (BakedMotion(path, name, displayed=True, obstacles=obstacles) for name in names[1:])
    sources = [first, *others]
    page = build_report(sources, *load_report(path), Limits(frames=frames, vertices=vertices))
    publish_text(target, page)


def default_page(source: Path, splats: bool) -> Path:
    """The page where none is named, in the current folder."""
    return Path(f"{source.stem}.splats.html" if splats else f"{source.stem}.html")


def write_splats(path: Path, target: Path, variant: str | None, splats: int, frames: int) -> None:
    """Write the page of the Gaussians of a bake; see `report`."""
    from gf_usd.readers.pictures.splats import SplatMotion
    from gf_usd.system.atomic_files import publish_text
    from gf_usd.view.report.record import report_path
    from gf_usd.view.report.splats import Limits, build_splat_page

    require_target(target, (path, report_path(path)))
    first = SplatMotion(path, variant)
    captured = bool(first)
    names = [first.variant]
    if variant is None:
        names += [name for name in first.variants if name != first.variant]
    sources = [
        SplatMotion(path, name or None, captured=captured, particles=not captured) for name in names
    ]
    page = build_splat_page(sources, Limits(frames=frames, splats=splats))
    publish_text(target, page)


def require_target(target: Path, inputs: tuple[Path, ...]) -> None:
    """Raise UsageError where a page cannot be written, or would replace one of its inputs."""
    from gf_usd.system.atomic_files import same_place

    if target.suffix.lower() not in (".html", ".htm"):
        raise UsageError(
            f"{target} does not end in .html", "report writes a web page: -o report.html"
        )
    for source in inputs:
        if same_place(target, source):
            raise UsageError(f"{target} is the input itself", "choose another -o")
    if not target.parent.is_dir():
        raise UsageError(f"{target.parent} is not a folder", "choose a folder that exists, with -o")
    if target.is_dir():
        raise UsageError(f"{target} is a folder", "name the page: -o report.html")
