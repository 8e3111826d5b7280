"""Convex edges and corners of an obstacle, and points on them.

Between samples of a body that are a spacing s apart an edge whose faces turn by an angle a stands
out by up to s/2 tan(a/2): 0.13 spacings at SHARP, half a spacing at the edge of a box, and without
bound at a spike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross, lengths, row_dots
from gf_usd.core.mesh.topology import proper, weld

SHARP = np.radians(30.0)  # angle by which the faces at an edge or a corner turn, at least
FLAT = 1e-6  # of its length: an edge that rises less above the plane of a corner does not rise


@dataclass(frozen=True, kw_only=True)
class SharpPoints:
    """Points on the convex edges and corners of an obstacle."""

    key: Ints  # (k,) number of each, which it keeps while the obstacle moves
    ends: Ints  # (k, 2) vertices of the edge that it is on; twice the same for a corner
    at: Floats  # (k,) from the first of them, 0, to the second, 1
    inward: Floats  # (k, 3) unit direction into the obstacle

    def of(self, rows: Ints) -> SharpPoints:
        """Some of them."""
        return SharpPoints(
            key=self.key[rows], ends=self.ends[rows], at=self.at[rows], inward=self.inward[rows]
        )

    def among(self, points: Floats) -> Floats:
        """(k, 3) [m] their positions, with the vertices of the obstacle at points (V, 3) [m]."""
        a, b = points[self.ends[:, 0]], points[self.ends[:, 1]]
        return a + self.at[:, None] * (b - a)


class SharpFeatures:
    """The convex edges and corners of a surface with points (V, 3) [m] and triangles (T, 3).

    step : [m] largest distance between neighboring points of an edge.
    """

    def __init__(self, points: Floats, triangles: Ints, step: float) -> None:
        welded = weld(points)[0][triangles]
        self._triangles = welded = welded[proper(welded)]
        normal = normals(points, welded)
        ends, faces = _edges(welded)
        n, m = normal[faces[:, 0]], normal[faces[:, 1]]
        third = welded[faces[:, 1]]
        opposite = third[(third != ends[:, :1]) & (third != ends[:, 1:])]
        behind = row_dots(points[opposite] - points[ends[:, 0]], n) < 0.0
        sharp = (row_dots(n, m) < np.cos(SHARP)) & behind
        self._ends, self._faces = ends[sharp], faces[sharp]
        length = lengths(points[self._ends[:, 1]] - points[self._ends[:, 0]])
        self._parts = np.maximum(1, np.ceil(length / step)).astype(np.int64)
        self._first = np.concatenate([[0], np.cumsum(self._parts)])
        self._corners = self._find_corners(points, normal)

    @property
    def any(self) -> bool:
        """Whether there are some."""
        return len(self._ends) + len(self._corners) > 0

    def _find_corners(self, points: Floats, normal: Floats) -> Ints:
        """Vertices that stand out: from which no edge rises, and whose faces turn by SHARP."""
        corner, face = self._triangles.ravel(), np.repeat(np.arange(len(self._triangles)), 3)
        out = -_inward(points, normal, corner, face, self._triangles, len(points))
        turned = np.ones(len(points))
        np.minimum.at(turned, corner, row_dots(out[corner], normal[face]))
        rises = np.zeros(len(points), bool)
        for turn in (1, 2):
            to = np.roll(self._triangles, -turn, axis=1).ravel()
            way = points[to] - points[corner]
            rises[corner[row_dots(way, out[corner]) > FLAT * lengths(way)]] = True
        stands = (turned < np.cos(0.5 * SHARP)) & ~rises & out.any(1)
        return np.flatnonzero(stands & (np.bincount(corner, minlength=len(points)) > 0))

    def within(self, points: Floats, low: Floats, high: Floats) -> SharpPoints:
        """Those in a box with corners (3,) [m], with the vertices at points (V, 3) [m]."""
        a, b = points[self._ends[:, 0]], points[self._ends[:, 1]]
        begin, end = _clipped(a, b - a, low, high)
        first = np.maximum(1, np.ceil(begin * self._parts)).astype(np.int64)
        last = np.minimum(self._parts - 1, np.floor(end * self._parts)).astype(np.int64)
        count = np.maximum(0, last - first + 1)
        edge = np.repeat(np.arange(len(count)), count)
        number = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + first[edge]
        corners = self._corners[
            ((points[self._corners] >= low) & (points[self._corners] <= high)).all(1)
        ]
        return SharpPoints(
            key=np.concatenate([self._first[edge] + number, self._first[-1] + corners]),
            ends=np.concatenate([self._ends[edge], np.stack([corners, corners], 1)]),
            at=np.concatenate([number / self._parts[edge], np.zeros(len(corners))]),
            inward=np.concatenate(
                [self._into_edges(points, edge), self._into_corners(points, corners)]
            ),
        )

    def _into_edges(self, points: Floats, edge: Ints) -> Floats:
        """(k, 3) the mean of the directions from edges (k,) into their two faces."""
        if not len(edge):
            return np.zeros((0, 3))
        ends, faces = self._ends[edge], self._faces[edge]
        along = points[ends[:, 1]] - points[ends[:, 0]]
        into = np.zeros_like(along)
        for side in (0, 1):
            face = self._triangles[faces[:, side]]
            way = points[face].sum(1) - points[ends].sum(1) - points[ends[:, 0]]
            square = np.maximum(row_dots(along, along), 1e-300)
            way = way - (row_dots(way, along) / square)[:, None] * along
            into += _unit(way)
        return _unit(into)

    def _into_corners(self, points: Floats, corners: Ints) -> Floats:
        if not len(corners):
            return np.zeros((0, 3))
        around = np.isin(self._triangles, corners)
        face, k = np.nonzero(around)
        normal = np.zeros((len(self._triangles), 3))
        some = np.unique(face)
        normal[some] = normals(points, self._triangles[some])
        corner = self._triangles[face, k]
        return _inward(points, normal, corner, face, self._triangles, len(points))[corners]


def known_values(known: Ints, values: Floats, keys: Ints) -> Floats:
    """(k,) the values (l,) of keys (k,) among known ones (l,), which ascend; 0 of others."""
    if not len(known):
        return np.zeros(len(keys))
    at = np.minimum(np.searchsorted(known, keys), len(known) - 1)
    return np.where(known[at] == keys, values[at], 0.0)


def normals(points: Floats, triangles: Ints) -> Floats:
    """(T, 3) unit normals; 0 of triangles without area."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return _unit(cross(b - a, c - a))


