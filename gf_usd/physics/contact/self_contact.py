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

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.core.stage import Skin
from gf_usd.physics.contact.broad_phase import Judged, Patches, closing, differences, dot
from gf_usd.physics.contact.distance.closest import (
    FOUND,
    LEAST,
    PSEUDO,
    SEED,
    TIES,
    TRIANGLE,
    WEIGHTS,
    WHICH,
)
from gf_usd.physics.contact.sample_mesh import Neighbors, SampleMesh, triangulate
from gf_usd.system.taichi_runtime import ensure_running

HOPS = 4  # edges of the sample mesh, from where on a body meets itself
THICK = 4.0  # [spacings] that two sides of a limb are apart which never meet each other
SEE = 2.0  # [spacings] radius of the ball in which a sample looks ahead: it sees twice as far
STEP = 0.75  # [spacings] that a sample moves between two detections at most, against what is near
ASIDE = 0.5  # cosine of a sample's normal with those of triangles next to what it faces
TURN = 3.0  # [spacings] that a normal turned by a radian is as far as
# [spacings] from a sample to what it may face: as far as two normals that are alike let it look.
WIDEST = float(np.hypot(2.0 * SEE, 2.0**0.5 * TURN))
CELLS = 8  # of the grid in which samples are found, for each of them at most
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
        looks = np.ones(len(x), bool) if judged is None else self._patches.around(judged, known)
        s = self._spacing
        found, which = self._faced(x, looks, known, reach + s)
        rows = np.flatnonzero(which[:, SEED] >= 0)
        seeds = which[rows, SEED]
        distance = lengths(x[rows] - x[seeds])
        until = (distance - CLEAR * s) / np.maximum(AHEAD * lengths(v[rows] - v[seeds]), 1e-30)
        hold = float(until[distance >= reach + s].min(initial=np.inf))
        rows = rows[which[rows, TRIANGLE] >= 0]
        rows = rows[found[rows, LEAST] < reach]
        if not len(rows):
            return replace(_nothing(), hold=hold)
        return replace(self._sided(rows, found[rows], which[rows], x, before, gap), hold=hold)

    def _faced(self, x: Floats, looks: Ints, known: Ints, reach: float) -> tuple[Floats, Ints]:
        """(n, 10), (n, 3) what each sample that is `known`, or that looks and sees something ahead
        that is not near at rest, faces: of `faced_kernels.find_faced`.

        looks, known : (n,); reach : [m] to the nearest sample that it faces.
        """
        ensure_running()
        from gf_usd.physics.contact.distance.faced_kernels import find_faced

        mesh, neighbors = self._mesh
        s, n = self._spacing, len(x)
        x = np.ascontiguousarray(x, np.float64)
        low, extent, edge = x.min(0), np.ptp(x, axis=0), SEE * s
        while (size := np.floor(extent / edge) + 1.0).prod() > CELLS * n:
            edge *= 2.0
        size = size.astype(int)
        flags = np.stack([looks, known], 1).astype(np.int32)
        found, which = np.empty((n, FOUND)), np.empty((n, WHICH), np.int32)
        find_faced(
            x, mesh.triangles, mesh.around, neighbors.lists, flags,
            np.empty(size.prod() + 1 + 2 * n, np.int32), np.empty((len(mesh.triangles), 6)),
            found, which, low, edge, size, SEE * s, TURN * s, WIDEST * s, reach, ASIDE, 1e-6 * s,
            1.0 - 1e-9,
        )  # fmt: skip
        return found, which

    def _sided(
        self, rows: Ints, found: Floats, which: Ints, x: Floats, before: Floats, gap: Floats
    ) -> Facing:
        """The places found (k, 10), which (k, 3) of rows (k,), with their signs, where these are
        believed."""
        mesh, neighbors = self._mesh
        s, corners = rows, mesh.triangles[which[:, TRIANGLE]]
        weights, pseudo = found[:, WEIGHTS:PSEUDO], found[:, PSEUDO:LEAST]
        least, seen = found[:, LEAST], which[:, TIES]
        q = np.einsum("nk,nka->na", weights, x[corners])
        away = x[s] - q
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
        keep = ~rim & believed
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
