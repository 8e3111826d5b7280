"""Patches: the connected parts of a surface in each grid cell, and segment casts against them.

A connected part of the solid in a cell is the full cell, or is bounded by patches.  Segment casts
find which patches bound the same part, and which part a point lies in: a segment from a point of
the solid to the first patch that it hits lies in the solid, and in the cell, since cells are
convex.

Lengths are in cells: the grid planes are at integers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints, cross, lengths
from gf_usd.core.arrays import corners as outermost
from gf_usd.core.mesh.topology import Edges, used_points
from gf_usd.core.neighbors import components
from gf_usd.geometry.sampling.pieces import cut
from gf_usd.geometry.solid import INSIDE, Solid
from gf_usd.geometry.surface import barycentric
from gf_usd.geometry.winding import winding_function

# [cells] surfaces are offset inward, so that one in a grid plane is in the cell that it bounds.
INSET = 1e-5
ASIDE = 1e-6 * np.array([0.532, 0.311, 0.788])  # [cells] shift, so that no edge is in a grid plane
ON = 1e-9  # relative tolerance of the intersection of a segment with a triangle
TESTS = 1 << 20  # pairs of a segment and a triangle at a time: bounds memory


@dataclass(frozen=True, kw_only=True)
class Skins:
    """The concatenated surfaces of a solid, in cell coordinates."""

    points: Floats  # (V, 3) [cells] offset inward by INSET
    triangles: Ints  # (T, 3) counter-clockwise seen from outside
    surface: Ints  # (T,) in the order of `Solid.surfaces`
    body: Ints  # (T,)
    shell: Ints  # (T,)
    # Winding numbers of the surfaces asked for so far: `inside` is called twice for each body.
    _winding: dict[int, Callable[[Floats], Floats]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @staticmethod
    def of(solid: Solid, of_surface: Ints, corners: Floats, h: float) -> Skins:
        """The surfaces in cells of edge h [m] from corners (bodies, 3) [m]; of_surface : (S,)."""
        points, triangles, shell, first, labels = [], [], [], 0, 0
        for index in range(len(solid.surfaces)):
            X, faces = solid.outward(index)
            cells = (X - corners[of_surface[index]]) / h
            points.append(cells + ASIDE - INSET * vertex_normals(cells, faces))
            triangles.append(faces + first)
            shell.append(solid.surfaces[index].welded.shell + labels)
            first, labels = first + len(X), int(shell[-1].max()) + 1
        counts = [len(t) for t in triangles]
        return Skins(
            points=np.concatenate(points),
            triangles=np.concatenate(triangles),
            surface=np.repeat(np.arange(len(counts)), counts),
            body=np.repeat(of_surface, counts),
            shell=np.concatenate(shell),
        )

    def inside(self, X: Floats, body: Ints) -> NDArray[np.bool_]:
        """(n,) True for points X (n, 3) [cells] inside any of the surfaces of their bodies (n,)."""
        out = np.zeros(len(X), bool)
        for k in range(int(self.surface.max()) + 1 if len(X) else 0):
            mine = self.surface == k
            faces = self.triangles[mine]
            low, high = outermost(self.points[used_points(faces)[0]])
            own = ~out & (body == self.body[mine][0])
            near = np.flatnonzero(own & ((low <= X) & (high >= X)).all(1))
            if len(near):
                if k not in self._winding:
                    self._winding[k] = winding_function(self.points, faces)
                out[near] = np.abs(self._winding[k](X[near])) > INSIDE
        return out

    def release(self) -> None:
        """Free the hierarchies of `inside`; the next query builds them again."""
        self._winding.clear()


def vertex_normals(points: Floats, triangles: Ints) -> Floats:
    """(V, 3) unit vertex normals, area-weighted; 0 where a vertex has no faces."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    normal = cross(b - a, c - a)
    out = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(normal[:, k], 3), len(points)) for k in range(3)],
        1,
    )
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return out / np.where(length > 0.0, length, 1.0)