def _unit(vectors: Floats) -> Floats:
    length = lengths(vectors)
    return vectors / np.where(length > 0.0, length, 1.0)[:, None]


def _inward(
    points: Floats, normal: Floats, corner: Ints, face: Ints, triangles: Ints, count: int
) -> Floats:
    """(count, 3) unit directions into the obstacle at vertices: the mean of the faces' normals,
    weighted by their angles there, reversed.

    corner, face : (n,) each vertex with each of its faces.
    """
    where = triangles[face] == corner[:, None]
    others = np.argmax(where, axis=1)
    u = _unit(points[triangles[face, (others + 1) % 3]] - points[corner])
    v = _unit(points[triangles[face, (others + 2) % 3]] - points[corner])
    angle = np.arccos(np.clip(row_dots(u, v), -1.0, 1.0))
    out = np.zeros((count, 3))
    np.add.at(out, corner, -angle[:, None] * normal[face])
    return _unit(out)


def _edges(triangles: Ints) -> tuple[Ints, Ints]:
    """The edges (E, 2) that two triangles pass in opposite directions, and these (E, 2)."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(triangles)), 3)
    size = int(triangles.max(initial=0)) + 1
    key = np.minimum(start, end).astype(np.int64) * size + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    unique, first, count = np.unique(key[order], return_index=True, return_counts=True)
    pair = first[count == 2]
    one, other = order[pair], order[pair + 1]
    opposed = start[one] == end[other]
    ends = np.stack([unique[count == 2] // size, unique[count == 2] % size], 1)
    return ends[opposed], np.stack([face[one], face[other]], 1)[opposed]


def _clipped(a: Floats, way: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """(E,) the parts of segments a + t way (E, 3) in a box; the end is before the begin if there is
    none.
    """
    begin, end = np.zeros(len(a)), np.ones(len(a))
    for k in range(3):
        moves = way[:, k] != 0.0
        slope = np.where(moves, way[:, k], 1.0)
        one, other = (low[k] - a[:, k]) / slope, (high[k] - a[:, k]) / slope
        here = (a[:, k] >= low[k]) & (a[:, k] <= high[k])
        begin = np.maximum(begin, np.where(moves, np.minimum(one, other), 0.0))
        end = np.minimum(end, np.where(moves, np.maximum(one, other), np.where(here, 1.0, -1.0)))
    return begin, end
