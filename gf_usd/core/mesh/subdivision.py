"""Triangles divided into smaller ones: pieces of equal area, and halves of long edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, row_dots
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import undirected


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """P parts of equal area of each of some triangles."""

    of: Ints  # (P,) the triangle of each
    weights: Floats  # (P, 3) barycentric coordinates of its middle
    share: Floats  # (P,) of the triangle's area


def divided(points: Floats, triangles: Ints, area: float) -> Pieces:
    """Triangles in n^2 congruent pieces each, the fewest of which none is larger than an area.

    The pieces are in the order of their triangles.
    """
    parts = np.maximum(1, np.ceil(np.sqrt(areas(points, triangles) / area))).astype(np.int64)
    of, weights = [], []
    for n in np.unique(parts):
        i, j = np.meshgrid(np.arange(n), np.arange(n))
        like, turned = i + j < n, i + j < n - 1
        middles = np.concatenate(
            [np.stack([i[like], j[like]], 1) + 1 / 3, np.stack([i[turned], j[turned]], 1) + 2 / 3]
        )
        rows = np.flatnonzero(parts == n)
        of.append(np.repeat(rows, n * n))
        weights.append(np.tile(middles / n, (len(rows), 1)))
    which = np.concatenate([np.zeros(0, np.int64), *of])
    order = np.argsort(which, kind="stable")
    which, two = which[order], np.concatenate([np.zeros((0, 2)), *weights])[order]
    return Pieces(
        of=which, weights=np.column_stack([1.0 - two.sum(1), two]), share=1.0 / parts[which] ** 2
    )


EDGE = 2.0  # [spacings] that edges of a mesh may be long for it to show every bend of its body


@dataclass(frozen=True, kw_only=True)
class Division:
    """Triangles of which the long edges were halved, for all triangles at them alike."""

    triangles: Ints  # (T', 3) into the points, of the winding of those that they lie in
    halves: tuple[Ints, ...]  # (n, 2) ends of the edges halved, turn by turn: the new points
    of: Ints  # (T',) the triangle that each lies in
    weights: Floats  # (T', 3, 3) of each corner: barycentric in that triangle

    def extended(self, values: Floats) -> Floats:
        """(V', ...) values of the points, of which the first V are given: linear along edges."""
        for ends in self.halves:
            low, high = values[ends[:, 0]], values[ends[:, 1]]
            values = np.concatenate([values, low + 0.5 * (high - low)])
        return values


def divide_edges(points: Floats, triangles: Ints, longest: float, most: int = 0) -> Division:
    """Halve the edges that are longer than this until there are none.

    points : (V, 3); triangles : (T, 3); longest : of the points' unit, above 0; most : triangles
    from which on it ends with edges left; 0: no matter how many.
    """
    points, triangles = np.asarray(points, float), np.asarray(triangles, np.int64)
    # A corner of a triangle is a row of `weights` that no other triangle has.
    of, weights = np.repeat(np.arange(len(triangles)), 3), np.tile(np.eye(3), (len(triangles), 1))
    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    halves: list[Ints] = []
    while not most or len(triangles) < most:
        span, found = undirected(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))
        edges, edge = np.stack(np.divmod(found.keys, span), 1), found.of
        way = points[edges[:, 1]] - points[edges[:, 0]]
        long = np.flatnonzero((way * way).sum(1) > longest * longest)
        if len(long) == 0:
            break
        middle = np.full(len(edges), -1)
        middle[long] = len(points) + np.arange(len(long))
        points = np.concatenate([points, points[edges[long, 0]] + 0.5 * way[long]])
        halves.append(edges[long])
        cut = middle[edge.reshape(-1, 3)]
        rows = np.full(cut.shape, -1)
        rows[cut >= 0] = len(weights) + np.arange((cut >= 0).sum())
        first, last = corners[cut >= 0], np.roll(corners, -1, axis=1)[cut >= 0]
        weights = np.concatenate([weights, 0.5 * (weights[first] + weights[last])])
        of = np.concatenate([of, of[first]])
        triangles, corners = _cut_at(triangles, cut), _cut_at(corners, rows)
    return Division(
        triangles=triangles, halves=tuple(halves), of=of[corners[:, 0]], weights=weights[corners]
    )


def with_short_edges(points: Floats, triangles: Ints, longest: float) -> tuple[Floats, Ints]:
    """The same surface with no edge longer than this: (V', 3) points and (T', 3) triangles.

    See `divide_edges`; the first V points are those given.
    """
    points, triangles = np.asarray(points, float), np.asarray(triangles, np.int64)
    ends = [points.take(corner, axis=0) for corner in triangles.T]
    ways = (ends[k] - ends[k - 1] for k in range(3))
    if not any((row_dots(way, way) > longest * longest).any() for way in ways):
        return points, triangles  # most fine meshes, at a tenth of the time
    division = divide_edges(points, triangles, longest)
    return division.extended(points), division.triangles


def _cut_at(triangles: Ints, middle: Ints) -> Ints:
    """Triangles (T, 3) cut at the points on their edges: middle (T, 3) after each corner, -1: none.

    One cut leaves two, two leave three, three leave four triangles of the same winding. Which
    diagonal cuts a triangle with two cuts changes the sample mesh of self-contact, and its motion.
    """
    count = (middle >= 0).sum(1)
    # Turned so that one point is on the edge ab, and two are on ab and bc.
    first = np.where(count == 1, middle.argmax(1), 0)
    first = np.where(count == 2, (middle.argmin(1) + 1) % 3, first)
    turn = (first[:, None] + np.arange(3)) % 3
    (a, b, c), (ab, bc, ca) = (np.take_along_axis(v, turn, 1).T for v in (triangles, middle))
    patterns = (
        [(a, b, c)],
        [(a, ab, c), (ab, b, c)],
        [(ab, b, bc), (a, ab, bc), (a, bc, c)],
        [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)],
    )
    cut = [(number, corners) for number, all in enumerate(patterns) for corners in all]
    return np.concatenate([np.stack(corners, 1)[count == number] for number, corners in cut])
