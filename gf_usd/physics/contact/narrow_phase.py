"""The narrow phase: the plane that each surface sample faces until the next detection.

Between two detections no sample may move by more than half a spacing against another body, so that
what is near is known before it is deep.  A sample faces the obstacle or the body that it is deepest
in, or nearest to.

The surface of a body as others meet it: its own triangles, where they are now.

Obstacles: where they are at a time, and the plane that a point of a body faces.

Where the numbers of a contact between bodies stand in the kernels' arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints, lengths, nonzero_rows, row_dots
from gf_usd.core.stage import Collider, Skin
from gf_usd.physics.contact.carriers import NEAR, Triples, chosen, cross, spin
from gf_usd.physics.contact.distance.closest import Closest, above_plane
from gf_usd.physics.contact.distance.tree import SurfaceTree
from gf_usd.physics.contact.distance.winding import outside_where_unwound, shell
from gf_usd.physics.contact.floor import FloorContact, damping_coefficient
from gf_usd.physics.grid.reference import Rows

FACING = 1.5  # [spacings] a sample stands for the surface this far around it
TRAVEL = 0.5  # [spacings] that samples may move between two detections
# [spacings] that a gap may shrink between two detections, of which TRAVEL is at the speeds of the
# first; the rest is for speeds that grow and for what the surface does between its samples.
CLOSER = 1.5 * TRAVEL
ARRAYS = ("partner", "carriers", "weights", "obstacle", "normal", "point", "velocity", "spring")


@dataclass(frozen=True, kw_only=True)
class ContactPlanes:
    """What each of n samples faces, in the world."""

    partner: Ints  # (n,) the first of the samples that carry the plane, NOBODY or OBSTACLE
    carriers: Ints  # (n, 3) all of them: see `carriers`
    weights: Floats  # (n, 3) of the carriers
    obstacle: Ints  # (n,) which obstacle; -1: none
    normal: Floats  # (n, 3) unit, out of what is faced
    point: Floats  # (n, 3) [m] on the plane: of an obstacle, or from sum w_k x_k of the carriers
    velocity: Floats  # (n, 3) [m/s] of an obstacle
    spring: Floats  # (n, 3) [m] xi of friction, along the plane

    @property
    def carried(self) -> Ints:
        """Samples whose plane is carried by a body."""
        return np.flatnonzero(self.partner >= 0)

    @property
    def active(self) -> Ints:
        """Samples that face something or are faced."""
        faced = self.carriers[self.carried].ravel()
        return np.union1d(np.flatnonzero(self.partner != NOBODY), faced)

    def forget(self, rows: Ints) -> None:
        """Samples `rows` face nothing."""
        away = nothing(len(rows))
        for name in ARRAYS:
            getattr(self, name)[rows] = getattr(away, name)

    def lists(self) -> tuple[Ints, Ints]:
        """(n + 1,) and (3 m,): for each sample the 3 s + k whose carrier k it is, in order."""
        who = self.carried
        entries = (3 * who[:, None] + np.arange(3)).ravel()
        carriers = self.carriers[who].ravel()
        order = np.argsort(carriers, kind="stable")
        start = np.searchsorted(carriers[order], np.arange(len(self.partner) + 1))
        return start, entries[order]

    @property
    def facing(self) -> Ints:
        """Samples that face something."""
        return np.flatnonzero(self.partner != NOBODY)

    def of(self, rows: Ints) -> ContactPlanes:
        """What some of the samples, rows (k,), face; carriers keep their numbers."""
        return ContactPlanes(**{name: getattr(self, name)[rows] for name in ARRAYS})

    def interpolated(self, values: Floats) -> Floats:
        """Values (n, 3) of all samples, interpolated to the planes: sum_k w_k; 0 for obstacles."""
        out, who = np.zeros((len(self.partner), 3)), self.carried
        out[who] = np.einsum("nk,nka->na", self.weights[who], values[self.carriers[who]])
        return out

    def depth(self, x: Floats, elapsed: float) -> Floats:
        """(n,) [m] of samples at x (n, 3) [m] under their planes, elapsed [s] since detection."""
        active = self.facing
        f, out = self.of(active), np.zeros(len(x))
        q = f.point + f.interpolated(x) + elapsed * f.velocity
        out[active] = np.maximum(0.0, row_dots(q - x[active], f.normal))
        return out


def nothing(n: int) -> ContactPlanes:
    """n samples that face nothing."""
    return ContactPlanes(
        partner=np.full(n, NOBODY),
        carriers=np.full((n, 3), NOBODY),
        weights=np.zeros((n, 3)),
        obstacle=np.full(n, -1),
        normal=np.zeros((n, 3)),
        point=np.zeros((n, 3)),
        velocity=np.zeros((n, 3)),
        spring=np.zeros((n, 3)),
    )


def moved(planes: ContactPlanes, x: Floats, v: Floats, time: float) -> ContactPlanes:
    """The planes as what carries them leaves them a short time [s] on; those of obstacles stay.

    x [m], v [m/s] : (n, 3) of the samples.  Springs of friction, where there are any, go with the
    slip of their samples.
    """
    p, who = planes, planes.carried
    normal, point, spring = p.normal.copy(), p.point.copy(), p.spring.copy()
    stuck = nonzero_rows(spring)
    turn = np.zeros_like(x) if len(stuck) else None
    if len(who):
        carriers = p.carriers[who]
        turns = time * spin(x[carriers], v[carriers])
        turned = normal[who] + cross(turns, normal[who])
        normal[who] = turned / lengths(turned)[:, None]
        point[who] += cross(turns, point[who])
        if turn is not None:
            turn[who] = turns
    if turn is not None:
        f, turns = p.of(stuck), turn[stuck]
        way = time * (v[stuck] - f.interpolated(v) - f.velocity)
        way -= cross(turns, x[stuck] - f.interpolated(x))
        spring[stuck] = along(f.spring + (way + cross(turns, f.spring)), normal[stuck])
    return replace(p, normal=normal, point=point, spring=spring)


def along(vectors: Floats, normal: Floats) -> Floats:
    """(n, 3) what of vectors lies in the planes of unit normals."""
    return vectors - row_dots(vectors, normal)[:, None] * normal


class ContactSearch:
    """Collects, of all that a sample might face, what it is deepest in or nearest to.

    x : (n, 3) [m]; reach : [m] from where something is faced; least : (n,) [m] the gap that each
    may have come to since the last detection.

    A surface that a crash folded or turned inside out shows a wrong side to what is near it.  A
    sample that seems deeper than it can have come is released there, and counted: a spring that
    begins deep would throw it out with energy that nobody's motion paid for.
    """

    def __init__(self, x: Floats, reach: float, least: Floats) -> None:
        self.x, self.reach, self._least = x, reach, least
        self.gap = np.full(len(x), reach)
        self.planes = nothing(len(x))
        self._gone = np.zeros(len(x), bool)
        # Of those that face a place whose carriers are not known yet: its body, -1: none, and where
        # it is at rest.
        self._owner, self._rest = np.full(len(x), -1), np.zeros((len(x), 3))

    @property
    def released(self) -> int:
        """How many samples were released."""
        return int(self._gone.sum())

    def offer(
        self, rows: Ints, gap: Floats, normal: Floats, point: Floats,
        carriers: Ints | None = None, weights: Floats | None = None,
        *, velocity: Floats | None = None, obstacle: int = -1, sure: bool = False,
    ) -> None:  # fmt: skip
        """Offer samples `rows` (k,) a plane each, carried by samples, or by an obstacle.

        gap : (k,) [m]; point : (k, 3) [m] on it; carriers, weights : (k, 3), see `BodySkin`; None:
        an obstacle's, that moves with velocity (k, 3) [m/s].  sure : how they came there is known.
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
        f.point[rows] = point[nearer] - np.einsum("nk,nka->na", w, self.x[who])

    def offer_places(
        self, rows: Ints, gap: Floats, normal: Floats, point: Floats, body: int, rest: Floats
    ) -> None:
        """Offer samples `rows` (k,) planes at places of a body, rest (k, 3) [m] at rest.

        `carry` has to follow, which finds the samples that carry those that are faced in the end.
        """
        nearer = self._take(rows, gap, normal, -1, sure=False)
        rows = rows[nearer]
        self.planes.point[rows] = point[nearer]
        self._owner[rows], self._rest[rows] = body, rest[nearer]

    def _take(self, rows: Ints, gap: Floats, normal: Floats, obstacle: int, *, sure: bool) -> Ints:
        """(k,) which of what is offered is believed and nearer than what was; takes what all planes
        have of it."""
        likely = np.full(len(rows), True) if sure else gap >= self._least[rows]
        self._gone[rows[~likely]] = True
        nearer = likely & (gap < self.gap[rows])
        rows, f = rows[nearer], self.planes
        self.gap[rows], f.normal[rows] = gap[nearer], normal[nearer]
        f.obstacle[rows], f.velocity[rows] = obstacle, 0.0
        self._owner[rows] = -1
        return nearer

    def carry(self, skins: Mapping[int, BodySkin], X: Floats) -> None:
        """Find the samples that carry places of the skins; X : (n, 3) [m] of all at rest."""
        rows = np.flatnonzero(self._owner >= 0)
        if not len(rows):
            return
        rest, owner, f = self._rest[rows], self._owner[rows], self.planes
        near = np.empty((len(rows), NEAR), np.int32)
        for body in np.unique(owner):
            some = owner == body
            near[some] = skins[body].nearest(rest[some])
        who, w = chosen(X, rest, near)
        f.partner[rows], f.carriers[rows], f.weights[rows] = who[:, 0], who, w
        f.point[rows] -= np.einsum("nk,nka->na", w, self.x[who])
        self._owner[rows] = -1


