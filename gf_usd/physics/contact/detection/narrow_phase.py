"""Narrow phase: which of the nearby surfaces a contact sample is in contact with.

Between two detections no sample moves by more than half a spacing relative to another body, so that
a surface is known before the sample is deep. A sample gets the plane of the obstacle or body in
which it is deepest, or to which it is nearest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners, gather
from gf_usd.core.stage import Skin
from gf_usd.physics.contact.distance.closest import Closest
from gf_usd.physics.contact.distance.tree import SurfaceTree
from gf_usd.physics.contact.distance.winding import outside_by_winding, shell
from gf_usd.physics.contact.floor import FloorContact, damping_coefficient
from gf_usd.physics.contact.planes.contact_planes import (
    ARRAYS,
    NOBODY,
    OBSTACLE,
    ContactPlanes,
    nothing,
)
from gf_usd.physics.contact.planes.support_triangles import (
    NEAR,
    SupportTriangles,
    choose_support_triangles,
)
from gf_usd.physics.grid.embedding import product
from gf_usd.physics.grid.reference.stencil import Stencil

FACING = 1.5  # [spacings] radius of the surface represented by a sample
TRAVEL = 0.5  # [spacings] largest motion of samples between two detections
# [spacings] largest decrease of a gap between two detections: TRAVEL at the initial speeds, and a
# margin for accelerations and for motion of the surface between its samples.
CLOSER = 1.5 * TRAVEL


class ContactSearch:
    """Selects, for each sample, the plane in which it is deepest or to which it is nearest.

    x : (n, 3) [m]; reach : [m] distance within which planes are considered.
    least : (n,) [m] the smallest possible gap since the last detection.

    At a folded or inverted surface the sign of the distance may be wrong. A sample that seems
    deeper than possible is released, and counted: a spring that begins deep would add energy.
    """

    def __init__(self, x: Floats, reach: float, least: Floats) -> None:
        self.x, self.reach, self._least = x, reach, least
        self.gap = np.full(len(x), reach)
        self.planes = nothing(len(x))
        self._gone = np.zeros(len(x), bool)
        # For planes whose carriers are not yet known: the body, -1: none, and the rest position of
        # the point.
        self._owner, self._rest = np.full(len(x), -1), np.zeros((len(x), 3))

    @property
    def released(self) -> int:
        """Number of released samples."""
        return int(self._gone.sum())

    def allow(self, rows: Ints, least: Floats) -> None:
        """Set the smallest possible gaps (k,) [m] of samples `rows` that were not there before."""
        self._least[rows] = np.minimum(self._least[rows], least)

    def candidates(self, rows: Ints, theirs: Floats) -> Ints:
        """Those of the samples `rows` in the box of `theirs` (m, 3) [m], widened by the reach."""
        low, high = corners(theirs)
        low, high = low - self.reach, high + self.reach
        there = np.ones(len(rows), bool)
        for axis in range(3):
            x = gather(self.x[:, axis], rows)
            there &= (x >= low[axis]) & (x <= high[axis])
        return rows[there]

    def keep(self, rows: Ints, planes: ContactPlanes, gap: Floats) -> None:
        """Give samples `rows` (k,) the planes that they had; gap : (n,) [m] of all samples now."""
        for name in ARRAYS:
            getattr(self.planes, name)[rows] = gather(getattr(planes, name), rows)
        self.gap[rows] = gather(gap, rows)

    def offer(
        self, rows: Ints, gap: Floats, normal: Floats, point: Floats,
        carriers: Ints | None = None, weights: Floats | None = None,
        *, velocity: Floats | None = None, obstacle: int = -1, sure: bool = False,
    ) -> None:  # fmt: skip
        """Offer planes to samples `rows` (k,), each carried by samples, or by an obstacle.

        gap : (k,) [m]; point : (k, 3) [m] on the plane; carriers, weights : (k, 3), see `BodySkin`;
        None: of an obstacle, with velocity (k, 3) [m/s]; sure : the depth is not checked for
        plausibility.
        """
        nearer = self._take(rows, gap, normal, obstacle, sure=sure)
        rows, f = rows[nearer], self.planes
        if carriers is None or weights is None:
            f.partner[rows], f.point[rows] = OBSTACLE, point[nearer]
            f.carriers[rows], f.weights[rows] = NOBODY, 0.0
            if velocity is not None:
                f.velocity[rows] = velocity[nearer]
            return
        who, w = carriers[nearer], weights[nearer]
        f.partner[rows], f.carriers[rows], f.weights[rows] = who[:, 0], who, w
        f.point[rows] = point[nearer] - np.einsum("nk,nka->na", w, gather(self.x, who))

    def offer_places(
        self, rows: Ints, gap: Floats, normal: Floats, point: Floats, body: Ints | int,
        rest: Floats, obstacle: int = -1,
    ) -> None:  # fmt: skip
        """Offer planes to samples `rows` (k,) at points of bodies (k,), rest (k, 3) [m] at rest.

        A call of `carry` must follow, which finds the carriers of the planes that are selected.

        rows : a sample may be there several times, and gets the nearest plane, the first of equals;
        obstacle : that the samples belong to; -1: to bodies.
        """
        body = np.broadcast_to(body, len(rows))
        nearer = self._take(rows, gap, normal, obstacle, sure=False)
        rows = rows[nearer]
        self.planes.point[rows] = point[nearer]
        self._owner[rows], self._rest[rows] = body[nearer], rest[nearer]

    def keep_planes(
        self, rows: Ints, planes: ContactPlanes, offset: Floats, depth: Floats, far: float
    ) -> tuple[Ints, Floats]:
        """Keep the planes that samples `rows` (k,) had, of those that have not moved away.

        offset : (k,) [m] of the samples from these planes, see `RestGaps`; depth : (k,) [m] under
        them; far : [m] to the side of the place where it was, beyond which a sample is no longer
        inside.  Returns the samples (l,), and their gaps (l,) [m].
        """
        f = planes.of(rows)
        point = f.interpolated(self.x) + f.point
        aside = self.x[rows] - point + depth[:, None] * f.normal
        near = np.linalg.norm(aside, axis=1) < far
        rows, point, f = rows[near], point[near], planes.of(rows[near])
        gap = offset[near] - depth[near]
        self.offer(rows, gap, f.normal, point, f.carriers, f.weights, sure=True)
        self.planes.obstacle[rows] = f.obstacle
        return rows, gap

    def _take(self, rows: Ints, gap: Floats, normal: Floats, obstacle: int, *, sure: bool) -> Ints:
        """(k,) which offers are plausible and nearer than the current plane; stores their common
        values.
        """
        likely = np.full(len(rows), True) if sure else gap >= self._least[rows]
        self._gone[rows[~likely]] = True
        nearer = likely & (gap < self.gap[rows])
        nearer[nearer] = _least_of_each(rows[nearer], gap[nearer])
        rows, f = rows[nearer], self.planes
        self.gap[rows], f.normal[rows] = gap[nearer], normal[nearer]
        f.obstacle[rows], f.velocity[rows] = obstacle, 0.0
        self._owner[rows] = -1
        return nearer

    def carry(self, skins: BodySkins, X: Floats) -> None:
        """Find the samples that carry points of the skins; X : (n, 3) [m] of all at rest."""
        rows = np.flatnonzero(self._owner >= 0)
        if not len(rows):
            return
        rest, owner, f = gather(self._rest, rows), gather(self._owner, rows), self.planes
        near = np.empty((len(rows), NEAR), np.int32)
        for body in np.unique(owner):
            some = np.flatnonzero(owner == body)
            near[some] = skins[body].nearest(gather(rest, some))
        who, w = choose_support_triangles(X, rest, near)
        f.partner[rows], f.carriers[rows], f.weights[rows] = who[:, 0], who, w
        f.point[rows] -= np.einsum("nk,nka->na", w, gather(self.x, who))
        self._owner[rows] = -1


def _least_of_each(rows: Ints, gap: Floats) -> Ints:
    """(k,) which is the least gap of its row, the first of equals."""
    order = np.lexsort((gap, rows))
    least = np.ones(len(rows), bool)
    least[order[1:]] = rows[order[1:]] != rows[order[:-1]]
    return least


def pair_values(
    planes: ContactPlanes,
    contact: FloorContact,
    walls: Sequence[tuple[float | None, float | None]],
) -> dict[str, Floats]:
    """k, m, friction and damping c of each sample, and point of an obstacle, with its partner.

    Two bodies have the softer one's stiffness, their reduced mass, the geometric mean of their
    friction coefficients and the lower restitution.

    walls : (friction, restitution) of each obstacle, None: those of the sample. A point of an
    obstacle has the values of the surface that it presses.
    """
    mass, friction, restitution = contact.mass, contact.friction, contact.restitution
    n = len(mass)
    of = np.append(np.arange(n), np.maximum(planes.partner[n:], 0))
    k, m, mu, e = (
        np.array(v[of], float) for v in (contact.pair_stiffness, mass, friction, restitution)
    )
    a = planes.on_bodies
    a = a[a < n]
    b = planes.partner[a]
    k[a] = np.minimum(contact.pair_stiffness[a], contact.pair_stiffness[b])
    m[a] = mass[a] * mass[b] / (mass[a] + mass[b])
    mu[a], e[a] = np.sqrt(friction[a] * friction[b]), np.minimum(restitution[a], restitution[b])
    for number, (wall_friction, wall_restitution) in enumerate(walls):
        at = planes.obstacle == number
        if wall_friction is not None:
            mu[at] = wall_friction
        if wall_restitution is not None:
            e[at] = wall_restitution
    layer = np.array(contact.layer[of], float)
    layer[a] = layer[a] * layer[b] / (layer[a] + layer[b])
    damping = damping_coefficient(k, m, e)
    return {"stiffness": k, "mass": m, "layer": layer, "friction": mu, "damping": damping}


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
