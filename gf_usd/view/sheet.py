"""A contact sheet: many frames of one motion on one page."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]

PAPER = (250, 250, 249)
GUTTER = 1 / 60  # of a tile's height


def columns_for(count: int, aspect: float) -> int:
    """Columns that make a sheet of `count` tiles of this width / height about 3:2 wide.

    Among those near that shape the one that leaves the fewest places empty wins.
    """
    ideal = math.sqrt(1.5 * count / aspect)
    near = range(max(1, math.floor(0.75 * ideal)), min(count, math.ceil(1.35 * ideal)) + 1)
    return min(near, key=lambda n: (-count % n, abs(n - ideal), -n), default=count)


def contact_sheet(tiles: Sequence[Pixels], columns: int) -> Pixels:
    """Tiles (H, W, 3) of one size row by row, with gutters between and around them."""
    height, width, _ = tiles[0].shape
    gap = max(2, round(GUTTER * height))
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    page = np.empty((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), dtype=np.uint8)
    page[:] = PAPER
    for i, tile in enumerate(tiles):
        y = gap + (i // columns) * (height + gap)
        x = gap + (i % columns) * (width + gap)
        page[y : y + height, x : x + width] = tile
    return page
