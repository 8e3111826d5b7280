"""Gaps between the surfaces of a scene at rest, from which contact is measured.

Contact springs act from an offset in front of a surface, by which they yield under a resting load.
Where two surfaces are nearer than that at rest the offset is their gap there, below 0 where they
overlap: nothing is pushed at the start, and what overlaps is pushed once it is deeper.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.distance.closest import closest
from gf_usd.physics.contact.obstacles.edge_points import EdgePoints
from gf_usd.physics.contact.obstacles.obstacle import Obstacle
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes
from gf_usd.physics.contact.self_contact.search import SelfContact

# [spacings] offset in front of another body: as much as springs yield under what rests on them, so
# that surfaces that are pressed together do not overlap.
APART = 0.15


class RestGaps:
    """Offsets of contact samples from opposite surfaces, each computed when it is first needed.

    X : (n, 3) [m] samples at rest; body : (n,) the body of each; reach : [m] within
    which contact is searched; lift : (3,) [m] from rest to the initial position; edges : points of
    obstacles, which have offsets of their own.
    """

    def __init__(
        self,
        X: Floats,
        body: Ints,
        contact_setup: ContactSetup,
        obstacles: Sequence[Obstacle],
        own: Mapping[int, SelfContact],
        *,
        spacing: float,
        reach: float,
        lift: Floats,
        edges: EdgePoints,
    ) -> None:
        self._edges = edges
        self._X, self._body, self._contact_setup, self._own = X, body, contact_setup, own
        self._members = [np.flatnonzero(body == k) for k in range(len(contact_setup.skins))]
        self._index = np.zeros(len(body), np.int64)  # of each sample within its body
        for m in self._members:
            self._index[m] = np.arange(len(m))
        self._obstacles, self._reach, self._lift = obstacles, reach, lift
        self._most = APART * spacing
        self._between: dict[tuple[int, int], Floats] = {}
        self._from_obstacle: dict[int, Floats] = {}
        self._last: tuple[Ints, Floats] | None = None  # partners, and their offsets

    def of_planes(self, planes: ContactPlanes) -> Floats:
        """(n + m,) [m] offset of each sample and point of an obstacle from its plane; 0 where it
        has none.
        """
        partner, obstacle = planes.partner, planes.obstacle[: len(self._body)]
        # Planes that only move keep their partners, and this array of them.
        if self._last is not None and self._last[0] is partner:
            return self._last[1]
        out = np.zeros(len(partner))
        n = len(self._body)
        out[n:] = np.where(partner[n:] >= 0, self._edges.start_gap, 0.0)
        rows = planes.on_bodies
        rows = rows[rows < n]
        out[rows] = self.from_bodies(rows, self._body[partner[rows]])
        for which in np.unique(obstacle[obstacle >= 0]):
            rows = np.flatnonzero(obstacle == which)
            out[rows] = self.from_obstacle(int(which))[rows]
        self._last = partner, out
        return out

    def forget_planes(self) -> None:
        """Planes were changed in place: their partners are read again."""
        self._last = None

    def from_bodies(self, rows: Ints, others: Ints) -> Floats:
        """(k,) [m] offset of samples `rows` (k,) from bodies (k,), which may be their own."""
        out = np.zeros(len(rows))
        count = len(self._members)
        pair = self._body[rows] * count + others
        order = np.argsort(pair, kind="stable")
        found, first = np.unique(pair[order], return_index=True)
        for one, mine in zip(found.tolist(), np.split(order, first[1:])):
            out[mine] = self._pair(*divmod(one, count))[self._index[rows[mine]]]
        return out

    def _pair(self, body: int, other: int) -> Floats:
        """(m,) [m] offset of all samples of one body from another, or from itself."""
        if body == other:
            return self._own[body].offset
        if (body, other) not in self._between:
            X, skin = self._X[self._members[body]], self._contact_setup.skins[other]
            gap = np.full(len(X), self._most)
            if not self._contact_setup.meet_from:
                seen = closest(X, skin.points, skin.triangles, self._reach)
                gap[seen.rows] = np.minimum(seen.gap, self._most)
            self._between[body, other] = gap
        return self._between[body, other]

    def from_obstacle(self, which: int) -> Floats:
        """(n,) [m] <= 0: depth, negative, of samples that are inside an obstacle at the start.

        A spring that begins deep would expel what the asset has there.
        """
        if which not in self._from_obstacle:
            seen = self._obstacles[which].planes(self._X + self._lift, self._reach, 0.0, 0.0).seen
            found = self._from_obstacle[which] = np.zeros(len(self._X))
            found[seen.rows] = np.minimum(seen.gap, 0.0)
        return self._from_obstacle[which]
