"""Contact of a body with itself: what of its surface comes near what is far from it at rest.

The broad phase is by patches of the surface (`broad_phase.Patches`).  Of the pairs of patches that
may meet first, every pair of samples is looked at: most of what is near by its patches is not.
A body whose patches are all apart costs a few products of small matrices a detection.

The narrow phase is by the triangles of the `SampleMesh`.  A sample looks for something ahead of it
in a ball that touches the surface there; what finds something that is not near at rest, and what
faced something at the last detection, gets the closest point of the triangles that face it and are
not near it at rest.  The sign of the distance is that of the angle-weighted pseudo-normal
(Baerentzen and Aanaes 2005).  That sign alone cannot tell a sample that came through a surface from
one that lies behind it anyway, such as on the other side of the same limb: a sample is inside only
where it was inside, or on the outer side of the same place, at the last detection.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Skin
from gf_usd.physics.contact.broad_phase import Judged, Patches, closing, differences, dot
from gf_usd.physics.contact.sample_mesh import Neighbors, SampleMesh, triangulate

HOPS = 4  # edges of the sample mesh, from where on a body meets itself
THICK = 4.0  # [spacings] that two sides of a limb are apart which never meet each other
SEE = 2.0  # [spacings] radius of the ball in which a sample looks ahead: it sees twice as far
SEEDS = 3  # samples facing one whose triangles are looked at
STEP = 0.75  # [spacings] that a sample moves between two detections at most, against what is near
ASIDE = 0.5  # cosine of a sample's normal with those of triangles next to what it faces
TURN = 3.0  # [spacings] that a normal turned by a radian is as far as
# [spacings] from a sample to what it may face: as far as two normals that are alike let it look.
WIDEST = float(np.hypot(2.0 * SEE, 2.0**0.5 * TURN))
LOOKED = 8  # samples of which SEEDS are chosen
AHEAD = 1.5  # speeds may grow by this factor until the next detection
FEW = 8_000  # pairs of samples that are looked at one by one
CLEAR = 0.75  # [spacings] that is left when what was farther off is looked for again
FACE = 1.5  # [spacings] from where a sample faces a place
SAME = 0.25  # [spacings] that a place may have lain deeper than the one that a sample was inside of
NEARLY = 0.25  # [spacings] from where something is about to touch
OFFSET = 0.3  # [spacings] before it touches from where a body pushes itself


@dataclass(frozen=True, kw_only=True)
class Facing:
    """Samples of a body and the places of its own surface that they face."""

    rows: Ints  # (k,) samples, of the body's own
    gap: Floats  # (k,) [m], negative inside
    normal: Floats  # (k, 3) unit, out of the place
    point: Floats  # (k, 3) [m]
    carriers: Ints  # (k, 3) corners of its triangle, of the body's own samples
    weights: Floats  # (k, 3) barycentric
    hold: float = float("inf")  # [s] until what was seen beyond the reach may come within it


class SelfContact:
    """Finds what of one body faces itself.

    skin : its surface at rest; X, normal : (n, 3) of its samples at rest; spacing : [m].
    """

    def __init__(self, skin: Skin, X: Floats, normal: Floats, spacing: float) -> None:
        self._skin, self._X, self._normal, self._spacing = skin, X, normal, spacing
        self._patches = Patches(X, normal, spacing, see=2.0 * SEE, thick=THICK)
        self._made: tuple[SampleMesh, Neighbors] | None = None
        self._offset: Floats | None = None

    @property
    def _mesh(self) -> tuple[SampleMesh, Neighbors]:
        """Made once something is near: most bodies never need it."""
        if self._made is None:
            mesh = triangulate(self._skin, self._X, self._spacing)
            far = THICK * self._spacing
            self._made = mesh, Neighbors(mesh, self._X, self._normal, HOPS, far)
        return self._made

    @property
    def offset(self) -> Floats:
        """(n,) [m] from what it faces at which each sample begins to be pushed.

        Found with the reach of a detection: which samples are asked for a place depends on that,
        and what only a detection saw at rest would be pushed from the start.
        """
        if self._offset is None:
            most, still = OFFSET * self._spacing, np.zeros_like(self._X)
            reach, never = FACE * self._spacing, np.full(len(self._X), np.inf)
            seen = self.find(self._X, still, reach, self._X, never)
            self._offset = np.full(len(self._X), most)
            self._offset[seen.rows] = np.clip(seen.gap, 0.0, most)
        return self._offset

    def judge(self, x: Floats, v: Floats, span: float = np.inf) -> tuple[Judged | None, float]:
        """What may be near itself, None where nothing is; and for how long [s] that holds.

        x, v : (n, 3) [m], [m/s] of the samples; span : [s] after which it is asked again.
        """
        patches = self._patches
        judged = patches.judge(x, v)
        # What ends later than this, or than the pairs that are not few, is no concern.
        span = min(span, judged.fold)
        # Of what is not looked at one by one the bound is that of how far samples see.
        until = patches.unseen(judged, x, v, span, CLEAR * self._spacing)
        few = patches.few(until, span, FEW)
        if len(few):
            others = np.delete(until, few)
            least = min(span, float(others.min(initial=np.inf)))
            until[few] = np.maximum(until[few], self._one_by_one(few, x, v, least))
        hold = min(judged.fold, float(until.min(initial=np.inf)))
        return judged if judged.near.any() else None, hold

    def _one_by_one(self, pairs: Ints, x: Floats, v: Floats, least: float) -> Floats:
        """(k,) [s] before samples of pairs (k,) of patches may touch that do not yet.

        least : [s] from where it may be any time after it.
        """
        i, j, start = self._patches.samples(pairs)
        away, relative = differences(x, i, j), differences(v, i, j)
        distance = np.sqrt(dot(away, away))
        # What touches slides: it may go on for a while.
        left = np.maximum(distance - CLEAR * self._spacing, CLEAR * self._spacing)
        until = left / np.maximum(closing(away, distance, relative), 1e-30)
        if self._patches.adjacent[pairs].any():
            soon = np.flatnonzero(until < least)
            until[soon[self._mesh[1].near(i[soon], j[soon])]] = np.inf
        return np.minimum.reduceat(until, start)

    def imminent(self, x: Floats, v: Floats, span: float, before: Floats, gap: Floats) -> bool:
        """Whether anything may touch itself within a span [s]; before, gap : as of `find`."""
        judged, hold = self.judge(x, v, span)
        if judged is None:
            return hold < span
        found = self.find(x, v, 2.0 * SEE * self._spacing, before, gap, judged)
        theirs = np.einsum("nk,nka->na", found.weights, v[found.carriers])
        closing = -((v[found.rows] - theirs) * found.normal).sum(1)
        away = found.gap - self.offset[found.rows]
        left = away - AHEAD * span * np.maximum(closing, 0.0)
        return bool((left < NEARLY * self._spacing).any())

    def find(
        self, x: Floats, v: Floats, reach: float, before: Floats, gap: Floats,
        judged: Judged | None = None,
    ) -> Facing:  # fmt: skip
        """What faces itself within a reach [m].

        x, before : (n, 3) [m] now and at the last detection; v : (n, 3) [m/s]; gap : (n,) [m] found
        at the last detection; judged : of `judge`, only what may be near by it is looked at, and
        what was found before; None: everything.
        """
        mesh = self._mesh[0]
        if len(mesh.triangles) == 0:
            return _nothing()
        known = gap < reach
        looks = scene = np.ones(len(x), bool)
        if judged is not None:
            looks, scene = self._patches.around(judged, known, 2.0 * SEE * self._spacing)
        normals = _normals(x, mesh, looks)
        rows = self._ahead(x, normals[2], looks, scene, known)
        if len(rows) == 0:
            return _nothing()
        if judged is not None:
            wanted = np.zeros(len(x), bool)
            wanted[rows] = True
            scene = self._patches.around(judged, wanted, WIDEST * self._spacing)[1]
            normals = _normals(x, mesh, scene)
        normal = normals[2]
        seeds = self._seeds(rows, x, normal, np.flatnonzero(scene))
        rows, seeds = rows[seeds[:, 0] >= 0], seeds[seeds[:, 0] >= 0]
        if len(rows) == 0:
            return _nothing()
        s = self._spacing
        distance = np.linalg.norm(x[rows] - x[seeds[:, 0]], axis=1)
        speed = np.linalg.norm(v[rows] - v[seeds[:, 0]], axis=1)
        close = distance < reach + s
        until = (distance[~close] - CLEAR * s) / np.maximum(AHEAD * speed[~close], 1e-30)
        hold = float(until.min(initial=np.inf))
        if not close.any():
            return replace(_nothing(), hold=hold)
        found = self._closest(rows[close], seeds[close], x, reach, before, gap, normals)
        return replace(found, hold=hold)

    def _ahead(self, x: Floats, normal: Floats, looks: Ints, scene: Ints, known: Ints) -> Ints:
        """Samples before which something is that is not near at rest, with what is there.

        looks, scene, known : (n,) whether samples look ahead, may be seen, and are wanted anyway.
        """
        radius, neighbors = SEE * self._spacing, self._mesh[1]
        looks, scene = np.flatnonzero(looks), np.flatnonzero(scene)
        center = x[looks] + radius * normal[looks]
        distance, at = kd_tree(x[scene]).query(
            center, k=min(LOOKED, len(scene)), distance_upper_bound=radius * (1.0 - 1e-6)
        )
        there = np.isfinite(distance)
        who = np.broadcast_to(looks[:, None], at.shape)[there]
        other = scene[at[there]]
        far = ~neighbors.near(who, other)
        wanted = known.copy()
        wanted[who[far]] = True
        wanted[other[far]] = True
        # A crease is full of neighbors, which may hide what is far.
        wanted[looks[there.all(1)]] = True
        return np.flatnonzero(wanted)

    def _seeds(self, rows: Ints, x: Floats, normal: Floats, scene: Ints) -> Ints:
        """(k, SEEDS) the samples of a scene nearest to each of rows that face it and are not near;
        -1: no.
        """
        out, neighbors = np.full((len(rows), SEEDS), -1), self._mesh[1]
        if len(rows) == 0:
            return out
        # Facing is near in space and in minus the normal: what is next to it is as far as `wide`.
        wide = TURN * self._spacing
        at = kd_tree(np.hstack([x[scene], wide * normal[scene]])).query(
            np.hstack([x[rows], -wide * normal[rows]]), k=min(LOOKED, len(scene)),
            distance_upper_bound=np.hypot(2.0 * SEE * self._spacing, 2.0**0.5 * wide),
        )[1].reshape(len(rows), -1)  # fmt: skip
        a, j = np.nonzero(at < len(scene))
        b = scene[at[a, j]]
        facing = np.einsum("na,na->n", normal[rows[a]], normal[b]) < 0.0
        facing[facing] = ~neighbors.near(rows[a[facing]], b[facing])
        a, b = a[facing], b[facing]
        distance = np.linalg.norm(x[rows[a]] - x[b], axis=1)
        order = np.lexsort((b, distance, a))
        a, b = a[order], b[order]
        rank = np.arange(len(a)) - np.searchsorted(a, a)
        few = rank < SEEDS
        out[a[few], rank[few]] = b[few]
        return out

    def _closest(
        self, rows: Ints, seeds: Ints, x: Floats, reach: float, before: Floats, gap: Floats,
        normals: tuple[Floats, Floats, Floats],
    ) -> Facing:  # fmt: skip
        """The closest places of the triangles about the seeds (k, SEEDS) of each of rows (k,)."""
        mesh, neighbors = self._mesh
        face, angle, normal = normals
        t = np.where((seeds >= 0)[:, :, None], mesh.around[seeds], -1).reshape(len(rows), -1)
        t.sort(axis=1)
        t[:, 1:][t[:, 1:] == t[:, :-1]] = -1
        i, j = np.nonzero(t >= 0)
        at = t[i, j]
        s = rows[i]
        keep = np.einsum("na,na->n", normal[s], face[at]) < ASIDE
        corners = mesh.triangles[at]
        keep &= ~neighbors.near(s[:, None], corners).any(1)
        i, at, s, corners = i[keep], at[keep], s[keep], corners[keep]
        if len(i) == 0:
            return _nothing()
        weights = closest_weights(x[s], x[corners])
        q = np.einsum("nk,nka->na", weights, x[corners])
        away = x[s] - q
        distance = np.sqrt(np.einsum("na,na->n", away, away))
        start = np.flatnonzero(np.r_[True, i[1:] != i[:-1]])
        group = np.cumsum(np.r_[True, i[1:] != i[:-1]]) - 1
        least = np.minimum.reduceat(distance, start)
        tie = distance <= least[group] + 1e-6 * self._spacing
        # Pseudo-normal: faces and edges by their faces, vertices by the angles of their faces.
        vertex = weights.max(1) > 1.0 - 1e-9
        share = np.where(vertex, angle[at, weights.argmax(1)], 1.0) * tie
        pseudo = np.add.reduceat(share[:, None] * face[at], start)
        seen = np.add.reduceat(tie.astype(int), start)
        first = np.flatnonzero(tie)[np.searchsorted(np.flatnonzero(tie), start)]
        i, s, q, away = i[first], s[first], q[first], away[first]
        weights, corners, at = weights[first], corners[first], at[first]
        side = np.where((away * pseudo).sum(1) < 0.0, -1.0, 1.0)
        now = side * least
        # On the rim of what is admitted the closest place may be beyond it.
        rim = (neighbors.rim(s[:, None], corners) & (weights > 0.0)).any(1)
        rim &= weights.min(1) <= 0.0
        # Where the sample does not face all that meets at an edge or a corner, what it faces ends
        # there, and behind it is not inside.
        free = (weights > 1e-9).sum(1)
        degree = (mesh.around[corners[np.arange(len(s)), weights.argmax(1)]] >= 0).sum(1)
        ends = seen < np.select([free == 3, free == 2], [1, 2], degree)
        rim |= ends & (now < 0.0)
        pseudo /= np.maximum(np.linalg.norm(pseudo, axis=1, keepdims=True), 1e-30)
        on = least <= 1e-6 * self._spacing
        n = np.where(
            on[:, None], pseudo, away * (side / np.where(least > 0.0, least, 1.0))[:, None]
        )
        came, height, along = self._came(before, s, corners, weights, n)
        # Who is inside one place and behind another is not inside that one, too.
        same = (gap[s] < 0.0) & (height >= gap[s] - SAME * self._spacing)
        # At a sharp fold a place is on the outer side of one triangle and inside by the others: who
        # was as far behind it before did not come through.
        outer = (gap[s] >= 0.0) & (height >= 0.0) & (along >= 0.0)
        was = np.where(same, gap[s], np.where(outer, came, np.inf))
        believed = (now >= 0.0) | (now >= was - STEP * self._spacing) & (was < STEP * self._spacing)
        keep = (least < reach) & ~rim & believed
        return Facing(
            rows=s[keep], gap=now[keep], normal=n[keep], point=q[keep],
            carriers=corners[keep], weights=weights[keep],
        )  # fmt: skip

    @staticmethod
    def _came(
        x: Floats, s: Ints, corners: Ints, weights: Floats, normal: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """[m] from samples s to places of triangles (k, 3).

        And how high above these, and along normals (k, 3).
        """
        a, b, c = np.moveaxis(x[corners], 1, 0)
        n = np.cross(b - a, c - a)
        length = np.linalg.norm(n, axis=1)
        away = x[s] - np.einsum("nk,nka->na", weights, x[corners])
        height = (away * n).sum(1) / np.where(length > 0.0, length, 1.0)
        return np.linalg.norm(away, axis=1), height, (away * normal).sum(1)


def _nothing() -> Facing:
    whole, three = np.zeros(0, np.int64), np.zeros((0, 3))
    return Facing(
        rows=whole, gap=np.zeros(0), normal=three, point=three,
        carriers=np.zeros((0, 3), np.int64), weights=three,
    )  # fmt: skip


def _normals(x: Floats, mesh: SampleMesh, there: Ints) -> tuple[Floats, Floats, Floats]:
    """Unit normals (T, 3) of triangles, their angles (T, 3), unit normals (n, 3) of vertices.

    there : the vertices whose normals are wanted, and those of the triangles at them, as numbers or
    flags (n,).
    """
    some = np.zeros(len(mesh.triangles), bool)
    at = mesh.around[there]
    some[at[at >= 0]] = True
    some = np.flatnonzero(some)
    i, j, k = mesh.triangles.take(some, 0).T
    u, v, w = differences(x, i, j), differences(x, j, k), differences(x, k, i)
    n = (
        u[2] * w[1] - u[1] * w[2],
        u[0] * w[2] - u[2] * w[0],
        u[1] * w[0] - u[0] * w[1],
    )
    length = np.sqrt(dot(n, n))
    divisor = np.where(length > 0.0, length, 1.0)
    n = tuple(one / divisor for one in n)
    # tan of an angle = |cross| / dot of its two edges
    angles = [np.arctan2(length, -dot(p, q)) for p, q in ((w, u), (u, v), (v, w))]
    out = list(np.zeros((3, len(x))))
    for corner, angle in zip((i, j, k), angles):
        for axis in range(3):
            out[axis] += np.bincount(corner, angle * n[axis], minlength=len(x))
    size = np.sqrt(dot(out, out))
    vertices = np.stack(out, 1) / np.where(size > 0.0, size, 1.0)[:, None]
    faces, corners = np.zeros((2, len(mesh.triangles), 3))
    for axis in range(3):
        faces[some, axis], corners[some, axis] = n[axis], angles[axis]
    return faces, corners, vertices


def closest_weights(p: Floats, corners: Floats) -> Floats:
    """(n, 3) barycentric of the point of each triangle (n, 3, 3) closest to p (n, 3).

    By the regions of Ericson, Real-Time Collision Detection (2005), section 5.1.5.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, p - a
    bp, cp = p - b, p - c

    def dot(u: Floats, v: Floats) -> Floats:
        return np.einsum("na,na->n", u, v)

    d1, d2, d3, d4, d5, d6 = (dot(edge, away) for away in (ap, bp, cp) for edge in (ab, ac))
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    total = va + vb + vc
    total = np.where(total != 0.0, total, 1.0)
    out = np.stack([va, vb, vc], 1) / total[:, None]

    def put(where: Floats, *w: Floats | float) -> None:
        for k, value in enumerate(w):
            out[where, k] = value[where] if isinstance(value, np.ndarray) else value

    def ratio(one: Floats, other: Floats) -> Floats:
        whole = one + other
        return one / np.where(whole != 0.0, whole, 1.0)

    on_bc = (va <= 0.0) & (d4 - d3 >= 0.0) & (d5 - d6 >= 0.0)
    t = ratio(d4 - d3, d5 - d6)
    put(on_bc, 0.0, 1.0 - t, t)
    on_ac = (vb <= 0.0) & (d2 >= 0.0) & (d6 <= 0.0)
    t = ratio(d2, -d6)
    put(on_ac, 1.0 - t, 0.0, t)
    on_ab = (vc <= 0.0) & (d1 >= 0.0) & (d3 <= 0.0)
    t = ratio(d1, -d3)
    put(on_ab, 1.0 - t, t, 0.0)
    put((d6 >= 0.0) & (d5 <= d6), 0.0, 0.0, 1.0)
    put((d3 >= 0.0) & (d4 <= d3), 0.0, 1.0, 0.0)
    put((d1 <= 0.0) & (d2 <= 0.0), 1.0, 0.0, 0.0)
    return out
