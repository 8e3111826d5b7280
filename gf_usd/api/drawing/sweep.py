"""The contact sheet of a sweep: a row of images for each variant of a bake."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gf_usd.api.drawing.pictures import Drawing
from gf_usd.core.units import code_text
from gf_usd.pipeline.result import BakeResult
from gf_usd.readers.pictures.scene import PictureStage
from gf_usd.view.contact_sheet import choose_frames, contact_sheet
from gf_usd.view.legend import caption
from gf_usd.view.render.camera import fit_camera
from gf_usd.view.render.image import write_png

TILE = (320, 240)  # pixels
COLUMNS = 6


def draw_sweep(result: BakeResult, target: Path) -> None:
    """Write the sheet: all variants at the same times, seen by the same camera."""
    sources = [PictureStage(result.root, None, variant=bake.variant) for bake in result.bakes]
    motion = sources[0].motion
    framed = np.concatenate([one.motion.framed for one in sources])
    camera = None
    if len(framed):
        camera = fit_camera(framed, motion.up, TILE[0] / TILE[1])
    known = motion.time_codes
    rates = [rate for one in sources if (rate := one.speeds(known)) is not None and rate.any()]
    speeds = np.sum([rate / rate.max() for rate in rates], axis=0) if rates else None
    codes = [known[i] for i in choose_frames(len(known), COLUMNS, speeds)]
    tiles = []
    for bake, source in zip(result.bakes, sources):
        draw = Drawing(source, TILE, fitted=camera)
        texts = [bake.variant, *(f"time code {code_text(code)}" for code in codes[1:])]
        tiles += [caption(draw(code), text) for code, text in zip(codes, texts)]
    write_png(target, contact_sheet(tiles, len(codes)))