def pair_values(
    planes: ContactPlanes,
    contact: FloorContact,
    walls: Sequence[tuple[float | None, float | None]],
) -> dict[str, Floats]:
    """k, m, friction and damping c of each sample with what it faces.

    Two bodies meet with the softer's
    stiffness, their reduced mass, the geometric mean of their frictions and the lower restitution;
    walls : (friction, restitution) of each obstacle, None: the sample's own.
    """
    mass, friction, restitution = contact.mass, contact.friction, contact.restitution
    k, m, mu, e = (
        np.array(v, float) for v in (contact.pair_stiffness, mass, friction, restitution)
    )
    a = planes.carried
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
    return {"stiffness": k, "mass": m, "friction": mu, "damping": damping_coefficient(k, m, e)}


class BodySkin:
    """One body's surface.

    skin : at rest; rows : of its points on the grid; samples : (n,) indices of the body's contact
    samples; X : (n, 3) [m] of those at rest.
    """

    def __init__(self, skin: Skin, rows: Rows, samples: Ints, X: Floats) -> None:
        self.skin, self.samples = skin, samples
        self._W = rows.W
        self._triples = Triples(X)
        self._tree = SurfaceTree(skin.points, skin.triangles)
        self._shell = shell(skin.points, skin.triangles)

    def near(
        self, X: Floats, known: Floats, u: Floats, offset: Floats, reach: float
    ) -> tuple[Closest, Floats]:
        """The surface as points X (m, 3) [m] see it, and the places seen (k, 3) [m] at rest.

        known : (m,) [m] <= 0, from where on a signed distance is believed; what seems deeper is
        asked of the whole surface.  u : (nodes, 3) [m] as `Rows` stack them, without offset (3,)
        [m].
        """
        skin = self.skin
        points = skin.points + offset + self._W @ u
        seen = self._tree.closest(X, points, reach)
        doubtful = np.flatnonzero(seen.gap < known[seen.rows])
        if len(doubtful):
            if self._shell is None:
                seen = outside_where_unwound(seen, doubtful, X, points, skin.triangles)
            else:
                kept, faces = self._shell
                seen = outside_where_unwound(seen, doubtful, X, points[kept], faces, shell=True)
        rest = skin.points[skin.triangles[seen.triangle]]
        return seen, np.einsum("nk,nka->na", seen.weights, rest)

    def carriers(self, places: Floats) -> tuple[Ints, Floats]:
        """Contact samples (k, 3) and weights (k, 3) that carry places (k, 3) [m] at rest.

        The weights sum to 1, the largest first: see `Triples`.
        """
        if len(places) == 0:
            return np.zeros((0, 3), np.int64), np.zeros((0, 3))
        at, weights = self._triples(places)
        return self.samples[at], weights

    def nearest(self, places: Floats) -> Ints:
        """(k, NEAR) contact samples nearest to places (k, 3) [m] at rest; -1: no more."""
        near = self._triples.near(places)
        return np.where(near >= 0, self.samples[near], -1)


