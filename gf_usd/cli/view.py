"""gf-usd view: a bake in a window."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def view(
    baked: Annotated[Path, typer.Argument(help="Root layer of a bake, or any moving USD file.")],
    look: Annotated[
        str | None,
        typer.Option(help="Variant to show.", show_default="the one selected in the file"),
    ] = None,
) -> None:
    """Play the motion in a window, in real time and over and over.

    Space plays and pauses, the arrow keys step, G changes between mesh and Gaussians, R resets, Q
    quits. It needs the extra open3d: pip install 'gf-usd[open3d]'.
    """
    # what is missing is said before the file is read, which takes a second
    from gf_usd.view.window_needs import import_open3d, require_display

    import_open3d()
    require_display()
    from gf_usd.assets.usd_motion_read import BakedMotion
    from gf_usd.view.window import Window

    source = BakedMotion(baked, look)
    for note in source.recording().notes:
        typer.echo(f"note: {note}", err=True)
    Window(source).run()
