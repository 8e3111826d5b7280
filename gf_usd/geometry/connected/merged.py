"""Values at the corners of the triangles of several surfaces that become one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface


def starts(counts: Sequence[int]) -> list[int]:
    """The index of the first element of each part of a concatenation."""
    return np.cumsum([0, *counts])[:-1].tolist()


def corner_values(
    values: Sequence[Floats | None], group: Sequence[Surface], otherwise: tuple[float, ...]
) -> Floats | None:
    """(T, 3, n) values of all triangles; None where no surface has any.

    values : (t, 3, n) of each surface; None: `otherwise` (n,).
    """
    if all(one is None for one in values):
        return None
    return np.concatenate(
        [
            np.broadcast_to(otherwise, (len(s.triangles), 3, len(otherwise)))
            if one is None
            else one
            for one, s in zip(values, group, strict=True)
        ]
    )


def material_rows(group: Sequence[Surface]) -> Ints | None:
    """(T,) rows of the materials of all surfaces one after the other; None where none has any.

    -1 : a triangle without a material.
    """
    if all(s.triangle_materials is None for s in group):
        return None
    first = starts([len(s.materials) for s in group])
    return np.concatenate(
        [
            np.full(len(s.triangles), -1)
            if s.triangle_materials is None
            else np.where(s.triangle_materials < 0, -1, s.triangle_materials + n)
            for s, n in zip(group, first, strict=True)
        ]
    )
