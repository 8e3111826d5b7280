"""The edges of a triangle mesh, and the loops that its boundary makes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gf_usd.model import Floats, Ints


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
