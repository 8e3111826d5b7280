"""Clipping of triangles at the planes of a grid into pieces within one cell, with quadrature.

Lengths are in cells: the grid planes are at integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross, lengths

FLAT = 1e-15  # [cells^2] pieces of less area are dropped, below the rounding error of integrals
# Six points and weights that integrate polynomials of degree 4 over a triangle (Dunavant 1985).
NEAR, FAR = 0.445948490915965, 0.091576213509771
WEIGHT_NEAR, WEIGHT_FAR = 0.223381589678011, 0.109951743655322


def _dunavant() -> tuple[Floats, Floats]:
    """Barycentric coordinates (6, 3) and weights (6,)."""
    corners = np.eye(3, dtype=bool)
    points = [np.where(corner, 1.0 - 2.0 * t, t) for t in (NEAR, FAR) for corner in corners]
    weights = np.repeat([WEIGHT_NEAR, WEIGHT_FAR], 3)
    return np.array(points), weights / weights.sum()


POINTS, WEIGHTS = _dunavant()


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """Pieces of triangles, none of which crosses a grid plane."""

    corners: Floats  # (n, 3, 3) [cells]
    source: Ints  # (n,) row of the triangle each is part of

    area_vectors: Floats  # (n, 3) [cells^2] normal times area

    @property
    def middles(self) -> Floats:
        """(n, 3) [cells]"""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return (a + b + c) / 3.0


def cut(corners: Floats) -> Pieces:
    """Triangles (n, 3, 3) [cells] clipped at all grid planes, without degenerate pieces."""
    a, b, c = np.moveaxis(corners, 1, 0)
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    whole = (np.ceil(high) - np.floor(low) <= 1.0).all(1)
    # Those that no plane cuts, which most of a fine mesh are, stay first in any case.
    source = np.flatnonzero(~whole)
    some = corners[source]
    for axis in range(3):
        some, source = cut_along(some, source, axis)
    corners = np.concatenate([corners[whole], some])
    source = np.concatenate([np.flatnonzero(whole), source])
    a, b, c = np.moveaxis(corners, 1, 0)
    vectors = 0.5 * cross(b - a, c - a)
    solid = lengths(vectors) > FLAT
    if solid.all():
        return Pieces(corners=corners, source=source, area_vectors=vectors)
    return Pieces(corners=corners[solid], source=source[solid], area_vectors=vectors[solid])


def cut_along(corners: Floats, source: Ints, axis: int) -> tuple[Floats, Ints]:
    """Clip at every integer of one axis, into at most three pieces for each slab."""
    z = corners[:, :, axis]
    first = np.floor(z.min(1))
    slabs = np.ceil(z.max(1)) - first
    whole = slabs <= 1.0
    count = slabs[~whole].astype(np.int64)
    rows = np.repeat(np.flatnonzero(~whole), count)
    slab = first[rows] + np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    pieces = _in_slab(corners[rows], slab, axis)
    return (
        np.concatenate([corners[whole], *pieces]),
        np.concatenate([source[whole], *[source[rows]] * len(pieces)]),
    )


def _in_slab(corners: Floats, slab: Floats, axis: int) -> tuple[Floats, Floats, Floats]:
    """Three triangles, some degenerate, of each triangle's part between planes slab and slab + 1.

    The lowest and the highest corner are connected by one edge, and by a chain of the other two
    edges.  The middle corner of the chain may be in the slab: the part is then a pentagon.
    """
    order = np.argsort(corners[:, :, axis], axis=1, kind="stable")
    rows = np.arange(len(corners))[:, None]
    low, middle, high = np.moveaxis(corners[rows, order], 1, 0)
    bottom = np.maximum(slab, low[:, axis])
    top = np.minimum(slab + 1.0, high[:, axis])

    def on_edge(start: Floats, end: Floats, plane: Floats) -> Floats:
        rise = end[:, axis] - start[:, axis]
        t = (plane - start[:, axis]) / np.where(rise > 0.0, rise, 1.0)
        point = start + np.clip(t, 0.0, 1.0)[:, None] * (end - start)
        point[:, axis] = plane
        return point

    def on_chain(plane: Floats) -> Floats:
        under = (plane < middle[:, axis])[:, None]
        return on_edge(np.where(under, low, middle), np.where(under, middle, high), plane)

    a, b = on_edge(low, high, bottom), on_chain(bottom)
    c, d = on_chain(top), on_edge(low, high, top)
    # A middle corner in another slab is replaced by a point of the chain in this one.
    m = np.where((middle[:, axis] < bottom)[:, None], b, middle)
    m = np.where((middle[:, axis] > top)[:, None], c, m)
    pieces = np.stack([np.stack([a, b, m], 1), np.stack([a, m, c], 1), np.stack([a, c, d], 1)])
    # Sorting the corners by height reverses the winding where it is an odd permutation.
    odd = (order[:, 1] - order[:, 0]) % 3 != 1
    pieces[:, odd] = pieces[:, odd, ::-1]
    return pieces[0], pieces[1], pieces[2]