@dataclass(frozen=True, kw_only=True)
class Plane:
    """The surface of one obstacle near some points, and how it moves there."""

    seen: Closest
    velocity: Floats  # (k, 3) [m/s] of the closest points


class Obstacle:
    """One obstacle in time; before its first and after its last frame it stays.

    frame_time : [s] simulated between two frames.
    """

    def __init__(self, collider: Collider, frame_time: float) -> None:
        self.collider = collider
        self._frame_time = frame_time
        self.endless = collider.shape == "plane"
        frames = [collider.positions(f) for f in range(collider.frames)]
        self._low = np.min([p.min(0) for p in frames], axis=0)
        self._high = np.max([p.max(0) for p in frames], axis=0)
        self._tree: SurfaceTree | None = None  # made once something is near

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Corners (3,) [m] of the box of all the places that it comes to."""
        return self._low, self._high

    def positions(self, frame: float) -> Floats:
        """Points (V, 3) [m] at a frame, linear in between."""
        last = self.collider.frames - 1
        frame = float(np.clip(frame, 0.0, last))
        low = min(int(frame), max(last - 1, 0))
        start = self.collider.positions(low)
        t = frame - low
        return start if t == 0.0 else (1.0 - t) * start + t * self.collider.positions(low + 1)

    def speed(self, frame: float) -> float:
        """[m/s] of its fastest point from a frame to the next."""
        if not self.collider.moves:
            return 0.0
        way = self.positions(np.floor(frame) + 1.0) - self.positions(np.floor(frame))
        return float(np.linalg.norm(way, axis=1).max()) / self._frame_time

    def gap(self, low: Floats, high: Floats) -> float:
        """[m] from a box to the box of all the places that the obstacle comes to."""
        return 0.0 if self.endless else box_gap(low, high, self._low, self._high)

    def planes(self, X: Floats, reach: float, frame: float, span: float) -> Plane:
        """What points X (n, 3) [m] face at a frame; the velocity is that of the next span [s]."""
        now, triangles = self.positions(frame), self.collider.triangles
        if self.endless:
            seen = above_plane(X, now[triangles[0]], reach)
        else:
            if self._tree is None:
                self._tree = SurfaceTree(self.positions(0.0), triangles)
            seen = self._tree.closest(X, now, reach, moved=self.collider.moves)
        if not self.collider.moves or span <= 0.0:
            return Plane(seen=seen, velocity=np.zeros_like(seen.point))
        way = self.positions(frame + span / self._frame_time) - now
        corners = way[triangles[seen.triangle]]
        return Plane(seen=seen, velocity=np.einsum("nk,nka->na", seen.weights, corners) / span)


def obstacles(colliders: Sequence[Collider], frame_time: float) -> tuple[Obstacle, ...]:
    """All of them."""
    return tuple(Obstacle(collider, frame_time) for collider in colliders)


def box_gap(low: Floats, high: Floats, other_low: Floats, other_high: Floats) -> float:
    """[m] between two boxes; 0 where they overlap."""
    apart = np.maximum(np.maximum(other_low - high, low - other_high), 0.0)
    return float(np.linalg.norm(apart))


NOBODY = -1
OBSTACLE = -2

# A kernel takes few arrays: all numbers of a sample stand in one row of `pair`, ...
ROW = 45
REST, DRIFT, PLACE, RATE, FORCE = 0, 3, 6, 9, 12  # X, its rate by a pin, x, v, f
POINT, NORMAL, VELOCITY = 15, 18, 21  # q (of a body's plane: from sum w x), n, v_q of an obstacle
STIFFNESS, DAMPING, FRICTION = 24, 25, 26
DEPTH, WORK = 27, 28  # deepest [m] and work of an obstacle [J] since they were cleared
SPRING, WEIGHT, REACTION = 29, 32, 35  # xi; w_k and f_k of the three carriers
HARDENING = 44  # [1/m^2] of the spring: f = k d (1 + HARDENING d^2)
# ... and its whole numbers in one of `links`: the carriers; where its list starts; three entries of
# all lists.
LINKS = 7
PARTNER, START, PAIR_FACING = 0, 3, 4


def pack_arrays(n: int) -> dict[str, Floats]:
    """The arrays of contact between n samples in the kernels' pack; n = 0: none."""
    return {
        "pair": np.zeros(ROW * max(1, n)),
        "links": np.full(LINKS * (n + 1), NOBODY),
    }


def links(planes: ContactPlanes) -> Ints:
    """(n + 1, LINKS) the whole numbers of n samples: see above."""
    start, order = planes.lists()
    out = np.full((len(start), LINKS), NOBODY)
    out[:-1, :START], out[:, START] = planes.carriers, start
    out[:-1, PARTNER] = planes.partner
    entries = np.zeros((len(start), 3), np.int64)
    entries.flat[: len(order)] = order
    out[:, PAIR_FACING:] = entries
    return out
