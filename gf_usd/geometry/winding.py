"""Orientation of triangles: consistent patches, and which shell lies inside which.

The edges of a triangle mesh, and the loops that its boundary makes.

Parts of one surface that reach into each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.mesh import areas
from gf_usd.core.neighbors import components

Flags = NDArray[np.bool_]

FLAT_FRACTION = 1e-4  # volume below this share of (area)^(3/2): no inside, so no outside either
OPEN_FRACTION = 0.25  # a wider mouth: neither
PROBES = 16  # vertices of a part that must lie inside another for the part to do
SIDES = 1024  # parts whose boxes are compared together: bounds memory


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Triangles joined across edges that exactly two of them share."""

    label: Ints  # (T,) 0, 1, ...
    against: Flags  # (T,) faces against the greater part, by area, of its patch
    one_sided: Flags  # (T,) of a patch that no choice of directions makes agree (a Moebius strip)


def patches(points: Floats, triangles: Ints, edges: Edges) -> Patches:
    """Patches of welded triangles (T, 3), and which triangles face against their own.

    Two copies of every triangle, as it is and turned, are joined wherever two neighbors agree: a
    patch that can be made to agree falls into two sheets, each the other turned inside out.
    """
    n = len(triangles)
    one, two = edges.pairs.T
    clash = np.where(edges.directed[one, 0] == edges.directed[two, 0], n, 0)
    a, b = one // 3, two // 3
    rows = np.concatenate([a, a + n])
    columns = np.concatenate([b + clash, b + n - clash])
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n, 2 * n))
    sheet = components(graph)[1]
    as_is, turned = sheet[:n], sheet[n:]
    label = np.unique(np.minimum(as_is, turned), return_inverse=True)[1].reshape(-1)
    against = as_is > turned
    area = areas(points, triangles)
    whole = np.bincount(label, area)
    lost = np.bincount(label, area * against, minlength=len(whole))
    against ^= (lost > 0.5 * whole)[label]
    one_sided = as_is == turned
    return Patches(label=label, against=against & ~one_sided, one_sided=one_sided)


def turned(triangles: Ints, which: Flags) -> Ints:
    """Triangles (T, 3) with the winding of some of them reversed."""
    return np.where(which[:, None], triangles[:, ::-1], triangles)


def volumes(points: Floats, triangles: Ints, label: Ints) -> Floats:
    """(K,) [m^3] signed volume of each part, about its own center; positive faces outward."""
    corners = points[triangles]
    count = np.bincount(label)
    mean = corners.mean(1)
    center = np.stack([np.bincount(label, mean[:, d]) / count for d in range(3)], 1)
    a, b, c = np.moveaxis(corners - center[label][:, None, :], 1, 0)
    return np.bincount(label, np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0)


