"""Topology of meshes of triangles: welds, edges, shells, the surface of tetrahedra."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import components, pairs_within

# Float32 rounds points to about 1e-7 of their size: within ten times that they are one point.
WELD_FRACTION = 1e-6


def weld(points: Floats, tolerance: float | None = None) -> tuple[NDArray[np.int64], int]:
    """Points that coincide, as one representative each.

    Parameters
    ----------
    points : (V, 3), finite.
    tolerance : distance within which points are one (up to three times as far may join; the
        relation is transitive); None: 1e-6 of the bounding box's diagonal.

    Returns
    -------
    representative : (V,) index into `points` of the first point of each point's cluster, so that
        ``representative[triangles]`` is the welded mesh over the same points.
    n_unique : number of clusters.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64), 0
    low = points.min(axis=0)
    if tolerance is None:
        tolerance = WELD_FRACTION * float(np.linalg.norm(points.max(axis=0) - low))
    if tolerance <= 0.0:
        cell_of = _rows_as_labels(points)
        return _first_of_each(cell_of), int(cell_of.max()) + 1
    # Cells far below the tolerance come first: a million points in one spot stay linear work,
    # where the pair search alone would be quadratic.
    cell = tolerance / 4.0
    cell_of = _rows_as_labels(np.floor((points - low) / cell))
    centers = points[np.unique(cell_of, return_index=True)[1]]
    reach = tolerance + 2.0 * np.sqrt(3.0) * cell
    pairs = pairs_within(centers, reach)
    from scipy.sparse import coo_matrix

    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(centers),) * 2)
    n_unique, cluster = components(graph)
    return _first_of_each(cluster[cell_of]), int(n_unique)


def _rows_as_labels(rows: Floats) -> NDArray[np.int64]:
    """(V,) the same label for equal rows of a (V, 3) array."""
    order = np.lexsort(rows.T)
    step = np.any(np.diff(rows[order], axis=0) != 0.0, axis=1)
    labels = np.empty(len(rows), dtype=np.int64)
    labels[order] = np.concatenate(([0], np.cumsum(step)))
    return labels


def _first_of_each(labels: Ints) -> NDArray[np.int64]:
    """(V,) index of the first element that has each element's label."""
    _, first, back = np.unique(labels, return_index=True, return_inverse=True)
    return first[back].astype(np.int64)


# Of a tetrahedron (a, b, c, d) with (b - a) . ((c - a) x (d - a)) > 0, outward (UsdGeomTetMesh).
TET_FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])


def tet_surface(tets: Ints) -> tuple[NDArray[np.int64], int]:
    """The faces (T, 3) that one of tetrahedra (n, 4) of positive volume has alone, outward.

    And how many faces three and more of them share, which no solid has.
    """
    faces = np.asarray(tets)[:, TET_FACES].reshape(-1, 3)
    _, inverse, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return faces[count[inverse.reshape(-1)] == 1], int((count > 2).sum())


SPARSE = 4  # points for each corner, from where corners are sorted rather than points marked


def proper(triangles: Ints) -> NDArray[np.bool_]:
    """(T,) True where a triangle has three different vertices."""
    a, b, c = np.asarray(triangles).reshape(-1, 3).T
    return (a != b) & (b != c) & (c != a)


