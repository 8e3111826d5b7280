"""Surfaces of bodies in the pose of a detection, and which points of them are closest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners, gather
from gf_usd.core.stage import Skin
from gf_usd.physics.contact.distance.closest import Closest
from gf_usd.physics.contact.distance.tree import SurfaceTree
from gf_usd.physics.contact.distance.winding import outside_by_winding, shell
from gf_usd.physics.contact.planes.support_triangles import SupportTriangles
from gf_usd.physics.grid.embedding import product
from gf_usd.physics.grid.reference.stencil import Stencil


class PosedSkin:
    """A surface in one pose, of points (V, 3) [m] and triangles (T, 3).

    tree : of the triangles, which is refitted to the points; shell : see `winding.shell`.
    """

    def __init__(
        self, points: Floats, triangles: Ints, tree: SurfaceTree, shell: tuple[Ints, Ints] | None
    ) -> None:
        self._points, self._triangles = points, triangles
        self._tree, self._shell, self._fitted = tree, shell, False

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Corners (3,) [m] of the bounding box."""
        return corners(self._points)

    def closest(self, X: Floats, reach: float) -> Closest:
        """The closest points to X (m, 3) [m] within reach [m]; no other pose in between."""
        seen = self._tree.closest(X, self._points, reach, moved=not self._fitted)
        self._fitted = True
        return seen

    def corrected(self, seen: Closest, inside: Ints, X: Floats) -> Closest:
        """`seen` of X (m, 3) [m], with rows `inside` (k,) tested by the winding number."""
        if self._shell is None:
            return outside_by_winding(seen, inside, X, self._points, self._triangles)
        kept, faces = self._shell
        return outside_by_winding(seen, inside, X, self._points[kept], faces, shell=True)


class BodySkin:
    """The surface of one body.

    skin : at rest; body : its number on the grid of `stencil`; samples : (n,) indices of the body's
    contact samples; X : (n, 3) [m] of those at rest.
    """

    def __init__(self, skin: Skin, body: int, stencil: Stencil, samples: Ints, X: Floats) -> None:
        self.skin, self.samples = skin, samples
        of = np.full(len(skin.points), body)
        self._W = stencil.rows(skin.points, of, skin.cell_copy, gradients=False).W
        self._triples = SupportTriangles(X)
        self.tree = SurfaceTree(skin.points, skin.triangles)
        self._shell = shell(skin.points, skin.triangles)

    def near(
        self, X: Floats, known: Floats, u: Floats, offset: Floats, reach: float
    ) -> tuple[Closest, Floats]:
        """The closest points of the surface to X (m, 3) [m], and their rest positions (k, 3) [m].

        known : (m,) [m] <= 0, smallest plausible signed distance; where it is less, the whole
        surface is tested by its winding number.
        u : (nodes, 3) [m] as stacked by `Rows`, without offset (3,) [m].
        """
        now = self.posed(offset, u)
        seen = now.closest(X, reach)
        doubtful = np.flatnonzero(seen.gap < known[seen.rows])
        if len(doubtful):
            seen = now.corrected(seen, doubtful, X)
        return seen, self.rest(seen.triangle, seen.weights)

    def posed(self, offset: Floats, u: Floats | None = None) -> PosedSkin:
        """The surface with displacements u, and an offset (3,) [m]; None: at rest."""
        points = np.empty_like(self.skin.points)
        self.pose(points, offset, u)
        return self.at(points)

    def pose(self, out: Floats, offset: Floats, u: Floats | None) -> None:
        """Set `out` (V, 3) [m] to the points of `posed`."""
        np.add(self.skin.points, offset, out=out)
        if u is not None:
            out += product(self._W, u)

    def at(self, points: Floats) -> PosedSkin:
        """The surface with points (V, 3) [m]."""
        return PosedSkin(points, self.skin.triangles, self.tree, self._shell)

    def rest(self, triangle: Ints, weights: Floats) -> Floats:
        """(k, 3) [m] points at rest of triangles (k,), with barycentric weights (k, 3)."""
        corners = gather(self.skin.points, gather(self.skin.triangles, triangle))
        return np.einsum("nk,nka->na", weights, corners)

    def carriers(self, places: Floats) -> tuple[Ints, Floats]:
        """Contact samples (k, 3) and weights (k, 3) that carry points (k, 3) [m] at rest.

        The weights sum to 1, the largest first: see `SupportTriangles`.
        """
        if len(places) == 0:
            return np.zeros((0, 3), np.int64), np.zeros((0, 3))
        at, weights = self._triples(places)
        return self.samples[at], weights

    def nearest(self, places: Floats) -> Ints:
        """(k, NEAR) contact samples nearest to points (k, 3) [m] at rest; -1: no more."""
        near = self._triples.near(places)
        return np.where(near >= 0, gather(self.samples, near), -1)


class BodySkins:
    """The surfaces of some bodies, each made once something comes near it.

    make : the surface of a body; count : n of all samples.
    """

    def __init__(self, make: Callable[[int], BodySkin], count: int) -> None:
        self._make = make
        # (n,) the body and the triangle that each sample was found to be near at last: queries are
        # faster, with the same results, so that no checkpoint needs them
        self._last_body, self._last_triangle = np.full(count, -1), np.zeros(count, np.int64)
        self._skins: dict[int, BodySkin] = {}
        # All that are made: their tree, which of them each body is, and where its points begin.
        self._tree: SurfaceTree | None = None
        self._place: dict[int, int] = {}
        self._first = np.zeros(1, np.int64)
        self._points = np.zeros((0, 3))

    def __getitem__(self, body: int) -> BodySkin:
        if body not in self._skins:
            self._skins[body] = self._make(body)
        return self._skins[body]

    def near(
        self, rows: Ints, X: Floats, known: Floats, bodies: Ints, u: Floats, offset: Floats,
        reach: float,
    ) -> tuple[Closest, Floats]:  # fmt: skip
        """The same as `BodySkin.near` for samples `rows` (m,) at X (m, 3) [m], each of the surface
        of one of bodies (m,), by one query of all.
        """
        asked = np.unique(bodies).tolist()
        skins = [self[k] for k in asked]
        tree = self._joined()
        places = np.array([self._place[k] for k in asked])
        points = [self._points[self._first[k] : self._first[k + 1]] for k in places]
        for skin, own in zip(skins, points):
            skin.pose(own, offset, u)
        at = places[np.searchsorted(asked, bodies)]
        likely = np.where(self._last_body[rows] == bodies, self._last_triangle[rows], -1)
        seen = tree.closest(X, self._points, reach, of=at, likely=likely)
        self._last_body[rows[seen.rows]] = bodies[seen.rows]
        self._last_triangle[rows[seen.rows]] = seen.triangle
        doubtful = seen.gap < known[seen.rows]
        rest = np.empty((len(seen.rows), 3))
        of = bodies[seen.rows]
        for body, skin, own in zip(asked, skins, points):
            mine = np.flatnonzero(of == body)
            if doubtful[mine].any():
                seen = skin.at(own).corrected(seen, mine[doubtful[mine]], X)
            rest[mine] = skin.rest(seen.triangle[mine], seen.weights[mine])
        return seen, rest

    def _joined(self) -> SurfaceTree:
        """The tree of all surfaces that are made."""
        if self._tree is None or len(self._place) < len(self._skins):
            self._place = {body: k for k, body in enumerate(self._skins)}
            skins = self._skins.values()
            self._first = np.append(0, np.cumsum([len(one.skin.points) for one in skins]))
            self._points = np.zeros((self._first[-1], 3))
            self._tree = SurfaceTree.joined([one.tree for one in skins])
        return self._tree
