"""Which captured Gaussians a picture has to hold: captures have strays far from all else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats

FAINT = 0.1  # opacity of what no one would miss
TAIL = 0.02  # share at either end of an axis that may be strays
ROOM = 0.5  # of the middle's longest side: what lies farther beyond it than this is a stray


def to_frame(positions: Floats, opacities: Floats) -> NDArray[np.bool_]:
    """(n,) True for Gaussians of the object, at positions (n, 3) with opacities (n,).

    They are those of some opacity in the box of the middle 96 % on each axis, grown on all sides by
    half its longest side.  All are True where none would be.
    """
    solid = np.asarray(opacities) >= FAINT
    if not solid.any():
        return np.ones(len(solid), bool)
    low, high = np.quantile(np.asarray(positions)[solid], (TAIL, 1.0 - TAIL), axis=0)
    room = ROOM * float((high - low).max())
    near = solid & (positions >= low - room).all(axis=1) & (positions <= high + room).all(axis=1)
    return near if near.any() else np.ones(len(solid), bool)