def used_points(triangles: Ints) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The points (n,) that triangles have, ascending, and the triangles as rows of these.

    As ``numpy.unique`` with its inverse, without a sort where most points are used.
    """
    triangles = np.asarray(triangles, dtype=np.int64)
    span = int(triangles.max(initial=-1)) + 1
    if span > SPARSE * triangles.size:
        used, local = np.unique(triangles, return_inverse=True)
        return used, local.reshape(triangles.shape)
    taken = np.zeros(span, bool)
    taken[triangles] = True
    return np.flatnonzero(taken), (np.cumsum(taken) - 1)[triangles]


@dataclass(frozen=True, kw_only=True)
class Numbered:
    """The different ones of some keys."""

    keys: Ints  # (m,) ascending
    of: Ints  # (n,) the row in `keys` of each
    count: Ints  # (m,) how many are equal to each
    order: Ints  # (n,) those of the first key, then those of the next one, each ascending


def numbered(keys: Ints) -> Numbered:
    """The different ones of keys (n,) of at least 0, as ``numpy.unique`` finds them.

    Where a key and its row fit in 64 bits, these are sorted as one number: 6 million edges take
    half the time of a sort of their rows (measured).
    """
    n = len(keys)
    bits = n.bit_length()
    if n and int(keys.max()) < 1 << (64 - bits):
        packed = keys.astype(np.uint64)
        packed <<= np.uint64(bits)
        packed |= np.arange(n, dtype=np.uint64)
        packed.sort()
        order = (packed & np.uint64((1 << bits) - 1)).astype(np.int64)
        packed >>= np.uint64(bits)
        ascending = packed.astype(np.int64)
    else:
        order = np.argsort(keys, kind="stable")
        ascending = keys[order]
    begins = np.ones(n, bool)
    np.not_equal(ascending[1:], ascending[:-1], out=begins[1:])
    of = np.empty(n, np.int64)
    of[order] = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    return Numbered(keys=ascending[first], of=of, count=np.diff(first, append=n), order=order)


def first_equal(rows: Ints) -> NDArray[np.int64]:
    """(m,) the first of the rows (m, n) of numbers of at least 0 that is equal to each."""
    found = numbered(rows[:, 0])
    for column in rows.T[1:]:
        if len(found.keys) == len(rows):  # no two are equal
            break
        found = numbered(found.of * (int(column.max()) + 1) + column)
    return found.order[np.cumsum(found.count) - found.count][found.of]


def undirected(edges: Ints) -> tuple[int, Numbered]:
    """Edges (n, 2) without direction: low * span + high is the key of each, with the span first."""
    low, high = np.minimum(*edges.T), np.maximum(*edges.T)
    # One number an edge: rows take several times as long to sort.
    span = int(high.max(initial=0)) + 1
    return span, numbered(low * span + high)


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Half-edges of welded triangles (T, 3): number 3 t + k starts at corner k of triangle t."""

    directed: Ints  # (3T, 2) start and end vertex of each half-edge
    id: Ints  # (3T,) of the undirected edge
    uses: Ints  # (E,) half-edges of each edge: 1 boundary, 2 manifold, more: non-manifold
    by_id: Ints  # (3T,) half-edges of the first edge, then of the next one, each ascending

    @staticmethod
    def of(triangles: Ints) -> Edges:
        """Edges of triangles, each of three distinct vertices."""
        triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
        directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        _, found = undirected(directed)
        return Edges(directed=directed, id=found.of, uses=found.count, by_id=found.order)

    @cached_property
    def boundary(self) -> Ints:
        """(B,) half-edges of boundary edges."""
        return np.flatnonzero(self.uses[self.id] == 1)

    @cached_property
    def pairs(self) -> Ints:
        """(K, 2) the two half-edges of each manifold edge."""
        return self.by_id[np.repeat(self.uses == 2, self.uses)].reshape(-1, 2)

    @property
    def non_manifold(self) -> int:
        """Number of edges that more than two triangles share."""
        return int((self.uses > 2).sum())

    @cached_property
    def surplus(self) -> Ints:
        """(S,) half-edges of non-manifold edges that have no half-edge of opposite direction."""
        many = np.flatnonzero(self.uses[self.id] > 2)
        way = np.where(self.directed[many, 0] < self.directed[many, 1], 1, -1)
        net = np.bincount(self.id[many], way, minlength=len(self.uses)).astype(int)
        spare = many[way * net[self.id[many]] > 0]
        spare = spare[np.argsort(self.id[spare], kind="stable")]
        ids = self.id[spare]
        rank = np.arange(len(ids)) - np.searchsorted(ids, ids)
        return spare[rank < np.abs(net[ids])]


class Welded:
    """Welded triangles without collapsed ones, and quantities of their edges, each computed once.

    representative : (V,) see `weld`; triangles : (T, 3).
    """

    def __init__(self, representative: Ints, triangles: Ints) -> None:
        welded = representative[triangles]
        self.source = np.flatnonzero(proper(welded))  # (T',) row in `triangles` of each
        self.triangles = np.ascontiguousarray(welded[self.source], dtype=np.int64)  # (T', 3)
        self._edges: Edges | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_edges": None}

    @property
    def edges(self) -> Edges:
        """Their edges, kept until `release`: they take about 250 bytes for each triangle."""
        if self._edges is None:
            self._edges = Edges.of(self.triangles)
        return self._edges

    def release(self) -> None:
        """Free the edges; the next use finds them again."""
        self._edges = None

    @cached_property
    def shell(self) -> NDArray[np.int64]:
        """(T',) see `shells`."""
        return _shells(self._edges or Edges.of(self.triangles))

    @property
    def boundary(self) -> NDArray[np.int64]:
        """(E, 2) see `boundary_edges`."""
        return self._borders[0]

    @property
    def consistent(self) -> bool:
        """Whether no two triangles pass an edge that only they share in the same direction."""
        return self._borders[1]

    @property
    def balanced(self) -> bool:
        """Whether every edge has as many half-edges in one direction as in the other.

        The winding number is then an integer.
        """
        return self._borders[2]

    @cached_property
    def _borders(self) -> tuple[NDArray[np.int64], bool, bool]:
        edges = self._edges or Edges.of(self.triangles)
        starts = edges.directed[edges.pairs, 0]
        up = np.where(edges.directed[:, 0] < edges.directed[:, 1], 1.0, -1.0)
        return (
            edges.directed[edges.boundary],
            not (starts[:, 0] == starts[:, 1]).any(),
            not np.bincount(edges.id, up).any(),
        )


def boundary_edges(triangles: Ints) -> NDArray[np.int64]:
    """(E, 2) edges that belong to one triangle only, directed as in it; closed meshes have none.

    `triangles` (T, 3) must be welded; collapsed triangles are ignored.
    """
    edges = Edges.of(np.asarray(triangles).reshape(-1, 3)[proper(triangles)])
    return edges.directed[edges.boundary]


def shells(triangles: Ints) -> NDArray[np.int64]:
    """(T,) label 0, 1, ... of the edge-connected part each triangle belongs to.

    `triangles` (T, 3) must be welded.  A collapsed triangle counts to the part of its edge.
    """
    return _shells(Edges.of(triangles))


def _shells(edges: Edges) -> NDArray[np.int64]:
    """See `shells`."""
    from scipy.sparse import coo_matrix

    ids, n_edges = edges.id, len(edges.uses)
    count = len(ids) // 3
    # A graph of triangles and edges as nodes: linear even where many triangles share one edge.
    owner = np.repeat(np.arange(count), 3)
    graph = coo_matrix((np.ones(len(ids)), (owner, count + ids)), shape=(count + n_edges,) * 2)
    labels = components(graph)[1][:count]
    return np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int64)
