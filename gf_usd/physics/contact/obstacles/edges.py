"""Contact of edges and corners of obstacles with bodies, at points of the obstacles.

Contact samples of a body are a spacing apart, and an edge or a corner could come in between them. A
point of a convex edge or corner (`sharp`) near a body is therefore a contact sample of its own,
which the obstacle moves, in front of a plane of the body: the kernels treat it as any other sample
(`kernels.pair_contact`), with the stiffness of the surface that it presses, but no node feels the
force on it.

The body's surface faces the obstacle there. The nearest place of a thin body is on its other side
once the point is past its middle: such a point keeps its plane, while it is not beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners, lengths, row_dots
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Collider
from gf_usd.physics.contact.distance.closest import Closest
from gf_usd.physics.contact.narrow_phase import ContactSearch, PosedSkin
from gf_usd.physics.contact.obstacles.obstacle import Obstacle
from gf_usd.physics.contact.obstacles.sharp import SharpFeatures
from gf_usd.physics.contact.planes.contact_planes import NOBODY, ContactPlanes
from gf_usd.physics.contact.planes.continuity import EASE

STEP = 1.0  # [spacings] between points of an edge
NEAR = 1.0  # [spacings] from a surface, within which a point has a plane
# [spacings] from a point to the nearest sample of a surface within NEAR of it, which is itself near
# the obstacle: the surface of a sample has a radius of .6
ABOUT = 1.75
FACING = 0.2  # least cosine of the outward normal of a body and the direction into the obstacle
BACK = 0.75  # [spacings] behind a point that has come past the middle of a body
# [spacings] by which a point may be beside the place where it entered a body to be inside of it
STAY = 1.0
# Points that there is room for, at least, and samples of the bodies for each: every pass over the
# contact samples passes over this room.
FEWEST, SHARE = 64, 8
START = 8.0  # [spacings] depth in a body up to which a point may be at the start
OBSTACLE_KEYS = 1 << 40  # more than an obstacle has points

Near = Callable[[Floats, Floats], tuple[Closest, Floats]]
SAVED = ("key", "x", "v", "sunk")


def capacity(colliders: Sequence[Collider], samples: int, spacing: float) -> int:
    """Points that a simulation of a number of samples a spacing [m] apart has room for.

    At most all of all obstacles, by the lengths of their edges, and a share of the samples: edges
    are lines, on which a body of n samples meets some sqrt(n) points each.
    """
    all_of_them = 0.0
    for one in colliders:
        if one.shape == "plane":
            continue
        p = one.positions(0)
        length = sum(
            lengths(p[one.triangles[:, k]] - p[one.triangles[:, k - 1]]).sum() for k in range(3)
        )
        all_of_them += len(p) + 0.5 * length / (STEP * spacing)
    return int(min(np.ceil(all_of_them), max(FEWEST, samples // SHARE)))


class EdgePoints:
    """The points of obstacles that are near bodies, numbered after the contact samples.

    first : number of the first of `count` places for points; features : edges of an obstacle;
    rest : the surface of a body where the simulation begins; spacing : [m].
    """

    def __init__(
        self, first: int, count: int, obstacles: Sequence[Obstacle],
        features: Callable[[int], SharpFeatures], rest: Callable[[int], PosedSkin], spacing: float,
    ) -> None:  # fmt: skip
        self._first, self._obstacles, self._features = first, obstacles, features
        self._rest, self._spacing = rest, spacing
        self.key = np.full(count, -1)  # (m,) of each point, see `_keys`; -1: none
        self.x, self.v = np.zeros((count, 3)), np.zeros((count, 3))  # [m], [m/s] at a detection
        # (m,) [m] <= 0: depth, negative, in the body that it faces at the start
        self.sunk = np.zeros(count)
        self._start: dict[tuple[int, int], tuple[Ints, Floats]] = {}  # keys, and `sunk`
        self._free: list[int] = []  # places, at the present detection
        self.left_out = 0  # points in bodies that there was no place for at the last detection

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {f"contact_edge_{name}": getattr(self, name).copy() for name in SAVED}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        for name in SAVED:
            setattr(self, name, np.array(saved[f"contact_edge_{name}"]))

    def joined(self, x: Floats, v: Floats, elapsed: float) -> tuple[Floats, Floats]:
        """x [m] and v [m/s] of samples (n, 3), and of points, elapsed [s] after a detection."""
        if not len(self.key):
            return x, v
        return np.concatenate([x, self.x + elapsed * self.v]), np.concatenate([v, self.v])

    def with_points(
        self, X: Floats, drift: Floats | None, dt: float, origin: Floats
    ) -> tuple[Floats, Floats | None]:
        """`layout.write_rest` of samples at X (n, 3) [m], and of points, from an origin (3,) [m].

        Both in the middle of the first substep of dt [s].
        """
        if not len(self.key):
            return X, drift
        own = np.zeros_like(X) if drift is None else drift
        place = self.x + 0.5 * dt * self.v - origin
        return np.concatenate([X, place]), np.concatenate([own, self.v])

    def begin(self, elapsed: float, planes: ContactPlanes) -> None:
        """A detection begins, elapsed [s] after the last one, with its planes (n + m,)."""
        self.x = self.x + elapsed * self.v
        self._free = np.flatnonzero(planes.partner[self._first :] == NOBODY)[::-1].tolist()
        self.key[self._free] = -1
        self.left_out = 0

    def search(
        self, search: ContactSearch, body: int, which: int, samples: Ints, near: Near,
        before: ContactPlanes, gap: Floats, frame: float, ahead: float,
    ) -> None:  # fmt: skip
        """Offer planes of a body to the points of one obstacle that are near it.

        samples : those of the body that are within ABOUT of the obstacle; near : see
        `BodySkin.near`, of points and their smallest plausible distances; before, gap : planes and
        gaps (n + m,) [m] of the last detection; frame : where the obstacle is; ahead : [frames] of
        the motion that gives its velocity.
        """
        if not len(samples):
            return
        features, about = self._features(which), search.x[samples]
        obstacle, margin = self._obstacles[which], ABOUT * self._spacing
        vertices = obstacle.positions(frame)
        low, high = corners(about)
        points = features.within(vertices, low - margin, high + margin)
        x = points.among(vertices)
        if not len(x):
            return
        close = np.isfinite(kd_tree(about).query(x, 1, distance_upper_bound=margin)[0])
        x, inward, keys = x[close], points.inward[close], self._keys(which, points.key[close])
        if not len(x):
            return
        place = self._places(keys)
        row = np.where(place >= 0, self._first + place, 0)
        inside = (place >= 0) & (gap[row] < 0.0) & (before.partner[row] >= 0)
        known = np.where(inside, gap[row] - EASE * self._spacing, 0.0)
        rows, depth, normal, point, rest = self._faced(x, inward, known, place >= 0, near)
        place = self._placed(keys[rows], depth)
        some = np.flatnonzero(place >= 0)
        place, rows, depth, normal, point, rest = (
            a[some] for a in (place, rows, depth, normal, point, rest)
        )
        self.x[place] = search.x[self._first + place] = x[rows]
        self.v[place] = 0.0
        if obstacle.collider.moves and ahead > 0.0:
            later = points.among(obstacle.positions(frame + ahead))[close][rows]
            self.v[place] = (later - x[rows]) / (ahead * obstacle.frame_time)
        sunk = self._at_start(body, which, keys[rows])
        taken = search.offer_places(
            self._first + place, -depth, normal, point + sunk[:, None] * normal, body, rest, which
        )
        self.sunk[place[taken]] = sunk[taken]

    def _faced(
        self, x: Floats, inward: Floats, known: Floats, had: Ints, near: Near
    ) -> tuple[Ints, Floats, Floats, Floats, Floats]:
        """Points (k,) of x (n, 3) [m] near a surface that faces their obstacle, the deepest first:
        depths (k,) [m] in it, its outward normals (k, 3), places (k, 3) [m], and these at rest.

        inward : (n, 3) directions into the obstacle; known, near : see `search`; had : (n,) points
        that had a plane: what has come past the middle of a thin body is searched from further
        back.
        """
        seen, rest = near(x, known)
        faces = row_dots(seen.normal, inward[seen.rows]) > FACING
        at = np.flatnonzero(faces & (seen.gap < NEAR * self._spacing))
        found = [(seen.rows[at], -seen.gap[at], seen.normal[at], seen.point[at], rest[at])]
        past = seen.rows[~faces]
        past = past[had[past]]
        if len(past):
            back = x[past] + BACK * self._spacing * inward[past]
            seen, rest = near(back, np.zeros(len(back)))
            rows = past[seen.rows]
            depth = row_dots(seen.point - x[rows], seen.normal)
            faces = row_dots(seen.normal, inward[rows]) > FACING
            at = np.flatnonzero(faces & (depth > 0.0))
            found.append((rows[at], depth[at], seen.normal[at], seen.point[at], rest[at]))
        rows, depth, normal, point, rest = (np.concatenate(parts) for parts in zip(*found))
        order = np.argsort(-depth, kind="stable")
        return rows[order], depth[order], normal[order], point[order], rest[order]

    def keep_unseen(self, search: ContactSearch, before: ContactPlanes, depth: Floats) -> None:
        """Keep the old planes of points in bodies for which the search found none.

        before, depth : planes and depths (n + m,) [m] so far.
        """
        unseen = (depth > 0.0) & (search.planes.partner == NOBODY) & (before.partner >= 0)
        unseen[: self._first] = False
        rows = np.flatnonzero(unseen)
        far = STAY * self._spacing
        search.keep_beside(rows, before, self.sunk[rows - self._first], depth[rows], far)

    @staticmethod
    def _keys(which: int, key: Ints) -> Ints:
        """(k,) numbers of points among all of all obstacles; key : (k,) among those of one."""
        return which * OBSTACLE_KEYS + key

    def _places(self, keys: Ints) -> Ints:
        """(k,) places of points; -1: none yet."""
        order = np.argsort(self.key, kind="stable")
        if not len(order):
            return np.full(len(keys), -1)
        at = order[np.minimum(np.searchsorted(self.key[order], keys), len(order) - 1)]
        return np.where(self.key[at] == keys, at, -1)

    def _placed(self, keys: Ints, depth: Floats) -> Ints:
        """(k,) places of points, new ones in turn; -1: there is no room."""
        place = self._places(keys)
        new = np.flatnonzero(place < 0)
        some = new[: len(self._free)]
        place[some] = [self._free.pop() for _ in some]
        self.key[place[some]] = keys[some]
        self.left_out += int((depth[new[len(some) :]] > 0.0).sum())
        return place

    def _at_start(self, body: int, which: int, keys: Ints) -> Floats:
        """(k,) [m] <= 0: depth, negative, of points in a body at the start.

        A spring that begins deep would throw the body away.
        """
        if (body, which) not in self._start:
            vertices, skin = self._obstacles[which].positions(0.0), self._rest(body)
            reach = START * self._spacing
            points = self._features(which).within(vertices, *skin.box)
            seen = skin.closest(points.among(vertices), reach)
            inside = np.flatnonzero(seen.gap < 0.0)
            seen = skin.corrected(seen, inside, points.among(vertices))
            some = seen.gap < 0.0
            known = self._keys(which, points.key[seen.rows[some]])
            order = np.argsort(known)
            self._start[body, which] = known[order], seen.gap[some][order]
        known, depths = self._start[body, which]
        if not len(known):
            return np.zeros(len(keys))
        at = np.minimum(np.searchsorted(known, keys), len(known) - 1)
        return np.where(known[at] == keys, depths[at], 0.0)
