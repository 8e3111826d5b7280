"""Contact sheets: frames of one motion as tiles of one picture, and the choice of these frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.view.report.thinning import evenly_spaced

Pixels = NDArray[np.uint8]

BACKGROUND = (250, 250, 249)
GUTTER = 1 / 60  # gap between tiles, as a fraction of their height


def sheet_columns(count: int, aspect: float) -> int:
    """Columns of a sheet of `count` tiles of this width / height, for an aspect ratio near 3:2.

    Of the numbers near the ideal, the one with the fewest empty places.
    """
    ideal = math.sqrt(1.5 * count / aspect)
    candidates = range(max(1, math.floor(0.75 * ideal)), min(count, math.ceil(1.35 * ideal)) + 1)
    return min(candidates, key=lambda n: (-count % n, abs(n - ideal), -n), default=count)


MIN_SPEED_SHARE = (
    0.1  # of the mean speed, added to all speeds: frames of a body at rest are chosen too
)


def choose_frames(frames: int, count: int, speeds: Floats | None = None) -> list[int]:
    """Indices of `count` frames, at most all, including the first and the last.

    speeds : (frames,) of any unit.  Chosen frames are evenly spaced along the path, the integral of
    speed + MIN_SPEED_SHARE times the mean speed.  None: they are evenly spaced in time.
    """
    if speeds is None or speeds.max(initial=0.0) == 0.0:
        return evenly_spaced(frames, count).tolist()
    count = min(count, frames)
    distances = 0.5 * (speeds[1:] + speeds[:-1]) + MIN_SPEED_SHARE * speeds.mean()
    path_length = np.concatenate([[0.0], np.cumsum(distances)])
    targets = np.linspace(0.0, path_length[-1], count)
    chosen = np.round(np.interp(targets, path_length, np.arange(frames))).astype(int)
    order = np.arange(count)
    chosen = np.maximum.accumulate(chosen - order) + order  # no frame twice
    return list(map(int, np.minimum(chosen, frames - count + order)))


def contact_sheet(tiles: Sequence[Pixels], columns: int) -> Pixels:
    """One picture of tiles (H, W, 3) of equal size, row by row, with gaps between and around."""
    height, width, _ = tiles[0].shape
    gap = max(2, round(GUTTER * height))
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    page = np.empty((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), dtype=np.uint8)
    page[:] = BACKGROUND
    for i, tile in enumerate(tiles):
        y = gap + (i // columns) * (height + gap)
        x = gap + (i % columns) * (width + gap)
        page[y : y + height, x : x + width] = tile
    return page
