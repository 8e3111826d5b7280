"""Division of polygons with long edges into triangles with short edges.

The surface does not change.  Values of points, faces and corners are interpolated or inherited.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.core.mesh.subdivision import Division, divide_edges
from gf_usd.core.mesh.triangulation import triangulate

POINTS, VARYING, FACES, CORNERS = "points", "varying", "faces", "corners"


@dataclass(frozen=True, kw_only=True)
class DividedFaces:
    """The result of `divide`, with the interpolation of values."""

    counts: Ints  # (P',) corners of each face
    indices: Ints  # (C',) points of the corners
    face: Ints  # (P',) the face that each lies in
    corners: Ints  # (C', 3) three corners of that face ...
    weights: Floats  # (C', 3) ... and theirs at each corner
    division: Division  # of the points
    divided: int  # faces that had long edges

    def values(self, given: Any, elements: str, width: int = 1) -> Any:
        """New values (n', ...) of points, faces or corners, from the original ones (n, ...).

        Floating-point values are interpolated; others are taken from the nearest element.  width :
        values per element.
        """
        given = given.reshape(-1, width, *given.shape[1:])
        if elements == FACES:
            out = given[self.face]
        elif given.dtype.kind != "f":
            out = given[self._nearest(elements, len(given))]
        elif elements in (POINTS, VARYING):
            out = self.division.extended(given.astype(float))
        else:
            out = np.einsum("ck,ck...->c...", self.weights, given[self.corners].astype(float))
        return out.reshape(-1, *given.shape[2:]).astype(given.dtype)

    def faces(self, given: Ints) -> Ints:
        """The new faces of some original faces."""
        return np.flatnonzero(np.isin(self.face, given))

    def _nearest(self, elements: str, count: int) -> Ints:
        """(n,) for each point or corner one of the `count` before."""
        if elements == CORNERS:
            return np.take_along_axis(self.corners, self.weights.argmax(1)[:, None], 1)[:, 0]
        nearest = np.arange(count)
        for ends in self.division.halves:
            nearest = np.concatenate([nearest, nearest[ends[:, 0]]])
        return nearest


def long_faces(points: Floats, counts: Ints, indices: Ints, longest: float) -> Ints:
    """(P,) whether a polygon has an edge longer than this; False for those with two corners."""
    face = np.repeat(np.arange(len(counts)), counts)
    start = np.cumsum(counts) - counts
    after = np.arange(1, len(indices) + 1)
    after = np.where(after == (start + counts)[face], start[face], after)
    edge = lengths(points[indices[after]] - points[indices])
    return (np.bincount(face, edge > longest, len(counts)) > 0) & (np.asarray(counts) >= 3)


def divide_faces(
    points: Floats, counts: Ints, indices: Ints, longest: float, most: int = 0
) -> DividedFaces:
    """Divide polygons with an edge longer than this; the others are unchanged.

    points : (V, 3).
    counts, indices : (P,), (C,) of the polygons.
    longest : edge length, in the unit of the points.
    most : number of triangles at which the division stops; 0: unlimited.
    """
    counts, indices = np.asarray(counts, np.int64), np.asarray(indices, np.int64)
    long, start = long_faces(points, counts, indices, longest), np.cumsum(counts) - counts
    triangles, corner, of = triangulate(points, counts, indices)
    cut = np.flatnonzero(long[of])
    division = divide_edges(points, triangles[cut], longest, most)
    # Corners stand in one table: those of the faces before, then those of the triangles.
    kept, made = np.flatnonzero(~long), of[cut][division.of]
    first = np.concatenate([start[kept], len(indices) + 3 * np.arange(len(made))])
    size = np.concatenate([counts[kept], np.full(len(made), 3)])
    home = np.concatenate([kept, made])
    order = np.argsort(home, kind="stable")
    size, home = size[order], home[order]
    begin = np.cumsum(size) - size
    rows = np.arange(int(size.sum())) - np.repeat(begin - first[order], size)
    same = np.arange(len(indices))
    sources = np.concatenate([
        np.stack([same, same, same], 1),
        np.repeat(corner[cut][division.of], 3, axis=0),
    ])  # fmt: skip
    alone = np.tile([1.0, 0.0, 0.0], (len(indices), 1))
    weights = np.concatenate([alone, division.weights.reshape(-1, 3)])
    return DividedFaces(
        counts=size,
        indices=np.concatenate([indices, division.triangles.ravel()])[rows],
        face=home,
        corners=sources[rows],
        weights=weights[rows],
        division=division,
        divided=int(long.sum()),
    )
