"""The search of near pairs: the planes of bodies and obstacles that samples near them may face."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.detection.body_skins import BodySkins
from gf_usd.physics.contact.detection.narrow_phase import ContactSearch
from gf_usd.physics.contact.distance.first_overlaps import FirstOverlaps
from gf_usd.physics.contact.obstacles.edge_points import EdgePoints
from gf_usd.physics.contact.obstacles.edge_search import ABOUT
from gf_usd.physics.contact.obstacles.obstacle import Obstacle
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes
from gf_usd.physics.contact.planes.continuity import EASE
from gf_usd.physics.contact.planes.rest_gaps import RestGaps
from gf_usd.physics.contact.samples import MovingSamples
from gf_usd.physics.total_lagrangian.state import StateView


class PairSearch:
    """Offers planes of the surfaces of bodies and obstacles to the samples near them.

    edges : contact of the edges of obstacles; None: they have none.
    rest_gaps : by which planes are moved; overlaps : pairs that do not meet yet.
    spacing : [m] of the samples; frame_time : [s].
    """

    def __init__(
        self,
        samples: MovingSamples,
        skins: BodySkins,
        obstacles: Sequence[Obstacle],
        edges: EdgePoints | None,
        rest_gaps: RestGaps,
        overlaps: FirstOverlaps,
        *,
        spacing: float,
        frame_time: float,
    ) -> None:
        self._of, self._members = samples.of, samples.members
        self._skins, self._obstacles, self._edges = skins, obstacles, edges
        self._rest_gaps, self._overlaps = rest_gaps, overlaps
        self._spacing, self._frame_time = spacing, frame_time

    def bodies(
        self,
        search: ContactSearch,
        searched: Mapping[int, Sequence[int]],
        now: StateView,
        planes: ContactPlanes,
        gap: Floats,
    ) -> None:
        """Offer planes of the surfaces of bodies to samples of those that are near each of them.

        All at once: every surface is posed and its tree is refitted only once.

        searched : the bodies near each body; planes, gap : (n + m,) [m] of the last detection.
        """
        asked = [
            search.candidates(
                np.concatenate([self._members[k] for k in searched[other]]),
                search.x[self._members[other]],
            )
            for other in sorted(searched)
        ]
        if not sum(map(len, asked)):
            return
        rows, others = np.concatenate(asked), np.repeat(sorted(searched), list(map(len, asked)))
        meets = self._overlaps.apart(rows, others)
        rows, others = rows[meets], others[meets]
        # A sample that was inside this body at the last detection still is.  One that newly seems
        # to be inside may be behind a fold, and the winding number decides.
        before, faced = gap[rows], planes.partner[rows]
        was = (before < 0.0) & (faced >= 0) & (self._of[faced] == others)
        known = np.where(was, before - EASE * self._spacing, 0.0)
        found, rest = self._skins.near(
            rows, search.x[rows], known, others, now.nodes[0], now.offset, search.reach
        )
        mine, theirs = rows[found.rows], others[found.rows]
        point = found.point + self._rest_gaps.from_bodies(mine, theirs)[:, None] * found.normal
        search.offer_places(mine, found.gap, found.normal, point, theirs, rest)

    def obstacle(
        self,
        search: ContactSearch,
        bodies: Sequence[int],
        which: int,
        now: StateView,
        planes: ContactPlanes,
        gap: Floats,
        frame: float,
        span: float,
    ) -> None:
        """Offer planes of one obstacle to samples of `bodies`, and theirs to its edges.

        planes, gap : (n + m,) [m] of the last detection; frame : where the obstacle is; span : [s]
        for which the planes hold.
        """
        rows = np.concatenate([self._members[k] for k in bodies])
        sunk = self._rest_gaps.from_obstacle(which)
        plane = self._obstacles[which].planes(search.x[rows], search.reach, frame, span, rows)
        found, mine = plane.seen, rows[plane.seen.rows]
        point = found.point + sunk[mine, None] * found.normal
        search.offer(mine, found.gap, found.normal, point, velocity=plane.velocity, obstacle=which)
        near = mine[found.gap < ABOUT * self._spacing]
        if self._edges is None:
            return
        self._edges.search(
            search, which,
            {body: near[self._of[near] == body] for body in np.unique(self._of[near]).tolist()},
            lambda body: partial(
                self._skins[body].near, u=now.nodes[0], offset=now.offset, reach=search.reach
            ),
            planes, gap, frame, span / self._frame_time,
        )  # fmt: skip
