"""Narrow phase: which of the nearby surfaces a contact sample is in contact with.

Between two detections no sample moves by more than half a spacing relative to another body, so that
a surface is known before the sample is deep. A sample gets the plane of the obstacle or body in
which it is deepest, or to which it is nearest.
"""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners, gather
from gf_usd.physics.contact.detection.body_skins import BodySkins
from gf_usd.physics.contact.planes.contact_planes import (
    ARRAYS,
    NOBODY,
    OBSTACLE,
    ContactPlanes,
    nothing,
)
from gf_usd.physics.contact.planes.support_triangles import NEAR, choose_support_triangles

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
