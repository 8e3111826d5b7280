"""Catmull-Clark subdivision of cages, with creases, corners and boundaries as USD defines them.

The rules are those of Catmull and Clark (1978), the creases those of DeRose, Kass and Truong (1998)
as in OpenSubdiv: sharpness decreases by one per level, and a vertex whose rule changes between two
levels uses a weighted mean of both rules.  A refined cage has the same limit surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints

INFINITE = 10.0  # UsdGeom.Mesh.SHARPNESS_INFINITE: does not decrease
SMOOTH, CREASE, CORNER = 0, 1, 2  # rules of a vertex


@dataclass(frozen=True, kw_only=True)
class Cage:
    """Polygons with at least three corners each, with creases and corners."""

    counts: Ints  # (P,) corners of each face
    indices: Ints  # (C,) points of the corners
    points: int  # that there are, used or not
    edge_sharpness: Floats  # (C,) of the edge from each corner to the next of its face
    point_sharpness: Floats  # (points,)

    def after(self) -> Ints:
        """(C,) next corner of each corner in its face."""
        end = np.cumsum(self.counts)
        after = np.arange(1, len(self.indices) + 1)
        after[end - 1] = end - self.counts
        return after

    def edges(self) -> Edges:
        """The edges of the faces."""
        ends = np.stack([self.indices, self.indices[self.after()]], 1)
        found = np.unique(edge_keys(ends, self.points), return_inverse=True, return_counts=True)
        keys, of, faces = found
        return Edges(ends=np.stack(np.divmod(keys, self.points), 1), of=of.reshape(-1), faces=faces)


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Edges of a cage, sorted by their points."""

    ends: Ints  # (E, 2) points, the lower first
    of: Ints  # (C,) the edge from each corner to the next
    faces: Ints  # (E,) how many have it: 1 at a boundary, 3 and more are not manifold


def edge_keys(ends: Ints, points: int) -> Ints:
    """(n,) key of each unordered pair of points (n, 2); ascending by lower, then higher point."""
    return ends.min(1) * points + ends.max(1)


@dataclass(frozen=True, kw_only=True)
class Weights:
    """A sparse linear map: weighted sums of rows."""

    to: Ints  # (W,) row of the result
    of: Ints  # (W,) row of what is given
    weight: Floats  # (W,)
    count: int  # rows of the result

    def __call__(self, given: Floats) -> Floats:
        """(count, ...) of values (n, ...)."""
        flat = given.reshape(len(given), -1)
        out = np.empty((self.count, flat.shape[1]))
        for k in range(flat.shape[1]):
            out[:, k] = np.bincount(self.to, self.weight * flat[self.of, k], self.count)
        return out.reshape(self.count, *given.shape[1:])


@dataclass(frozen=True, kw_only=True)
class Level:
    """One level of refinement: each corner of a face becomes a quad.

    The new points are the vertex points, followed by the edge points and the face points.
    """

    cage: Cage  # refined
    face: Ints  # (P',) the face that each lies in
    edges: Ints  # (E, 2) points before
    middle: Weights  # (P, points) mean of the points of a face
    moved: Weights  # (points + E, points + P) the points before and those of edges
    first: Ints  # (points',) a point of the level before, at each or next to it
    after: Ints  # (C,) the next corner of each of the cage before, in its face
    before: Ints  # (C,) and the previous one; new face k is the quad at corner k

    def points(self, values: Floats) -> Floats:
        """Values (points', ...) at the refined points, by the subdivision rules."""
        middle = self.middle(values)
        return np.concatenate([self.moved(np.concatenate([values, middle])), middle])

    def linear(self, values: Floats) -> Floats:
        """Values (points', ...) at the refined points, interpolated on edges and faces."""
        return np.concatenate([values, values[self.edges].mean(1), self.middle(values)])

    def corners(self, values: Floats) -> Floats:
        """Values (C', ...) at the refined corners, interpolated on each face."""
        counts = np.bincount(self.face, minlength=self.middle.count)
        start = np.cumsum(counts) - counts
        mean = np.add.reduceat(values, start) / counts.reshape(-1, *[1] * (values.ndim - 1))
        after, before = values[self.after], values[self.before]
        four = (values, 0.5 * (values + after), mean[self.face], 0.5 * (values + before))
        return np.stack(four, 1).reshape(-1, *values.shape[1:])


