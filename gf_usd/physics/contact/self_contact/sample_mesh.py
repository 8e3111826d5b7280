"""A triangulation of a body's contact samples, and which of them are neighbors at rest.

The samples of a surface divide it into the places that are nearest to each of them along the
surface; samples whose places meet at a point are a triangle (the dual of the geodesic Voronoi
diagram; Peyre and Cohen 2006, Geodesic remeshing using front propagation).  Its triangles are about
a spacing large however coarse or fine the mesh is, and its vertices move with the body.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.mesh.subdivision import with_short_edges
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Skin

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

# [spacings] longest edge of the mesh on which nearest samples are found.  Samples are 0.7 apart:
# the place of each holds a disk of 0.35, and of triangles with edges of up to 0.35 sqrt(3) = 0.61
# no point is as far from a corner, so that every sample has a vertex of its own.
FINE = 0.6
WIDE = 3.0  # [spacings] a triangle of samples farther apart spans what has no samples, as pins do
WELD = 1e-7  # of the extent: vertices nearer to each other are one
EPS = 1e-9  # of a spacing: the shortest edge of the graph, where vertices coincide


@dataclass(frozen=True, kw_only=True)
class SampleMesh:
    """Triangles of the samples of one body, in 32 bits for kernels."""

    triangles: Ints  # (T, 3) samples, counter-clockwise seen from outside
    around: Ints  # (n, k) triangles of each sample; -1: no more

    @property
    def edges(self) -> Ints:
        """(E, 2) pairs of samples, each once and ascending."""
        return distinct(self.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), len(self.around))


def triangulate(skin: Skin, X: Floats, spacing: float) -> SampleMesh:
    """The triangles of samples X (n, 3) [m] that lie on a skin about a spacing [m] apart."""
    from scipy.sparse.csgraph import dijkstra

    points, triangles = with_short_edges(*weld(skin.points, skin.triangles), FINE * spacing)
    home = np.asarray(igl.point_mesh_squared_distance(X, points, triangles)[1]).reshape(-1)
    corners = triangles[home]
    first = len(points)
    samples = first + np.arange(len(X))
    ends = np.concatenate(
        [triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]
        + [np.stack([samples, corners[:, k]], 1) for k in range(3)]
    )
    graph = _lengths(ends, np.concatenate([points, X]), spacing)
    of = dijkstra(graph, directed=False, indices=samples, min_only=True, return_predecessors=True)[
        2
    ][:first]
    label = of[triangles] - first
    reached = (of[triangles] >= 0).all(1)
    a, b, c = label.T
    several = reached & (a != b) & (b != c) & (c != a)
    made = label[several]
    turn = made.argmin(1)[:, None]
    made = np.unique(np.take_along_axis(made, (turn + np.arange(3)) % 3, 1), axis=0)
    longest = np.linalg.norm(X[made] - X[np.roll(made, 1, axis=1)], axis=2).max(1, initial=0.0)
    made = made[longest <= WIDE * spacing]
    return SampleMesh(
        triangles=made.astype(np.int32), around=incident(made, len(X)).astype(np.int32)
    )


def weld(points: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """The same surface with vertices that coincide made one."""
    cell = WELD * max(float(np.ptp(points, axis=0).max()), 1e-30)
    _, first, of = np.unique(
        np.round(points / cell).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    welded = of.reshape(-1)[triangles]
    a, b, c = welded.T
    return points[first], welded[(a != b) & (b != c) & (c != a)]


def distinct(ends: Ints, n: int) -> Ints:
    """Pairs (E, 2) of n things without regard to their order, each once and ascending."""
    low, high = ends.min(1).astype(np.int64), ends.max(1)  # n^2 is beyond 32 bits
    key = np.sort(low * n + high)  # `numpy.unique` takes several times as long
    return np.stack(np.divmod(key[np.diff(key, prepend=-1) > 0], n), 1)


def incident(triangles: Ints, n: int) -> Ints:
    """(n, k) the triangles (T, 3) of each of n vertices, in order; -1: no more."""
    flat = triangles.ravel()
    order = np.argsort(flat, kind="stable")
    start = np.searchsorted(flat[order], np.arange(n + 1))
    width = int(np.diff(start).max(initial=0))
    at = start[:-1, None] + np.arange(width)
    there = at < start[1:, None]
    return np.where(there, order[np.where(there, at, 0)] // 3, -1) if width else at


def _lengths(ends: Ints, points: Floats, spacing: float) -> csr_matrix:
    """The graph of edges (E, 2) between points (n, 3), weighted by their lengths [m]."""
    from scipy.sparse import csr_matrix

    ends = distinct(ends, len(points))
    length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    length = np.maximum(length, EPS * spacing)
    return csr_matrix((length, (ends[:, 0], ends[:, 1])), shape=(len(points), len(points)))


class Neighbors:
    """Which samples of a body are near each other at rest, along its surface or through its solid.

    A pair is near where it is at most `hops` edges of the sample mesh apart, or closer than `far`
    [m] with the straight line between them through the body: inwards from one and outwards to the
    other.  Two legs with a narrow gap between them are not near.  A pair is at the rim where it is
    one edge farther apart than what is near.
    """

    def __init__(self, mesh: SampleMesh, X: Floats, normal: Floats, hops: int, far: float) -> None:
        from scipy.sparse import csr_matrix, identity

        n = len(X)
        a, b = mesh.edges.T
        ends = np.concatenate([a, b]), np.concatenate([b, a])
        step = csr_matrix((np.ones(2 * len(a), np.int8), ends), shape=(n, n))
        step = (step + identity(n, "int8", format="csr")).astype(bool)
        reached = step
        for _ in range(hops - 1):
            reached = reached @ step
        a, b = kd_tree(X).query_pairs(far, output_type="ndarray").T
        along = X[b] - X[a]
        inward = ((along * normal[a]).sum(1) < 0.0) & ((along * normal[b]).sum(1) > 0.0)
        through = np.concatenate([a[inward] * n + b[inward], b[inward] * n + a[inward]])
        self._n = n
        self._near = np.sort(np.concatenate([_keys(reached, n), through]), kind="stable")
        self._wide = _keys(reached @ step, n)
        start = np.searchsorted(self._near, np.arange(n + 1) * n)
        # Where the list of what is near each sample begins, and the last one ends; then the lists.
        self.lists = np.concatenate([n + 1 + start, self._near % n]).astype(np.int32)

    def near(self, a: Ints, b: Ints) -> Ints:
        """Whether samples a and b are near."""
        return _among(self._near, a * self._n + b)

    def rim(self, a: Ints, b: Ints) -> Ints:
        """Whether samples a and b are near or at the rim."""
        return _among(self._wide, a * self._n + b)


def _keys(pairs: csr_matrix, n: int) -> Ints:
    """a n + b of the entries of a matrix, ascending."""
    pairs.sort_indices()
    return np.repeat(np.arange(n) * n, np.diff(pairs.indptr)) + pairs.indices


def _among(keys: Ints, key: Ints) -> Ints:
    at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    return keys[at] == key