def mouths(points: Floats, triangles: Ints, label: Ints) -> Floats:
    """(K,) |S| / (A + |S|), S = sum of the area vectors of a part and A its area.

    S is zero for a closed part; |S| is the least area that closes one hole.
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    vector = 0.5 * np.cross(b - a, c - a)
    gap = np.linalg.norm(
        np.stack([np.bincount(label, vector[:, d]) for d in range(3)], axis=1), axis=1
    )
    whole = np.bincount(label, np.linalg.norm(vector, axis=1)) + gap
    return gap / np.where(whole > 0.0, whole, 1.0)


def boxes(points: Floats, triangles: Ints, label: Ints) -> tuple[Floats, Floats]:
    """(K, 3), (K, 3) [m] lowest and highest corner of each part."""
    order = np.argsort(label, kind="stable")
    corners = points[triangles[order]]
    first = np.flatnonzero(np.diff(label[order], prepend=-1))
    return (
        np.minimum.reduceat(corners.min(1), first, axis=0),
        np.maximum.reduceat(corners.max(1), first, axis=0),
    )


def rows_of(label: Ints) -> list[Ints]:
    """Triangles of each part."""
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def containers(points: Floats, triangles: Ints, label: Ints) -> Ints:
    """(K,) the smallest part that each part lies inside; -1 where it lies inside none."""
    low, high = boxes(points, triangles, label)
    volume = np.abs(volumes(points, triangles, label))
    parts = rows_of(label)
    parent = np.full(len(parts), -1)
    for start in range(0, len(parts), SIDES):
        mine = np.arange(start, min(start + SIDES, len(parts)))
        around = (low[None] < low[mine, None]).all(2) & (high[None] > high[mine, None]).all(2)
        for i, j in np.argwhere(around):
            i = mine[i]
            if parent[i] >= 0 and volume[parent[i]] <= volume[j]:
                continue
            corners = np.unique(triangles[parts[i]])
            probes = corners[:: max(1, len(corners) // PROBES)]
            if winding_inside(points, triangles[parts[j]], points[probes]).all():
                parent[i] = j
    return parent


def winding_inside(points: Floats, triangles: Ints, X: Floats) -> Flags:
    """(n,) True for X (n, 3) where the winding number of the triangles exceeds one half."""
    used, local = np.unique(triangles, return_inverse=True)
    center = points[used].mean(0)
    local = np.ascontiguousarray(local.reshape(-1, 3), np.int64)
    w = igl.fast_winding_number(points[used] - center, local, X - center)
    return np.abs(np.atleast_1d(w)) > 0.5


@dataclass(frozen=True, kw_only=True)
class Facing:
    """How parts face: +1 outward, -1 inward, 0 where there is no inside to speak of."""

    now: Ints  # (K,)
    goal: Ints  # (K,) -1 for cavities
    inner: Flags  # (K,) lie in the flesh of another part and enclose nothing that is not so too

    @property
    def wrong(self) -> Flags:
        """(K,) parts that face the other way than they should."""
        return (self.now != 0) & (self.now == -self.goal)


def facing(points: Floats, triangles: Ints, label: Ints) -> Facing:
    """How each part faces, and how it should.

    Parts face outward, if they have an inside: some volume, and no mouth wider than
    `OPEN_FRACTION`.  One that lies inside another and faces the other way bounds a cavity: that
    is how hollow things are modeled, and it stays opposite to what it lies in.
    """
    volume = volumes(points, triangles, label)
    area = np.bincount(label, areas(points, triangles))
    inside = np.abs(volume) > FLAT_FRACTION * area**1.5
    inside &= mouths(points, triangles, label) <= OPEN_FRACTION
    now = np.where(inside, np.sign(volume), 0).astype(int)
    goal = np.abs(now)
    parent = containers(points, triangles, label)
    # From the outside in: what a part lies in is larger and decided before it.
    for i in np.argsort(-np.abs(volume), kind="stable"):
        j = parent[i]
        if j >= 0 and goal[j] == 1 and now[i] * now[j] == -1:
            goal[i] = -1
    inner = np.zeros(len(goal), bool)
    # From the inside out: a part that holds a cavity bounds flesh, wherever it lies.
    for i in np.argsort(np.abs(volume), kind="stable"):
        within = goal[i] == 1 and parent[i] >= 0 and goal[parent[i]] == 1
        inner[i] = within and inner[parent == i].all()
    return Facing(now=now, goal=goal, inner=inner)


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Half-edges of welded triangles (T, 3): number 3 t + k leaves corner k of triangle t."""

    directed: Ints  # (3T, 2) the vertices a half-edge leaves and reaches
    id: Ints  # (3T,) of the edge, whatever its direction
    uses: Ints  # (E,) half-edges of each edge: 1 at a boundary, 2 inside, more where not manifold

    @staticmethod
    def of(triangles: Ints) -> Edges:
        """Edges of triangles with three different vertices."""
        directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
        low, high = directed.min(1), directed.max(1)
        span = int(high.max(initial=0)) + 1
        _, ids, uses = np.unique(low * span + high, return_inverse=True, return_counts=True)
        return Edges(directed=directed, id=ids.reshape(-1), uses=uses)

    @cached_property
    def boundary(self) -> Ints:
        """(B,) half-edges without a partner."""
        return np.flatnonzero(self.uses[self.id] == 1)

    @cached_property
    def pairs(self) -> Ints:
        """(K, 2) half-edges of each edge that exactly two triangles share."""
        shared = np.flatnonzero(self.uses[self.id] == 2)
        return shared[np.argsort(self.id[shared], kind="stable")].reshape(-1, 2)

    @property
    def crowded(self) -> int:
        """Number of edges that more than two triangles share (not manifold)."""
        return int((self.uses > 2).sum())

    @cached_property
    def surplus(self) -> Ints:
        """(S,) half-edges of crowded edges that run one way more often than the other."""
        many = np.flatnonzero(self.uses[self.id] > 2)
        way = np.where(self.directed[many, 0] < self.directed[many, 1], 1, -1)
        net = np.bincount(self.id[many], way, minlength=len(self.uses)).astype(int)
        spare = many[way * net[self.id[many]] > 0]
        spare = spare[np.argsort(self.id[spare], kind="stable")]
        ids = self.id[spare]
        rank = np.arange(len(ids)) - np.searchsorted(ids, ids)
        return spare[rank < np.abs(net[ids])]


