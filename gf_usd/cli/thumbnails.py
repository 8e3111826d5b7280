"""gf-usd thumbnails: a small picture of each of many bakes, for the page of a batch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from gf_usd.errors import GfUsdError

SIZE = (192, 144)


def thumbnails(
    roots: Annotated[list[Path], typer.Argument(help="Root layers of bakes.")],
) -> None:
    """Draw the middle frame of each as NAME.png beside it; print a line of JSON for each."""
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
    from gf_usd.assets.usd_picture import PictureStage
    from gf_usd.cli.preview_draw import Drawing
    from gf_usd.view.image import write_png

    source = PictureStage(root, None)
    codes = source.motion.time_codes
    target = root.with_suffix(".png")
    write_png(target, Drawing(source, SIZE)(codes[len(codes) // 2] if codes else None))
    return target
