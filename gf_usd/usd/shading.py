"""Normals of a polygon mesh that has none, smooth but for its creases.

The normal at a corner is the direction of the summed area vectors of those faces around its point
that met its own face at less than the crease angle at rest.
"""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats, Ints
from gf_usd.sparse import csr_matrix

# between the 5 degrees of a fine tessellation and the 90 of a box
CREASE = 50.0


class CornerNormals:
    """Corner normals of one topology.

    Parameters
    ----------
    rest : (V, 3) points in which creases are looked for, any unit.
    counts : (P,) corners of each face.
    indices : (C,) points of the corners.
    crease : [deg] faces that meet at more than this stay sharp.
    """

    def __init__(self, rest: Floats, counts: Ints, indices: Ints, crease: float = CREASE) -> None:
        counts, self._indices = np.asarray(counts), np.asarray(indices)
        self._face = np.repeat(np.arange(len(counts)), counts)
        self._first = np.repeat(np.cumsum(counts) - counts, counts)
        corners = np.arange(len(self._indices))
        last = np.append(self._face[1:] != self._face[:-1], True)
        self._next = np.where(last, self._first, corners + 1)
        self._faces = len(counts)
        area = self._areas(rest)
        length = np.linalg.norm(area, axis=1, keepdims=True)
        unit = np.divide(area, length, out=np.zeros_like(area), where=length > 0)
        # (C, P): the faces around each corner's point
        at_point = csr_matrix(
            (np.ones(len(corners)), (self._indices, self._face)),
            shape=(len(np.asarray(rest)), self._faces),
        )
        around = at_point[self._indices].tocoo()
        facing = np.einsum("ij,ij->i", unit[self._face[around.row]], unit[around.col])
        kept = (facing > np.cos(np.radians(crease))) | (self._face[around.row] == around.col)
        self._sum = csr_matrix(
            (np.ones(kept.sum()), (around.row[kept], around.col[kept])), shape=around.shape
        )

    def of(self, points: Floats) -> Floats:
        """Unit normals (C, 3), counter-clockwise faces seen from outside; zero where no area is."""
        total = self._sum @ self._areas(points)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.divide(total, length, out=np.zeros_like(total), where=length > 0)

    def _areas(self, points: Floats) -> Floats:
        """Area vectors (P, 3): sum over a face's edges of half (a - o) x (b - o)."""
        x = np.asarray(points, np.float64)[self._indices]
        half = 0.5 * np.cross(x - x[self._first], x[self._next] - x[self._first])
        areas = np.zeros((self._faces, 3))
        np.add.at(areas, self._face, half)
        return areas