def boundary_loops(edges: Edges) -> tuple[list[Ints], int]:
    """Closed walks along the boundary, and how many boundary edges lie in none.

    Each loop holds half-edges in the order of their triangles.  It passes no vertex twice: a
    boundary that touches itself is several loops.  Where more than two triangles meet, a boundary
    may run along their surplus; a loop of nothing else (the rim of an inner wall) is no boundary.
    """
    leaving: dict[int, list[int]] = {}
    for half in [*edges.surplus.tolist(), *edges.boundary.tolist()]:
        leaving.setdefault(int(edges.directed[half, 0]), []).append(half)
    true = np.zeros(len(edges.id), bool)
    true[edges.boundary] = True
    loops: list[Ints] = []
    for first in list(leaving):
        while leaving[first]:
            loops.extend(_walk(edges, leaving, first))
    loops = [loop for loop in loops if true[loop].any()]
    return loops, len(edges.boundary) - sum(int(true[loop].sum()) for loop in loops)


def _walk(edges: Edges, leaving: dict[int, list[int]], first: int) -> list[Ints]:
    """Loops met on one walk from a vertex to where it can go no further; takes what it passes."""
    loops: list[Ints] = []
    walk: list[int] = []
    place = {first: 0}
    vertex = first
    while leaving.get(vertex):
        half = leaving[vertex].pop()
        walk.append(half)
        vertex = int(edges.directed[half, 1])
        if vertex in place:
            start = place[vertex]
            loops.append(np.array(walk[start:], np.int64))
            for passed in walk[start + 1 :]:
                del place[int(edges.directed[passed, 0])]
            walk = walk[:start]
        place[vertex] = len(walk)
    return loops


def fan_area(ring: Floats) -> float:
    """[m^2] of the triangles between a closed ring (n, 3) and its centroid."""
    spokes = ring - ring.mean(0)
    return float(0.5 * np.linalg.norm(np.cross(spokes, np.roll(spokes, -1, 0)), axis=1).sum())


OVERLAP_PROBES = 50_000  # places looked at: bounds time
FINEST = 12  # places along an edge, where triangles are few
DEPTH = 1e-4  # [sizes of a part] below its surface: parts that only touch share nothing there
SHARED = 1.5  # winding number of flesh that two parts claim: 2


def overlapping(points: Floats, triangles: Ints, label: Ints) -> NDArray[np.bool_]:
    """(K,) parts of outward triangles (T, 3) that lie in the flesh of others in some places.

    Just below the surface of a part alone the winding number is 1; where another part has the
    place too, it is 2.
    """
    count = int(label.max(initial=-1)) + 1
    if count < 2:
        return np.zeros(count, bool)
    rows = np.arange(0, len(triangles), -(-len(triangles) // OVERLAP_PROBES))
    n = int(np.clip(np.sqrt(2.0 * OVERLAP_PROBES / len(rows)), 1, FINEST))
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    # the middles of the n^2 / 2 upright triangles that a triangle is cut into
    u, v = ((np.stack([i, j])[:, i + j < n] + 1.0 / 3.0) / n)[:, None, :, None]
    a, b, c = (corner[:, None, :] for corner in np.moveaxis(points[triangles[rows]], 1, 0))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    low, high = boxes(points, triangles, label)
    depth = DEPTH * np.linalg.norm(high - low, axis=1)[label[rows]][:, None, None]
    X = (a + u * (b - a) + v * (c - a) - depth * normal).reshape(-1, 3)
    center = points[triangles].mean((0, 1))
    faces = np.ascontiguousarray(triangles, np.int64)
    w = np.asarray(igl.fast_winding_number(points - center, faces, X - center))
    shared = (w.reshape(len(rows), -1) > SHARED).any(1)
    return np.bincount(label[rows], shared, count) > 0
