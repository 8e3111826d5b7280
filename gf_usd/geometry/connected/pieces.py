"""Triangles cut by the planes of a grid into pieces that lie in one cell each, and integrals.

Lengths are in cells: the planes are at the integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints

FLAT = 1e-15  # [cells^2] pieces of less area are left out: no integral notices them
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
    """Parts of triangles, none across a plane of the grid."""

    corners: Floats  # (n, 3, 3) [cells]
    source: Ints  # (n,) row of the triangle each is part of

    @property
    def area_vectors(self) -> Floats:
        """(n, 3) [cells^2] normal times area."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return 0.5 * np.cross(b - a, c - a)


def cut(corners: Floats) -> Pieces:
    """Triangles (n, 3, 3) [cells] cut by all planes of the grid; flat pieces are left out."""
    source = np.arange(len(corners))
    for axis in range(3):
        corners, source = _cut_along(corners, source, axis)
    made = Pieces(corners=corners, source=source)
    solid = np.linalg.norm(made.area_vectors, axis=1) > FLAT
    return Pieces(corners=corners[solid], source=source[solid])


def _cut_along(corners: Floats, source: Ints, axis: int) -> tuple[Floats, Ints]:
    """Cut at every integer of one axis: halving the planes that a triangle spans, until none."""
    done: list[tuple[Floats, Ints]] = []
    while True:
        z = corners[:, :, axis]
        low, high = np.floor(z.min(1)), np.ceil(z.max(1))
        spans = high - low > 1.0
        done.append((corners[~spans], source[~spans]))
        if not spans.any():
            return np.concatenate([c for c, _ in done]), np.concatenate([s for _, s in done])
        corners, source = corners[spans], source[spans]
        plane = np.floor(0.5 * (low + high))[spans]
        parts = _split(corners, plane, axis)
        corners, source = np.concatenate(parts), np.tile(source, len(parts))


def _split(corners: Floats, plane: Floats, axis: int) -> tuple[Floats, Floats, Floats]:
    """Each triangle as three, none across its plane; some may be flat.

    The corner that is alone on its side is cut off; the rest is a quadrilateral.
    """
    off = corners[:, :, axis] - plane[:, None]
    below = off < 0.0
    alone = np.where((below.sum(1) == 1)[:, None], below, ~below)
    first = alone.argmax(1)
    turned = (first[:, None] + np.arange(3)) % 3
    rows = np.arange(len(corners))[:, None]
    v, d = corners[rows, turned], off[rows, turned]
    a, b, c = np.moveaxis(v, 1, 0)

    def crossing(end: Floats, at: Floats) -> Floats:
        t = d[:, 0] / (d[:, 0] - at)
        point = a + t[:, None] * (end - a)
        point[:, axis] = plane
        return point

    ab, ac = crossing(b, d[:, 1]), crossing(c, d[:, 2])
    return np.stack([a, ab, ac], 1), np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)