def refine(cage: Cage, *, bilinear: bool = False) -> Level:
    """The next level of a cage; bilinear : edges and points are all sharp."""
    counts, indices = cage.counts, cage.indices
    n_faces, n_corners = len(counts), len(indices)
    face = np.repeat(np.arange(n_faces), counts)
    after = cage.after()
    before = np.empty_like(after)
    before[after] = np.arange(n_corners)
    found = cage.edges()
    edges, edge, adjacent = found.ends, found.of, found.faces
    sharp = np.zeros(len(edges))
    np.maximum.at(sharp, edge, cage.edge_sharpness)
    sharp[(adjacent != 2) | bilinear] = INFINITE
    point_sharp = np.full(cage.points, INFINITE) if bilinear else cage.point_sharpness
    middle = Weights(to=face, of=indices, weight=1.0 / counts[face], count=n_faces)
    moved = _joined(
        _vertices(cage, edges, edge, face, sharp, point_sharp),
        _edges(cage, edges, edge, face, sharp),
    )
    first_edge, first_face = cage.points, cage.points + len(edges)
    quads = [indices, first_edge + edge, first_face + face, first_edge + edge[before]]
    fallen = _fallen(sharp)
    zero = np.zeros(n_corners)
    child = Cage(
        counts=np.full(n_corners, 4),
        indices=np.stack(quads, 1).reshape(-1),
        points=first_face + n_faces,
        edge_sharpness=np.stack([fallen[edge], zero, zero, fallen[edge[before]]], 1).reshape(-1),
        point_sharpness=np.concatenate([_fallen(point_sharp), np.zeros(len(edges) + n_faces)]),
    )
    first = np.concatenate(
        [np.arange(cage.points), edges[:, 0], indices[np.cumsum(counts) - counts]]
    )
    return Level(
        cage=child, face=face, edges=edges, middle=middle, moved=moved, first=first,
        after=after, before=before,
    )  # fmt: skip


def limit(level: Level, values: Floats, before: int) -> Floats:
    """The limit positions of the points of a cage: (before, ...).

    level : of the cage; values : (points', ...) of its refined points; before : points of the cage.

    (n^2 v + 4 sum e + sum f) / (n (n + 5)) around a smooth vertex of n edges (Halstead, Kass and
    DeRose 1993), (e + 4 v + e) / 6 along a crease.
    """
    cage = level.cage
    v, e, f, e2 = cage.indices.reshape(-1, 4).T
    quads = np.arange(len(v))
    n = np.bincount(v, minlength=before)[:before].astype(float)
    # Each edge of an interior vertex is adjacent to two quads.
    around = 2.0 * (values[e] + values[e2]) + values[f]
    total = Weights(to=v, of=quads, weight=np.ones(len(v)), count=before)(around)
    shape = (-1, *[1] * (values.ndim - 1))
    used = np.maximum(n, 1.0).reshape(shape)
    smooth = (used**2 * values[:before] + total) / (used * (used + 5.0))
    keys = np.concatenate([v, v]) * cage.points + np.concatenate([e, e2])
    center, middle = np.divmod(np.unique(keys), cage.points)
    degree = np.bincount(center, minlength=before)
    count = np.bincount(np.concatenate([e, e2]), minlength=cage.points)
    sharp = np.zeros(cage.points)
    np.maximum.at(sharp, e, cage.edge_sharpness.reshape(-1, 4)[:, 0])
    np.maximum.at(sharp, e2, cage.edge_sharpness.reshape(-1, 4)[:, 3])
    # An edge point is adjacent to four quads, or two at a boundary.
    hard = (sharp[middle] > 0.0) | (count[middle] != 4)
    center, middle = center[hard], middle[hard]
    rule = _rule(np.bincount(center, minlength=before), cage.point_sharpness[:before])
    rule = np.where((rule == SMOOTH) & (degree != n), CORNER, rule)
    one = np.ones(len(center))
    ends = Weights(to=center, of=middle, weight=one, count=before)(values)
    out = np.where((rule == CREASE).reshape(shape), (4.0 * values[:before] + ends) / 6.0, smooth)
    stays = (rule == CORNER) | (n == 0)
    return np.where(stays.reshape(shape), values[:before], out)


