"""Topology of polygon meshes: triangles, welds, edges, shells, volume.

Nothing here depends on a file format.  Triangles are (T, 3) indices, counter-clockwise seen from
outside; lengths are in whatever unit the points have.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, cross, lengths, row_dots
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


def _undirected(edges: Ints) -> tuple[int, Numbered]:
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
        _, found = _undirected(directed)
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


def signed_volume(points: Floats, triangles: Ints) -> float:
    """V = 1/6 sum a . (b x c) over the triangles; positive where they face outward.

    Meaningful for a closed mesh.  Taken about the mesh's own center, so that an asset far from
    the origin loses no digits.
    """
    triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    if len(triangles) == 0:
        return 0.0
    corners = np.asarray(points, dtype=np.float64)[triangles]
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return float(np.einsum("ti,ti->", a, cross(b, c)) / 6.0)


def areas(points: Floats, triangles: Ints) -> NDArray[np.float64]:
    """(T,) of the triangles."""
    points = np.asarray(points, float)
    a, b, c = (points.take(corner, axis=0) for corner in np.asarray(triangles).T)
    return 0.5 * lengths(cross(b - a, c - a))


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
        span, found = _undirected(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))
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


def triangulate(
    points: Floats, counts: Ints, indices: Ints
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Polygons to triangles of the same winding, in the order of the faces.

    A quad is cut along its shorter diagonal that leaves two upright triangles; a larger polygon is
    a fan where that is valid, and cut ear by ear where it is not (concave, or corners in line).
    Faces with fewer than three corners give nothing.

    Parameters
    ----------
    points : (V, 3).   counts : (P,) corners of each face.   indices : (sum of counts,) into points.

    Returns
    -------
    triangles (T, 3) into points, corners (T, 3) into indices, faces (T,) into counts.
    """
    points = np.asarray(points, dtype=np.float64)
    counts = np.asarray(counts, dtype=np.int64)
    indices = np.asarray(indices, dtype=np.int64)
    starts = np.cumsum(counts) - counts
    corners, faces = [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for n in np.unique(counts[counts >= 3]):
        group = np.flatnonzero(counts == n)
        rings = starts[group][:, None] + np.arange(n)
        cut = rings if n == 3 else _cut(points[indices[rings]], rings)
        corners.append(cut.reshape(-1, 3))
        faces.append(np.repeat(group, n - 2))
    corner, face = np.concatenate(corners), np.concatenate(faces)
    order = np.argsort(face, kind="stable")
    return indices[corner[order]], corner[order], face[order]


def _cut(polygons: Floats, rings: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, n - 2, 3) elements of `rings` (m, n) that triangulate `polygons` (m, n, 3)."""
    n = rings.shape[1]
    fan = np.stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)
    local = polygons - polygons.mean(axis=1, keepdims=True)
    normal = cross(local, np.roll(local, -1, axis=1)).sum(axis=1)  # Newell: twice the area
    size = np.einsum("mi,mi->m", normal, normal)

    def worst(pattern: Ints) -> Floats:
        """(m,) smallest signed area of the pattern's triangles over the polygon's area."""
        a, b, c = np.moveaxis(local[:, pattern], 2, 0)
        area = np.einsum("mti,mi->mt", cross(b - a, c - a), normal)
        return area.min(axis=1) / np.where(size > 0.0, size, 1.0)

    # Relative to the polygon: below this a triangle is a line.
    flat = 1e-9
    fan_worst = worst(fan)
    cut = rings[:, fan]
    if n == 4:
        other = np.array([[0, 1, 3], [1, 2, 3]])
        other_worst = worst(other)
        length = np.linalg.norm(local[:, [0, 1]] - local[:, [2, 3]], axis=2)
        shorter = length[:, 1] < (1.0 - 1e-6) * length[:, 0]
        swap = np.where(fan_worst > flat, shorter & (other_worst > flat), other_worst > fan_worst)
        cut[swap] = rings[swap][:, other]
        return cut
    for row in np.flatnonzero((fan_worst <= flat) & (size > 0.0)):
        cut[row] = rings[row][_ears(local[row], normal[row])]
    return cut


def _ears(ring: Floats, normal: Floats) -> NDArray[np.int64]:
    """(n - 2, 3) corners of a simple polygon (n, 3), cut off ear by ear, shortest cut first.

    A polygon that crosses itself has no triangulation; what is left when no ear remains is a fan.
    """
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(ring, axis, axis=1) * ([1.0, 1.0] if axis != 1 else [-1.0, 1.0])
    flat = flat * ([1.0, 1.0] if normal[axis] > 0 else [-1.0, 1.0])
    tiny = 1e-12 * float(np.ptp(flat, axis=0).max()) ** 2
    left, ears = np.arange(len(ring)), []
    while len(left) > 3 and (k := _next_ear(flat[left], tiny)) is not None:
        ears.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        left = np.delete(left, k)
    ears.extend((left[0], left[i], left[i + 1]) for i in range(1, len(left) - 1))
    return np.array(ears, dtype=np.int64)


def _next_ear(ring: Floats, tiny: float) -> int | None:
    """The corner of a plane polygon (n, 2) to cut off next; None where there is no ear."""
    before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    reach = np.linalg.norm(after - before, axis=1)
    upright = _cross2(ring - before, after - ring) > tiny
    for k in np.argsort(reach, kind="stable"):
        if upright[k] and not _covers(before[k], ring[k], after[k], ring):
            return int(k)
    return None


def _covers(a: Floats, b: Floats, c: Floats, others: Floats) -> bool:
    """True where the triangle covers one of `others` (n, 2), its own corners' places aside."""
    inside = (_cross2(b - a, others - a) >= 0.0) & (_cross2(c - b, others - b) >= 0.0)
    inside &= _cross2(a - c, others - c) >= 0.0
    for corner in (a, b, c):
        inside &= np.any(others != corner, axis=1)
    return bool(inside.any())


def _cross2(u: Floats, v: Floats) -> Floats:
    """(...,) z of the cross product of plane vectors."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
