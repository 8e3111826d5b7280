"""Self-contact: which parts of a body's own surface its contact samples face.

The broad phase compares patches of the surface (`patches`).  For the pairs of patches that may meet
first, pairs of samples are compared, because most patches that are near have no samples that are.

The narrow phase uses the triangles of the `SampleMesh`.  From each sample a ball that touches the
surface from outside is searched for samples that are not near it at rest.  Where there is one, and
where the sample faced something at the last detection, the closest point on the triangles that face
it, and are not near it at rest, is computed.  The sign of the distance is that of the
angle-weighted pseudo-normal (Baerentzen and Aanaes 2005).  This sign alone cannot distinguish a
sample that passed through a surface from one that lies behind it anyway, for example on the other
side of the same limb.  A sample is therefore inside only if it was inside, or was on the outer side
of the same place, at the last detection.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.stage import Skin
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
from gf_usd.physics.contact.self_contact.patches import (
    Patches,
    PatchPairs,
    closing,
    differences,
    dot,
)
from gf_usd.physics.contact.self_contact.sample_mesh import Neighbors, SampleMesh, triangulate
from gf_usd.system.taichi_runtime import ensure_running

HOPS = 4  # edges of the sample mesh: samples that are not farther apart are not in contact
THICK = 4.0  # [spacings] thickness of a limb up to which its two sides are not in contact
SEE = 2.0  # [spacings] radius of the search ball in front of a sample, which reaches twice as far
STEP = 0.75  # [spacings] most that a sample moves between two detections, against what is near
ASIDE = 0.5  # cosine between a sample's normal and those of triangles next to its opposite surface
NO_SIDE = 1e-6  # of the length of a pseudo-normal: below it the normals of its faces cancel
TURN = 3.0  # [spacings] distance that an angle of a radian between normals counts as
# [spacings] largest distance from a sample to what it may face, by the search ball and by TURN.
WIDEST = float(np.hypot(2.0 * SEE, 2.0**0.5 * TURN))
CELLS = 8  # of the grid in which samples are found, for each of them at most
AHEAD = 1.5  # factor by which speeds may grow until the next detection
FEW = 8_000  # pairs of samples that are compared
CLEAR = 0.75  # [spacings] gap at which surfaces that were farther away are searched again
FACE = 2.0  # [spacings] gap below which a sample faces a place
SAME = 0.25  # [spacings] tolerance of the depth by which a place is the one of the last detection
NEARLY = 0.25  # [spacings] gap below which a sample is about to touch
OFFSET = 0.3  # [spacings] offset in front of a body's own surface at which its springs begin


@dataclass(frozen=True, kw_only=True)
class Facing:
    """Samples of a body and the places of its own surface that they face."""

    rows: Ints  # (k,) samples, numbered within the body
    gap: Floats  # (k,) [m], negative inside
    normal: Floats  # (k, 3) outward unit normal of the place
    point: Floats  # (k, 3) [m] the place
    carriers: Ints  # (k, 3) corners of its triangle, samples of the body
    weights: Floats  # (k, 3) barycentric
    hold: float = float("inf")  # [s] until a place found beyond the reach may come within it
    # [m] from a sample to the nearest opposite place or sample that was found, whether or not it
    # is certain that the sample faces it
    nearest: float = float("inf")


class SelfContact:
    """Detects contact of one body with itself.

    skin : its surface at rest; X, normal : (n, 3) samples at rest; spacing : [m].
    """

    def __init__(self, skin: Skin, X: Floats, normal: Floats, spacing: float) -> None:
        self._skin, self._X, self._normal, self._spacing = skin, X, normal, spacing
        self._patches = Patches(X, normal, spacing, see=2.0 * SEE, thick=THICK)
        self._made: tuple[SampleMesh, Neighbors] | None = None
        self._offset: Floats | None = None

    @property
    def _mesh(self) -> tuple[SampleMesh, Neighbors]:
        """Triangles of the samples and their neighbors; built when patches first come near."""
        if self._made is None:
            mesh = triangulate(self._skin, self._X, self._spacing)
            far = THICK * self._spacing
            self._made = mesh, Neighbors(mesh, self._X, self._normal, HOPS, far)
        return self._made

    @property
    def offset(self) -> Floats:
        """(n,) [m] gap to its own surface at which the spring of each sample begins.

        At most the gap at rest, which is found with the reach of a detection: a place that only
        a detection found at rest would push from the start.
        """
        if self._offset is None:
            most, still = OFFSET * self._spacing, np.zeros_like(self._X)
            reach, never = FACE * self._spacing, np.full(len(self._X), np.inf)
            seen = self.find(self._X, still, reach, self._X, never)
            self._offset = np.full(len(self._X), most)
            self._offset[seen.rows] = np.clip(seen.gap, 0.0, most)
        return self._offset

    def broad_phase(
        self, x: Floats, v: Floats, span: float = np.inf
    ) -> tuple[PatchPairs | None, float]:
        """Pairs of patches, None if none is near; and for how long [s] that is all.

        x, v : (n, 3) [m], [m/s] of the samples; span : [s] after which a detection is made anyway.
        """
        patches = self._patches
        patch_pairs = patches.pairs(x, v)
        # Bounds beyond this, or beyond those of pairs that are not compared by samples, would not
        # lengthen the result.
        span = min(span, patch_pairs.fold)
        until = patches.unseen(patch_pairs, x, v, span, CLEAR * self._spacing)
        few = patches.soonest(until, span, FEW)
        if len(few):
            others = np.delete(until, few)
            least = min(span, float(others.min(initial=np.inf)))
            until[few] = np.maximum(until[few], self._until_samples_meet(few, x, v, least))
        hold = min(patch_pairs.fold, float(until.min(initial=np.inf)))
        return patch_pairs if patch_pairs.near.any() else None, hold

    def _until_samples_meet(self, pairs: Ints, x: Floats, v: Floats, least: float) -> Floats:
        """(k,) [s] until samples of pairs (k,) of patches may touch that do not yet.

        least : [s] beyond which the exact time does not matter.
        """
        i, j, start = self._patches.samples(pairs)
        away, relative = differences(x, i, j), differences(v, i, j)
        distance = np.sqrt(dot(away, away))
        # Samples that touch may slide by as much.
        left = np.maximum(distance - CLEAR * self._spacing, CLEAR * self._spacing)
        until = left / np.maximum(closing(away, distance, relative), 1e-30)
        if self._patches.adjacent[pairs].any():
            soon = np.flatnonzero(until < least)
            until[soon[self._mesh[1].near(i[soon], j[soon])]] = np.inf
        return np.minimum.reduceat(until, start)

    def imminent(self, x: Floats, v: Floats, span: float, before: Floats, gap: Floats) -> bool:
        """Whether a sample may touch its own body within a span [s]; before, gap : as in `find`."""
        patch_pairs, hold = self.broad_phase(x, v, span)
        if patch_pairs is None:
            return hold < span
        found = self.find(x, v, 2.0 * SEE * self._spacing, before, gap, patch_pairs)
        theirs = np.einsum("nk,nka->na", found.weights, v[found.carriers])
        closing = -((v[found.rows] - theirs) * found.normal).sum(1)
        away = found.gap - self.offset[found.rows]
        left = away - AHEAD * span * np.maximum(closing, 0.0)
        return bool((left < NEARLY * self._spacing).any())

    def find(
        self, x: Floats, v: Floats, reach: float, before: Floats, gap: Floats,
        patch_pairs: PatchPairs | None = None,
    ) -> Facing:  # fmt: skip
        """Places of the body's own surface that samples face within a reach [m].

        x, before : (n, 3) [m] samples now and at the last detection; v : (n, 3) [m/s];
        gap : (n,) [m] found at the last detection; patch_pairs : of `broad_phase`, the search is
        made from samples of patches that are near, and of those that faced something; None: from
        all samples.
        """
        mesh = self._mesh[0]
        if len(mesh.triangles) == 0:
            return _nothing()
        known = gap < reach
        searching = (
            np.ones(len(x), bool)
            if patch_pairs is None
            else self._patches.samples_near(patch_pairs, known)
        )
        s = self._spacing
        found, which = self._closest(x, searching, known, reach + s)
        rows = np.flatnonzero(which[:, SEED] >= 0)
        seeds, placed = which[rows, SEED], which[rows, TRIANGLE] >= 0
        away, relative = differences(x, rows, seeds), differences(v, rows, seeds)
        distance = np.sqrt(dot(away, away))
        rate = np.maximum(closing(away, distance, relative), 1e-30)
        least = np.where(placed, found[rows, LEAST], distance)
        faced = placed & (least < reach)
        later = ~faced & (placed | (distance >= reach + s))
        hold = float(((least - CLEAR * s) / rate)[later].min(initial=np.inf))
        nearest = float(least.min(initial=np.inf))
        rows = rows[faced]
        seen = (
            self._sided(rows, found[rows], which[rows], x, before, gap) if len(rows) else _nothing()
        )
        return replace(seen, hold=hold, nearest=nearest)

    def _closest(
        self, x: Floats, searching: Ints, known: Ints, reach: float
    ) -> tuple[Floats, Ints]:
        """(n, 10), (n, 3) closest places, the results of `search_kernels.find_opposite`.

        searching : (n,) samples that search in front of them for samples that are not near at rest;
        known : (n,) samples that faced something and get a closest place in any case; reach : [m]
        to the nearest sample that is faced.
        """
        ensure_running()
        from gf_usd.physics.contact.self_contact.search_kernels import find_opposite

        mesh, neighbors = self._mesh
        s, n = self._spacing, len(x)
        x = np.ascontiguousarray(x, np.float64)
        low, extent, edge = x.min(0), np.ptp(x, axis=0), SEE * s
        while (size := np.floor(extent / edge) + 1.0).prod() > CELLS * n:
            edge *= 2.0
        size = size.astype(int)
        flags = np.stack([searching, known], 1).astype(np.int32)
        found, which = np.empty((n, FOUND)), np.empty((n, WHICH), np.int32)
        find_opposite(
            x, mesh.triangles, mesh.around, neighbors.lists, flags,
            np.empty(size.prod() + 1 + 2 * n, np.int32), np.empty((n, 6)),
            np.empty((len(mesh.triangles), 6)),
            found, which, low, edge, size, SEE * s, TURN * s, WIDEST * s, reach, ASIDE, 1e-6 * s,
            1.0 - 1e-9,
        )  # fmt: skip
        return found, which

    def _sided(
        self, rows: Ints, found: Floats, which: Ints, x: Floats, before: Floats, gap: Floats
    ) -> Facing:
        """The places found (k, 10), which (k, 3) of samples `rows` (k,) whose sign is certain."""
        mesh, neighbors = self._mesh
        s, corners = rows, mesh.triangles[which[:, TRIANGLE]]
        weights, pseudo = found[:, WEIGHTS:PSEUDO], found[:, PSEUDO:LEAST]
        least, seen = found[:, LEAST], which[:, TIES]
        q = np.einsum("nk,nka->na", weights, x[corners])
        away = x[s] - q
        side = np.where((away * pseudo).sum(1) < 0.0, -1.0, 1.0)
        now = side * least
        # Triangles near the sample at rest are left out: at their rim the closest place may be one
        # that was left out.
        rim = (neighbors.rim(s[:, None], corners) & (weights > 0.0)).any(1)
        rim &= weights.min(1) <= 0.0
        # At an edge or a corner where not all triangles face the sample, the surface that it faces
        # ends: a sample behind that is not inside.
        free = (weights > 1e-9).sum(1)
        degree = (mesh.around[corners[np.arange(len(s)), weights.argmax(1)]] >= 0).sum(1)
        ends = seen < np.select([free == 3, free == 2], [1, 2], degree)
        rim |= ends & (now < 0.0)
        length = np.linalg.norm(pseudo, axis=1)
        on = least <= 1e-6 * self._spacing
        # On the common place of faces that look in opposite directions, as those of a double-sided
        # sheet or of an edge where two boxes meet, no side is the outer one.
        between = on & (length <= NO_SIDE)
        pseudo /= np.maximum(length, 1e-30)[:, None]
        n = np.where(
            on[:, None], pseudo, away * (side / np.where(least > 0.0, least, 1.0))[:, None]
        )
        came, height, along = self._distances(before, s, corners, weights, n)
        # A sample that is inside by one place and behind another is not inside by that one, too.
        same = (gap[s] < 0.0) & (height >= gap[s] - SAME * self._spacing)
        # At a sharp fold a sample is on the outer side of one triangle and inside by the others: if
        # it was as far behind those before, it did not pass through.
        outer = (gap[s] >= 0.0) & (height >= 0.0) & (along >= 0.0)
        was = np.where(same, gap[s], np.where(outer, came, np.inf))
        believed = (now >= 0.0) | (now >= was - STEP * self._spacing) & (was < STEP * self._spacing)
        keep = ~rim & believed & ~between
        return Facing(
            rows=s[keep], gap=now[keep], normal=n[keep], point=q[keep],
            carriers=corners[keep], weights=weights[keep],
        )  # fmt: skip

    @staticmethod
    def _distances(
        x: Floats, s: Ints, corners: Ints, weights: Floats, normal: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """[m] distances of samples s (k,) from places on triangles `corners` (k, 3), their heights
        above the triangles, and along normals (k, 3)."""
        a, b, c = np.moveaxis(x[corners], 1, 0)
        n = cross(b - a, c - a)
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