def _rule(sharp_edges: Ints, sharpness: Floats) -> Ints:
    rule = np.where(sharp_edges == 2, CREASE, np.where(sharp_edges > 2, CORNER, SMOOTH))
    return np.where(sharpness > 0.0, CORNER, rule)


def _fallen(sharpness: Floats) -> Floats:
    return np.where(sharpness >= INFINITE, INFINITE, np.maximum(sharpness - 1.0, 0.0))


def _edges(cage: Cage, edges: Ints, edge: Ints, face: Ints, sharp: Floats) -> Weights:
    """Edge points: the midpoint of a sharp edge; of a smooth one, the mean of ends and faces."""
    hard = np.minimum(sharp, 1.0)
    at = np.arange(len(edges))
    ends = 0.25 + 0.25 * hard
    faces = 0.25 * (1.0 - hard[edge])
    soft = faces > 0.0
    return Weights(
        to=np.concatenate([at, at, edge[soft]]),
        of=np.concatenate([edges[:, 0], edges[:, 1], cage.points + face[soft]]),
        weight=np.concatenate([ends, ends, faces[soft]]),
        count=len(edges),
    )


def _vertices(
    cage: Cage, edges: Ints, edge: Ints, face: Ints, sharp: Floats, point_sharp: Floats
) -> Weights:
    """Vertex points: the rules of this level and of the next, and a mean where they differ."""
    n_points = cage.points
    ends, other = edges.ravel(), edges[:, ::-1].ravel()
    hard, later = np.repeat(sharp, 2), _fallen(np.repeat(sharp, 2))
    rule = _rule(np.bincount(ends, hard > 0.0, n_points), point_sharp)
    then = _rule(np.bincount(ends, later > 0.0, n_points), _fallen(point_sharp))
    # The weight between the two rules is the mean sharpness of the elements that become smooth.
    turns = (hard > 0.0) & (later == 0.0)
    own = (point_sharp > 0.0) & (_fallen(point_sharp) == 0.0)
    many = np.bincount(ends, turns, n_points) + own
    share = (np.bincount(ends, turns * hard, n_points) + own * point_sharp) / np.maximum(many, 1)
    share = np.where(rule == then, 1.0, np.minimum(share, 1.0))
    degree = np.maximum(np.bincount(ends, minlength=n_points), 1).astype(float)
    # Around a smooth vertex there are as many faces as edges; where there are not, it is none.
    odd = np.bincount(cage.indices, minlength=n_points) != degree
    parts = []
    for which, amount, edge_is_sharp in (
        (rule, share, hard > 0.0),
        (then, 1.0 - share, later > 0.0),
    ):
        which = np.where((which == SMOOTH) & odd, CORNER, which)
        of_self = np.choose(which, [1.0 - 2.0 / degree, np.full(n_points, 0.75), np.ones(n_points)])
        parts.append((np.arange(n_points), np.arange(n_points), amount * of_self))
        on_crease = (which[ends] == CREASE) & edge_is_sharp
        weight = np.where(which[ends] == SMOOTH, degree[ends] ** -2, 0.125 * on_crease)
        parts.append((ends, other, amount[ends] * weight))
        corners = cage.indices
        weight = np.where(which[corners] == SMOOTH, degree[corners] ** -2, 0.0)
        parts.append((corners, n_points + face, amount[corners] * weight))
    to, of, weight = (np.concatenate(one) for one in zip(*parts, strict=True))
    some = weight != 0.0
    return Weights(to=to[some], of=of[some], weight=weight[some], count=n_points)


def _joined(one: Weights, other: Weights) -> Weights:
    """The concatenated rows of both."""
    return replace(
        one,
        to=np.concatenate([one.to, one.count + other.to]),
        of=np.concatenate([one.of, other.of]),
        weight=np.concatenate([one.weight, other.weight]),
        count=one.count + other.count,
    )


def sharp_edges(cage: Cage) -> tuple[Ints, Floats]:
    """(K, 2) points of the sharp edges other than boundaries, and (K,) their sharpness."""
    edges = cage.edges()
    sharpness = np.zeros(len(edges.ends))
    np.maximum.at(sharpness, edges.of, cage.edge_sharpness)
    chosen = (sharpness > 0.0) & (edges.faces > 1)
    return edges.ends[chosen], sharpness[chosen]


def boundary(cage: Cage) -> Ints:
    """Points of boundary edges."""
    edges = cage.edges()
    return np.unique(edges.ends[edges.faces == 1])
