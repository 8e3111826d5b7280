"""gf-usd report: writes an HTML page of a bake.

gf-usd view: plays a bake in a window.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gf_usd.api.report import default_page, write, write_splats
from gf_usd.cli.quiet import Quiet
from gf_usd.core.units import bytes_text


def report(
    baked: Annotated[
        Path, typer.Argument(metavar="BAKE", help="Root layer of a bake, or any animated USD file.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Write this HTML file.",
            show_default="NAME.html in this folder, NAME.splats.html with --splats",
        ),
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(
            "--variant",
            metavar="NAME",
            help="Show only this variant.",
            show_default="all, with a switch between them",
        ),
    ] = None,
    max_vertices: Annotated[
        int,
        typer.Option(min=100, help="Maximum number of mesh vertices to keep, and of Gaussians."),
    ] = 20_000,
    max_frames: Annotated[int, typer.Option(min=2, help="Maximum number of frames to keep.")] = 240,
    splats: Annotated[
        bool,
        typer.Option(
            "--splats",
            help="Write a page that plays Gaussian splats instead: the captured Gaussians, or"
            " those of the bake.",
        ),
    ] = False,
    max_splats: Annotated[
        int, typer.Option(min=100, help="With --splats: maximum number of Gaussians to keep.")
    ] = 100_000,
    quiet: Quiet = False,
) -> None:
    """Write an HTML page with the motion, pictures and measurements, for viewing offline.

    The page is smaller than 20 MB, and lists what was omitted to keep it small.
    """
    target = output or default_page(baked, splats)
    if splats:
        write_splats(baked, target, variant, max_splats, max_frames)
    else:
        write(baked, target, variant, max_vertices, max_frames)
    if not quiet:
        typer.echo(f"{target}: {bytes_text(target.stat().st_size)}", err=True)


def view(
    baked: Annotated[
        Path, typer.Argument(metavar="BAKE", help="Root layer of a bake, or any animated USD file.")
    ],
    variant: Annotated[
        str | None,
        typer.Option(
            "--variant",
            metavar="NAME",
            help="Show this variant.",
            show_default="the one selected in the file",
        ),
    ] = None,
) -> None:
    """Play the motion in a window, in real time and in a loop.

    Space plays and pauses, the arrow keys step, G switches between mesh and Gaussians, R resets, Q
    quits. It needs the extra open3d: pip install open3d.
    """
    # requirements are checked before the file is read, which takes a second
    from gf_usd.view.window.requirements import import_open3d, require_display

    import_open3d()
    require_display()
    from gf_usd.readers.pictures.recording import BakedMotion
    from gf_usd.view.window.window import Window

    source = BakedMotion(baked, variant)
    for note in source.recording().notes:
        typer.echo(f"note: {note}", err=True)
    Window(source).run()
