"""How deep edges and corners of obstacles are in bodies, or through them.

Contact at points of obstacles (`edge_points`) supports bodies, but a spike may pierce a thin one.
From each point of a convex edge or corner a line is traced inward to the middle of the obstacle.
The depth is the distance from the point to the last place where the line leaves the body, the
distance by which the body would have to be moved. It is defined also where the point has come out
of a thin body on the other side. If the line does not leave the body, the depth is the distance
from the point to the surface. The line advances by the distance to the surface (sphere tracing;
Hart 1996). Depths at the start are subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners
from gf_usd.core.frames.frame import pierced_weight
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.detection.body_skins import PosedSkin
from gf_usd.physics.contact.distance.closest import Closest
from gf_usd.physics.contact.obstacles.obstacle import Obstacle, box_gap
from gf_usd.physics.contact.obstacles.sharp import SharpFeatures, SharpPoints, known_values

STEP = 1.0  # [spacings] between points of an edge
FIRST = 0.5  # [spacings] depth from which it is measured: less is not visible
FAR = 8.0  # [spacings] depth up to which it is measured
LEAST = 0.25  # [spacings] least advance of a line: a depth may be found to be so much less
EVERY = 6  # frames between two measurements, besides that of the last frame


@dataclass(frozen=True, kw_only=True)
class Pierced:
    """The deepest point of an obstacle in a body; none: a depth of 0."""

    depth: float = 0.0  # [m]
    body: int = -1
    obstacle: int = -1
    through: bool = False  # it has come out of the body, and so is visible

    @property
    def weight(self) -> float:
        """[m] by which it is compared with others."""
        return pierced_weight(self.depth, self.through)


class Piercing:
    """Measures obstacles in bodies.

    members : the samples of each body; spacing : [m] of the particles; rest : the surface of a body
    where the simulation begins; last : the last frame.
    """

    def __init__(
        self,
        setup: ContactSetup,
        obstacles: Sequence[Obstacle],
        members: Sequence[Ints],
        spacing: float,
        rest: Callable[[int], PosedSkin],
        last: int,
    ) -> None:
        self._last_frame = last
        self._obstacles, self._members = obstacles, members
        self._spacing, self._rest, self._setup = spacing, rest, setup
        self._features: dict[int, SharpFeatures] = {}  # of obstacles near bodies
        self._start: dict[tuple[int, int], tuple[Ints, Floats]] = {}  # keys and depths [m] there
        self._known: dict[
            int, tuple[Ints, Floats]
        ] = {}  # keys, and how far lines go into obstacles [m]
        self._last: tuple[Floats, Pierced] | None = None  # samples, and what was found

    def measured(self, x: Floats, frame: int, posed: Callable[[int], PosedSkin]) -> dict[str, Any]:
        """The fields `pierced...` of `Health`, with samples at x (n, 3) [m] at a frame.

        posed : the surface of a body.
        """
        if not self._obstacles or not frame or (frame % EVERY and frame != self._last_frame):
            return {}
        still = self._last is not None and np.array_equal(self._last[0], x)
        if self._last is None or not still or any(k.collider.moves for k in self._obstacles):
            self._last = x, self._measure(x, frame, posed)
        found = self._last[1]
        if found.obstacle < 0:
            return {"pierced": 0.0}
        skin, wall = self._setup.skins[found.body], self._obstacles[found.obstacle].collider
        return {
            "pierced": found.depth,
            "pierced_through": found.through,
            "pierced_pair": f"the obstacle <{wall.path}> is in <{skin.path}>",
        }

    def _measure(self, x: Floats, frame: float, posed: Callable[[int], PosedSkin]) -> Pierced:
        worst = Pierced()
        reach = FAR * self._spacing
        for body, m in enumerate(self._members):
            if not len(m):
                continue
            low, high = corners(x[m])
            near = [
                k
                for k, one in enumerate(self._obstacles)
                if not one.endless
                and (body, k) not in self._setup.through_colliders
                and box_gap(low - reach, high + reach, *one.box) == 0.0
                and self.sharp(k).any
            ]
            for which in near:  # before the pose: one tree is fitted to both
                self._find_start(body, which)
            if not near:
                continue
            skin = posed(body)
            for which in near:
                worst = self._deeper(worst, body, which, frame, skin)
        return worst

    def _deeper(
        self, worst: Pierced, body: int, which: int, frame: float, skin: PosedSkin
    ) -> Pierced:  # fmt: skip
        """The deepest point of one obstacle in a body, if it is deeper than `worst`."""
        key, depth, through = self._depths(which, frame, skin)
        depth = np.maximum(0.0, depth - self._at_start(body, which, key))
        found = [
            Pierced(depth=float(depth[row]), body=body, obstacle=which, through=bool(through[row]))
            for row in np.flatnonzero(2.0 * depth > worst.weight)
        ]
        return max([worst, *found], key=lambda one: one.weight)

    def sharp(self, which: int) -> SharpFeatures:
        """Edges and corners of an obstacle, found when something comes near it."""
        if which not in self._features:
            one = self._obstacles[which]
            self._features[which] = SharpFeatures(
                one.positions(0.0), one.collider.triangles, STEP * self._spacing
            )
        return self._features[which]

    def _find_start(self, body: int, which: int) -> None:
        if (body, which) not in self._start:
            key, depth, _ = self._depths(which, 0.0, self._rest(body))
            order = np.argsort(key)
            self._start[body, which] = key[order], depth[order]

    def _at_start(self, body: int, which: int, key: Ints) -> Floats:
        """(k,) [m] depths of points at the start."""
        return known_values(*self._start[body, which], key)

    def _depths(self, which: int, frame: float, skin: PosedSkin) -> tuple[Ints, Floats, Ints]:
        """Keys (k,) and depths (k,) [m] of points in a body, and which have come out of it."""
        vertices, most = self._obstacles[which].positions(frame), FAR * self._spacing
        low, high = skin.box
        points = self.sharp(which).within(vertices, low - most, high + most)
        start = points.among(vertices)
        own = _gaps(skin.closest(start, most), len(start), most)
        near = np.flatnonzero(own < most)  # no line from the others reaches the body
        points, start, own = points.of(near), start[near], own[near]
        end = self._ends(which, points, start, frame)
        way, place = np.full(len(start), FIRST * self._spacing), start.copy()
        left, ends = np.zeros(len(start)), np.zeros(len(start), bool)
        on = np.flatnonzero((way < end) & (own < end) & points.inward.any(1))
        while len(on):
            x = start[on] + way[on, None] * points.inward[on]
            gap = _gaps(skin.closest(x, most), len(on), most)
            inside, far = gap < 0.0, way[on] + np.abs(gap) >= end[on]
            place[on[inside]] = x[inside]
            left[on[inside]] = (way[on] - gap)[inside]
            way[on] += np.maximum(LEAST * self._spacing, np.abs(gap))
            over = far | (way[on] >= end[on])
            ends[on] = over & inside
            on = on[~over]
        # The side of the nearest triangle is the wrong one at a fold.
        hit, below = np.flatnonzero(left > 0.0), np.flatnonzero(own < 0.0)
        left[hit[~_within(skin, place[hit], most)]] = 0.0
        inside = np.zeros(len(start), bool)
        inside[below] = _within(skin, start[below], most)
        # A line that ends in the body does not say how deep a point in it is.
        leaves = (left > 0.0) & ~ends
        in_it = np.where(leaves, left, -own)
        depth = np.where(inside, in_it, np.where(leaves, left, np.where(left > 0.0, end, 0.0)))
        pierced = np.flatnonzero(depth > 0.0)
        return points.key[pierced], depth[pierced], ~inside[pierced]

    def _ends(self, which: int, points: SharpPoints, start: Floats, frame: float) -> Floats:
        """(k,) [m] how far lines go into the obstacle from points at start (k, 3) [m]."""
        obstacle = self._obstacles[which]
        if obstacle.collider.deformed is not None:
            return self._into(obstacle, start, points.inward, frame)
        known, ends = self._known.get(which, (np.zeros(0, np.int64), np.zeros(0)))
        new = ~np.isin(points.key, known)
        if new.any():
            found = self._into(obstacle, start[new], points.inward[new], frame)
            known, ends = np.append(known, points.key[new]), np.append(ends, found)
            order = np.argsort(known)
            known, ends = self._known[which] = known[order], ends[order]
        return ends[np.searchsorted(known, points.key)]

    def _into(self, obstacle: Obstacle, start: Floats, inward: Floats, frame: float) -> Floats:
        """(k,) [m] half the length of lines in an obstacle, at most FAR spacings: beyond the middle
        they would find what presses on another side of it.
        """
        most, least = FAR * self._spacing, LEAST * self._spacing
        way, on = np.full(len(start), least), np.arange(len(start))
        while len(on):
            x = start[on] + way[on, None] * inward[on]
            gap = _gaps(obstacle.planes(x, most, frame, 0.0).seen, len(on), -most)
            on, gap = on[gap < 0.0], gap[gap < 0.0]
            way[on] += np.maximum(least, -gap)
            on = on[way[on] < 2.0 * most]
        return np.minimum(0.5 * way, most)


def _within(skin: PosedSkin, X: Floats, reach: float) -> Ints:
    """(n,) whether points X (n, 3) [m] are in a body, by the winding number."""
    seen = skin.closest(X, reach)
    seen = skin.corrected(seen, np.flatnonzero(seen.gap < 0.0), X)
    out = np.zeros(len(X), bool)
    out[seen.rows] = seen.gap < 0.0
    return out


def _gaps(seen: Closest, count: int, away: float) -> Floats:
    """(count,) [m] signed distances; `away` where nothing is within reach."""
    out = np.full(count, away)
    out[seen.rows] = seen.gap
    return out
