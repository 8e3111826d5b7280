"""Points of edges and corners of obstacles that are near bodies, and the opposite places there.

The body's normal is opposite to the direction into the obstacle. A force on an edge has no
component along it: the normal at a point of an edge is the body's without that component, and a
surface whose normal is along the edge is not in contact with it. Once a point has passed the middle
of a thin body, the nearest place is on the other side of the body: the search for such a point
begins further back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners, lengths, row_dots
from gf_usd.core.neighbors import kd_tree
from gf_usd.physics.contact.detection.body_skins import PosedSkin
from gf_usd.physics.contact.distance.closest import Closest
from gf_usd.physics.contact.obstacles.obstacle import Obstacle
from gf_usd.physics.contact.obstacles.piercing import FAR
from gf_usd.physics.contact.obstacles.sharp import SharpFeatures, SharpPoints, known_values

NEAR = 1.0  # [spacings] from a surface, within which a point has a plane
# [spacings] from a point to the nearest sample of a surface within NEAR of it, which is itself near
# the obstacle: the surface of a sample has a radius of .6
ABOUT = 1.75
FACING = 0.2  # least cosine of the outward normal of a body and the direction into the obstacle
ACROSS = 0.5  # least share of a normal that is not along an edge
BACK = 0.75  # [spacings] behind a point that has come past the middle of a body
# [spacings] by which a point may be to the side of the place where it entered a body
STAY = 1.0
OBSTACLE_KEYS = 1 << 40  # more than an obstacle has points

Near = Callable[[Floats, Floats], tuple[Closest, Floats]]


@dataclass(frozen=True, kw_only=True)
class EdgeContacts:
    """k points of obstacles, and the opposite places of bodies."""

    key: Ints  # (k,) number of the point among those of all obstacles
    obstacle: Ints  # (k,)
    body: Ints  # (k,)
    x: Floats  # (k, 3) [m] of the point
    v: Floats  # (k, 3) [m/s]
    depth: Floats  # (k,) [m] in the body, negative outside
    start_gap: Floats  # (k,) [m] <= 0: the depth, negative, at the start
    normal: Floats  # (k, 3) outward unit normal of the body
    point: Floats  # (k, 3) [m] the place
    rest: Floats  # (k, 3) [m] the same at rest

    def of(self, rows: Ints) -> EdgeContacts:
        """Some of them."""
        return EdgeContacts(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @classmethod
    def joined(cls, parts: Sequence[EdgeContacts]) -> EdgeContacts:
        """All of some."""
        return cls(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)}
        )


class EdgeSearch:
    """Finds the points of obstacles near bodies.

    features : edges of an obstacle; rest : the surface of a body where the simulation begins;
    spacing : [m].
    """

    def __init__(
        self, obstacles: Sequence[Obstacle], features: Callable[[int], SharpFeatures],
        rest: Callable[[int], PosedSkin], spacing: float,
    ) -> None:  # fmt: skip
        self._obstacles, self._features = obstacles, features
        self._rest, self._spacing = rest, spacing
        self._start: dict[tuple[int, int], tuple[Ints, Floats]] = {}  # keys, and `start_gap`
        self._all: dict[
            int, tuple[SharpPoints, Floats]
        ] = {}  # points of obstacles that do not move

    def near(
        self, about: Sequence[Floats], which: int, frame: float
    ) -> list[tuple[Ints, SharpPoints, Floats]]:
        """Keys (k,) of points of an obstacle within ABOUT of places about[i] (n, 3) [m], the points
        and where they are (k, 3) [m] at a frame; for each i.
        """
        if not about:
            return []
        margin = ABOUT * self._spacing
        boxes = [corners(places) for places in about]
        low = np.min([box[0] for box in boxes], axis=0) - margin
        high = np.max([box[1] for box in boxes], axis=0) + margin
        points, x = self._within(which, low, high, frame)
        found = []
        for places, (first, last) in zip(about, boxes):
            close = np.flatnonzero(((x >= first - margin) & (x <= last + margin)).all(1))
            if len(close):
                distance = kd_tree(places).query(x[close], 1, distance_upper_bound=margin)[0]
                close = close[np.isfinite(distance)]
            some = points.of(close)
            found.append((which * OBSTACLE_KEYS + some.key, some, x[close]))
        return found

    def _within(
        self, which: int, low: Floats, high: Floats, frame: float
    ) -> tuple[SharpPoints, Floats]:
        """Points of an obstacle in a box with corners (3,) [m], and where they are (k, 3) [m]."""
        obstacle, features = self._obstacles[which], self._features(which)
        if obstacle.collider.moves:
            vertices = obstacle.positions(frame)
            points = features.within(vertices, low, high)
            return points, points.among(vertices)
        if which not in self._all:
            vertices, end = obstacle.positions(0.0), np.full(3, np.inf)
            points = features.within(vertices, -end, end)
            self._all[which] = points, points.among(vertices)
        points, x = self._all[which]
        inside = np.flatnonzero(((x >= low) & (x <= high)).all(1))
        return points.of(inside), x[inside]

    def contacts(
        self, body: int, which: int, found: tuple[Ints, SharpPoints, Floats], known: Floats,
        had: Ints, near: Near, frame: float, ahead: float,
    ) -> EdgeContacts:  # fmt: skip
        """Those of the points found, see `near`, that a body faces.

        known, near : see `BodySkin.near`, its smallest plausible distances and itself; had : (n,)
        points that had a plane; ahead : [frames] of the motion that gives their velocity.
        """
        keys, points, x = found
        obstacle = self._obstacles[which]
        along = _along(points, obstacle.positions(frame))
        rows, normal, point, rest = self._faced(x, points.inward, along, known, had, near)
        v = np.zeros((len(rows), 3))
        if obstacle.collider.moves and ahead > 0.0:
            later = points.among(obstacle.positions(frame + ahead))
            v = (later - x)[rows] / (ahead * obstacle.frame_time)
        return EdgeContacts(
            key=keys[rows],
            obstacle=np.full(len(rows), which),
            body=np.full(len(rows), body),
            x=x[rows],
            v=v,
            depth=row_dots(point - x[rows], normal),
            start_gap=self._at_start(body, which, keys[rows]),
            normal=normal,
            point=point,
            rest=rest,
        )

    def _faced(
        self, x: Floats, inward: Floats, along: Floats, known: Floats, had: Ints, near: Near
    ) -> tuple[Ints, Floats, Floats, Floats]:
        """Points (k,) of x (n, 3) [m] near a surface that faces their obstacle: its outward normals
        (k, 3), places (k, 3) [m], and these at rest.

        inward, along : (n, 3) directions into the obstacle, and along the edge of a point.
        """
        s = self._spacing
        seen, rest = near(x, known)
        normal, faces = _across(seen.normal, along[seen.rows], inward[seen.rows])
        at = np.flatnonzero(faces & (seen.gap < NEAR * s))
        found = [(seen.rows[at], normal[at], seen.point[at], rest[at])]
        past = seen.rows[row_dots(seen.normal, inward[seen.rows]) <= FACING]
        past = past[had[past]]
        if len(past):
            seen, rest = near(x[past] + BACK * s * inward[past], np.zeros(len(past)))
            rows = past[seen.rows]
            normal, faces = _across(seen.normal, along[rows], inward[rows])
            way = seen.point - x[rows]
            depth = row_dots(way, normal)
            aside = lengths(way - depth[:, None] * normal)
            at = np.flatnonzero(faces & (depth > 0.0) & (aside < STAY * s))
            found.append((rows[at], normal[at], seen.point[at], rest[at]))
        rows, normal, point, rest = (np.concatenate(parts) for parts in zip(*found))
        return rows, normal, point, rest

    def _at_start(self, body: int, which: int, keys: Ints) -> Floats:
        """(k,) [m] <= 0: depth, negative, of points in a body at the start.

        A spring that begins deep would throw the body away.
        """
        if (body, which) not in self._start:
            skin, reach = self._rest(body), FAR * self._spacing
            points, x = self._within(which, *skin.box, 0.0)
            seen = skin.closest(x, reach)
            seen = skin.corrected(seen, np.flatnonzero(seen.gap < 0.0), x)
            some = seen.gap < 0.0
            known = which * OBSTACLE_KEYS + points.key[seen.rows[some]]
            order = np.argsort(known)
            self._start[body, which] = known[order], seen.gap[some][order]
        return known_values(*self._start[body, which], keys)


def _along(points: SharpPoints, vertices: Floats) -> Floats:
    """(k, 3) unit directions of the edges of points; 0 at corners."""
    way = vertices[points.ends[:, 1]] - vertices[points.ends[:, 0]]
    size = lengths(way)
    return way / np.where(size > 0.0, size, 1.0)[:, None]


def _across(normal: Floats, along: Floats, inward: Floats) -> tuple[Floats, Ints]:
    """(k, 3) unit normals without their component along edges, and which (k,) face an obstacle."""
    across = normal - row_dots(normal, along)[:, None] * along
    size = lengths(across)
    faces = (size > ACROSS) & (row_dots(normal, inward) > FACING)
    return across / np.where(size > 0.0, size, 1.0)[:, None], faces
