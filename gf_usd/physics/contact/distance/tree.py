"""A bounding volume tree of a deforming surface: built once, then refitted.

Building a tree takes longer than its queries, since a detection has a few hundred queries per
surface. Neighboring triangles stay neighbors, so that the tree of the rest surface is used with
boxes of the current positions (van den Bergen 1997).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gf_usd.core.arrays import Floats, Ints, gather, lengths, row_dots
from gf_usd.physics.contact.distance.closest import (
    AROUND,
    BOXES,
    COLUMNS,
    FACES,
    FIRST_LEAF,
    LEAVES,
    MOVED,
    ON_SURFACE,
    TRIANGLES,
    Closest,
    no_points,
)

LEAF = 8  # largest number of triangles in a leaf


class SurfaceTree:
    """The triangles (T, 3) of a surface with points (V, 3) [m] at rest.

    Several are `joined` for a query of all of them at once: a kernel launch takes as long as some
    hundred queries.
    """

    def __init__(self, points: Floats, triangles: Ints) -> None:
        levels = max(0, int(np.ceil(np.log2(max(1, len(triangles)) / LEAF))))
        bounds = np.round(np.linspace(0, len(triangles), 2**levels + 1)).astype(np.int32)
        self._order = _sorted(points[triangles].mean(1), bounds, levels)
        self._corners = np.ascontiguousarray(triangles[self._order], np.int32)
        self._position = np.argsort(self._order)  # of each triangle in that order
        self._starts = bounds
        self._around = _around(self._corners, len(points))
        self._points = len(points)
        self._table = np.zeros((1, COLUMNS), np.int32)
        self._table[0, [LEAVES, FACES]] = len(bounds) - 1, len(triangles)
        self._of_leaf = np.zeros(len(bounds) - 1, np.int32)
        self._make_boxes()

    def _make_boxes(self) -> None:
        self._boxes = np.zeros((2 * int(self._table[:, LEAVES].sum()), 6))
        self._fitted = np.zeros(len(self._table), bool)

    @classmethod
    def joined(cls, trees: Sequence[SurfaceTree]) -> SurfaceTree:
        """One of several single surfaces, whose points and triangles follow each other."""
        out = cls.__new__(cls)
        tables = np.concatenate([tree._table for tree in trees])
        leaves, faces, points, around = (
            np.cumsum(sizes) - sizes
            for sizes in (
                tables[:, LEAVES], tables[:, FACES], np.array([tree._points for tree in trees]),
                np.array([len(tree._around) for tree in trees]),
            )
        )  # fmt: skip
        out._order = np.concatenate([t._order for t in trees])
        out._position = np.concatenate([t._position for t in trees])
        out._corners = np.concatenate(
            [t._corners + n for t, n in zip(trees, points)], dtype=np.int32
        )
        # one more than it has leaves for each
        out._starts = np.concatenate([t._starts + n for t, n in zip(trees, faces)], dtype=np.int32)
        out._around = np.concatenate([t._around for t in trees])
        out._points = sum(t._points for t in trees)
        out._table = tables
        out._table[:, FIRST_LEAF], out._table[:, BOXES] = leaves + np.arange(len(trees)), 2 * leaves
        out._table[:, TRIANGLES], out._table[:, AROUND] = faces, around
        out._of_leaf = np.repeat(np.arange(len(trees), dtype=np.int32), tables[:, LEAVES])
        out._make_boxes()
        return out

    def closest(
        self, X: Floats, points: Floats, reach: float, *, moved: bool | Ints = True,
        of: Ints | None = None, likely: Ints | None = None,
    ) -> Closest:  # fmt: skip
        """The result of `closest` for X (n, 3) [m] within reach [m] of the surface with points (V,
        3) [m].

        moved : whether the points have changed since the last call, (K,) of joined surfaces;
        of : (n,) the surface of each X, whose triangles are numbered by themselves; None: the only
        one; likely : (n,) a triangle that is near each X, -1: unknown; None: of all.  A query that
        knows one is faster, with the same result.
        """
        from gf_usd.physics.contact.distance import kernels

        if len(X) == 0 or len(self._order) == 0:
            return no_points()
        X, points = (np.ascontiguousarray(a, np.float64) for a in (X, points))
        of = np.zeros(len(X), np.int32) if of is None else np.ascontiguousarray(of, np.int32)
        found, which = np.zeros((len(X), 6)), np.full(len(X), -1, np.int32)
        if likely is not None:
            first = self._table[of, TRIANGLES]
            at = self._position[np.maximum(first + likely, 0)]
            which[:] = np.where(likely >= 0, first + at, -1)
        asked = np.zeros(len(self._table), bool)
        asked[of] = True
        refitted = asked & (np.asarray(moved) | ~self._fitted) & (self._table[:, FACES] > 0)
        self._table[:, MOVED] = refitted
        kernels.closest_points(
            X, of, points, self._corners, self._around, self._boxes, self._starts, self._of_leaf,
            self._table, reach, int(refitted.any()), found, which,
        )  # fmt: skip
        # Boxes of others are those of points which they no longer have.
        self._fitted = np.where(moved, refitted, self._fitted | refitted)
        rows = np.flatnonzero(which >= 0)
        at, seen = gather(which, rows), gather(found, rows)
        w, pseudo = seen[:, :3], seen[:, 3:]
        point = np.einsum("nk,nka->na", w, gather(points, gather(self._corners, at)))
        away = gather(X, rows) - point
        distance = lengths(away)
        gap = np.where(row_dots(away, pseudo) < 0.0, -distance, distance)
        on = distance <= ON_SURFACE * reach
        # The direction to the closest point is the gradient of the distance, up to its sign.
        away *= np.where(gap < 0.0, -1.0, 1.0)[:, None]
        away[on] = pseudo[on]
        length = lengths(away)
        sure = np.flatnonzero(length > 0.0)  # a triangle without area has no outside
        return Closest(
            rows=gather(rows, sure),
            gap=gather(gap, sure),
            triangle=gather(self._order, gather(at, sure)),
            weights=gather(w, sure),
            point=gather(point, sure),
            normal=gather(away, sure) / gather(length, sure)[:, None],
        )


def _sorted(centers: Floats, bounds: Ints, levels: int) -> Ints:
    """Triangles with centers (T, 3) in the order of a tree with leaves between `bounds`.

    Every node is split along its longest side, in proportion to the sizes of its children.
    """
    order = np.arange(len(centers))
    for level in range(levels):
        starts = bounds[:: 2 ** (levels - level)]
        own = centers[order]
        size = np.maximum.reduceat(own, starts[:-1]) - np.minimum.reduceat(own, starts[:-1])
        node = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        along = own[np.arange(len(own)), size.argmax(1)[node]]
        order = order[np.lexsort((along, node))]
    return order


def _around(corners: Ints, points: int) -> Ints:
    """The triangles at the edges and vertices of triangles (T, 3), in one list for the kernels.

    (T, 3) the edge that begins at each corner, (T, 3) the start of the list of each corner's
    vertex; the starts of the lists of the edges, with the end of the last; those of the vertices;
    then the triangles of each edge, and 3 t + k of the corners at each vertex.
    """
    faces = len(corners)
    ends = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], -1), axis=-1).reshape(-1, 2)
    edge = np.unique(ends[:, 0].astype(np.int64) * points + ends[:, 1], return_inverse=True)[1]
    edge, vertex = edge.reshape(-1), corners.ravel()
    edges = int(edge.max(initial=-1)) + 1
    begin = 6 * faces + (edges + 1) + (points + 1)
    edge_start = begin + np.concatenate([[0], np.cumsum(np.bincount(edge, minlength=edges))])
    begin = begin + len(edge)
    vertex_start = begin + np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=points))])
    return np.concatenate(
        [
            edge,
            6 * faces + edges + 1 + vertex,
            edge_start,
            vertex_start,
            np.argsort(edge, kind="stable") // 3,
            np.argsort(vertex, kind="stable"),
        ]
    ).astype(np.int32)