@dataclass(frozen=True, kw_only=True)
class Keys:
    """Integer keys of the cells of each body."""

    low: Ints  # (3,)
    dims: Ints  # (3,)
    bodies: int

    def of(self, ijk: Ints, body: Ints) -> Ints:
        """(n,) keys of cells (n, 3) of bodies (n,); -1 outside the grid."""
        known, linear = np.ones(len(ijk), bool), np.zeros(len(ijk), np.int64)
        for column, low, wide in zip(ijk.T, self.low, self.dims):
            at = column - low
            known &= (at >= 0) & (at < wide)
            linear = linear * wide + at
        return np.where(known, linear * self.bodies + body, -1)

    def ijk(self, key: Ints) -> Ints:
        """(n, 3) cell of each key."""
        return np.stack(np.unravel_index(key // self.bodies, tuple(self.dims)), -1) + self.low

    def body(self, key: Ints) -> Ints:
        """(n,) body of each key."""
        return key % self.bodies

    @property
    def strides(self) -> Ints:
        """(3,) difference of the keys of neighboring cells along each axis."""
        return self.bodies * np.array([self.dims[1] * self.dims[2], self.dims[2], 1])


@dataclass(frozen=True, kw_only=True)
class Patches:
    """The pairs of a triangle and a cell that it intersects, and their patches.

    One row per pair, sorted by triangle and then by cell.
    """

    skins: Skins
    keys: Keys
    triangle: Ints  # (P,)
    key: Ints  # (P,) of the cell
    center: Floats  # (P, 3) [cells] a point of the triangle in the cell
    patch: Ints  # (P,) from 0
    codes: Ints = field(repr=False)  # (P,) of triangle and cell, ascending
    in_cell: Ints = field(repr=False)  # (P,) rows in the order of cells
    cells: Ints = field(repr=False)  # (C,) keys of cells, ascending
    cell_start: Ints = field(repr=False)  # (C + 1,) ranges of `in_cell`
    # The hierarchies built so far, since `behind` is called several times for each body.
    _trees: dict[int, tuple[Ints, Ints, igl.AABB]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def largest(self) -> Ints:
        """(patches,) the row of the largest triangle of each patch."""
        a, b, c = np.moveaxis(self.skins.points[self.skins.triangles], 1, 0)
        area = lengths(cross(b - a, c - a))
        order = np.lexsort([-area[self.triangle], self.patch])
        return order[np.unique(self.patch[order], return_index=True)[1]]

    def row(self, triangle: Ints, key: Ints) -> Ints:
        """Row of each pair of a triangle and a cell; -1 where there is none."""
        return found(self.codes, triangle * self._span + key, key >= 0)

    def behind(self, X: Floats, body: Ints) -> Ints:
        """(n,) row of the triangle nearest to points X (n, 3) [cells] of bodies (n,); -1: none."""
        skins, out = self.skins, np.full(len(X), -1)
        for k in np.unique(body):
            mine = np.flatnonzero(body == k)
            faces, triangles, tree = self._tree(int(k))
            if not len(faces):
                continue
            at = np.ascontiguousarray(X[mine])
            seen: Any = tree.squared_distance(skins.points, triangles, at)
            _, hit, closest = seen
            triangle = faces[hit]
            corners = np.moveaxis(skins.points[skins.triangles[triangle]], 1, 0)
            place = np.einsum("kna,nk->na", corners, barycentric(closest, *corners))
            cell = np.floor(place).astype(np.int64)
            row = self.row(triangle, self.keys.of(cell, skins.body[triangle]))
            for i in np.flatnonzero(row < 0):  # by rounding at a cell face
                low, high = np.searchsorted(self.triangle, [triangle[i], triangle[i] + 1])
                if high > low:
                    apart = np.linalg.norm(self.center[low:high] - place[i], axis=1)
                    row[i] = low + int(np.argmin(apart))
            out[mine] = row
        return out

    def _tree(self, body: int) -> tuple[Ints, Ints, igl.AABB]:
        """The triangles of a body, their corners (n, 3), and a hierarchy of their boxes."""
        if body not in self._trees:
            faces = np.flatnonzero(self.skins.body == body)
            triangles = np.ascontiguousarray(self.skins.triangles[faces], np.int64)
            tree = igl.AABB()
            if len(faces):
                tree.init(self.skins.points, triangles)
            self._trees[body] = faces, triangles, tree
        return self._trees[body]

    @property
    def _span(self) -> int:
        return int(self.keys.dims.prod()) * self.keys.bodies

    def first_hit(self, start: Floats, end: Ints, besides: Ints | None = None) -> Ints:
        """(n,) row of the first triangle hit from points (n, 3) to the centers of rows `end`.

        besides : (n,) rows that are ignored, on whose triangles the segments start.
        """
        out = np.array(end)
        cell = np.searchsorted(self.cells, self.key[end])
        many = np.diff(self.cell_start)[cell]
        bounds = np.searchsorted(
            np.cumsum(many), np.arange(0, many.sum() + TESTS, TESTS), side="right"
        )
        for low, high in pairwise(bounds):
            if high > low:
                some = slice(low, high)
                passed = None if besides is None else besides[some]
                out[some] = self._first_hit(start[some], end[some], cell[some], passed)
        return out

    def _first_hit(self, start: Floats, end: Ints, cell: Ints, besides: Ints | None) -> Ints:
        first, many = self.cell_start[cell], np.diff(self.cell_start)[cell]
        segment = np.repeat(np.arange(len(cell)), many)
        begin = np.cumsum(many) - many
        rows = self.in_cell[np.arange(len(segment)) - np.repeat(begin - first, many)]
        a, b, c = np.moveaxis(self.skins.points[self.skins.triangles[self.triangle[rows]]], 1, 0)
        o = start[segment]
        d = self.center[end][segment] - o
        # Moeller and Trumbore 1997
        u, v, s = b - a, c - a, o - a
        p, q = cross(d, v), cross(s, u)
        det = (u * p).sum(1)
        safe = np.where(det == 0.0, 1.0, det)
        x, y, t = (s * p).sum(1) / safe, (d * q).sum(1) / safe, (v * q).sum(1) / safe
        hit = (det != 0.0) & (x >= -ON) & (y >= -ON) & (x + y <= 1.0 + ON) & (t >= 0.0)
        hit &= t <= 1.0 + ON
        if besides is not None:
            hit &= rows != besides[segment]
        t = np.where(hit, t, np.inf)
        least = np.minimum.reduceat(t, begin)
        at = np.full(len(cell), len(rows))
        np.minimum.at(at, segment[t == least[segment]], np.flatnonzero(t == least[segment]))
        return np.where(np.isfinite(least), rows[np.minimum(at, len(rows) - 1)], end)


def found(ascending: Ints, wanted: Ints, known: NDArray[np.bool_]) -> Ints:
    """Index of each of `wanted` in an ascending array; -1 where it is absent, or not `known`."""
    if not len(ascending):
        return np.full(len(wanted), -1)
    at = np.minimum(np.searchsorted(ascending, wanted), len(ascending) - 1)
    return np.where(known & (ascending[at] == wanted), at, -1)


def find_patches(skins: Skins, inside: Ints, bodies: int) -> Patches:
    """The patches of surfaces; inside : (n, 3) additional cells in the range of the keys."""
    alone = _unconnected(skins, inside, bodies)
    return replace(alone, patch=_patch(alone))


def _unconnected(skins: Skins, inside: Ints, bodies: int) -> Patches:
    """See `find_patches`; a patch of its own for each row."""
    made = cut(skins.points[skins.triangles])
    middle = made.middles
    ijk = np.floor(middle).astype(np.int64)
    both = np.concatenate([ijk, inside])
    low = both.min(0) - 1
    keys = Keys(low=low, dims=both.max(0) + 2 - low, bodies=bodies)
    key = keys.of(ijk, skins.body[made.source])
    span = int(keys.dims.prod()) * bodies
    area = lengths(made.area_vectors)
    order = np.lexsort([-area, made.source * span + key])
    codes, first = np.unique((made.source * span + key)[order], return_index=True)
    rows = order[first]  # the largest piece of each triangle in each cell
    triangle, key = made.source[rows], key[rows]
    in_cell = np.argsort(key, kind="stable")
    cells, start = np.unique(key[in_cell], return_index=True)
    return Patches(
        skins=skins, keys=keys, triangle=triangle, key=key, center=middle[rows],
        patch=np.arange(len(rows)), codes=codes, in_cell=in_cell, cells=cells,
        cell_start=np.append(start, len(rows)),
    )  # fmt: skip


def _patch(rows: Patches) -> Ints:
    """Patch of each row: triangles are connected in the cells that their common edge crosses."""
    skins, keys = rows.skins, rows.keys
    edges = Edges.of(skins.triangles)
    begin = np.cumsum(edges.uses) - edges.uses
    edge, ijk = crossed(skins.points[edges.directed[edges.by_id[begin]]])
    first, uses = begin[edge], edges.uses[edge]
    node = np.repeat(np.arange(len(edge)), uses)
    turn = np.arange(len(node)) - np.repeat(np.cumsum(uses) - uses, uses)
    triangle = edges.by_id[first[node] + turn] // 3
    at = rows.row(triangle, keys.of(ijk[node], skins.body[triangle]))
    seen = at >= 0
    count = len(rows.triangle)
    graph = coo_matrix(
        (np.ones(seen.sum()), (at[seen], count + node[seen])), shape=(count + len(edge),) * 2
    )
    label = components(graph)[1][:count]
    return np.unique(label, return_inverse=True)[1].ravel()


def crossed(segments: Floats) -> tuple[Ints, Ints]:
    """Segments (m,) and cells (m, 3) of the cells that segments (n, 2, 3) pass through, sorted."""
    a, b = np.moveaxis(segments, 1, 0)
    several = np.ceil(np.maximum(a, b)) - np.floor(np.minimum(a, b)) > 1.0
    single = ~several.any(1)
    alone, source = (segments[single], np.flatnonzero(single)), np.flatnonzero(~single)
    segments = segments[source]
    for axis in range(3):
        done: list[tuple[Floats, Ints]] = []
        while True:
            one, other = segments[:, 0, axis], segments[:, 1, axis]
            low, high = np.floor(np.minimum(one, other)), np.ceil(np.maximum(one, other))
            spans = high - low > 1.0
            done.append((segments[~spans], source[~spans]))
            if not spans.any():
                break
            segments, source = segments[spans], source[spans]
            plane = np.floor(0.5 * (low + high))[spans]
            a, b = np.moveaxis(segments, 1, 0)
            t = (plane - a[:, axis]) / (b[:, axis] - a[:, axis])
            middle = a + t[:, None] * (b - a)
            middle[:, axis] = plane
            segments = np.concatenate([np.stack([a, middle], 1), np.stack([middle, b], 1)])
            source = np.tile(source, 2)
        segments = np.concatenate([s for s, _ in done])
        source = np.concatenate([s for _, s in done])
    segments, source = (np.concatenate(both) for both in zip(alone, (segments, source)))
    order = np.argsort(source, kind="stable")
    ijk = np.floor(0.5 * (segments[order, 0] + segments[order, 1])).astype(np.int64)
    return source[order], ijk
