"""Who touches whom: the plane that each surface sample faces until the next look.

Between two looks no sample may move by more than half a spacing against another body, so that what
is near is known before it is deep.  A sample faces the obstacle or the body that it is deepest in,
or nearest to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.model import Floats, Ints
from gf_usd.nearby import kd_tree
from gf_usd.physics.pair_layout import NOBODY, OBSTACLE

FACING = 1.5  # [spacings] a sample stands for the surface this far around it
LOOK = 0.5  # [spacings] that samples may move between two looks
# [spacings] that a gap may shrink between two looks, of which LOOK is the way at the speeds of the
# first; the rest is for speeds that grow and for what the surface does between its samples.
CLOSER = 1.5 * LOOK
EASE = 0.1  # [spacings] that a look may make a sample deeper than it was under its old plane
APART = 4.0  # [spacings] at rest, from where on a body meets itself
# Over the floor's stiffness: two rubber or jelly balls that fell three radii each then overlap by
# 0.41 spacings at most; with 1 by 0.52 (measured).
STIFFER = 2.0
CROWD = 24  # samples asked for around one that may meet its own body: most are its neighbors
ARRAYS = ("partner", "obstacle", "normal", "point", "velocity")


@dataclass(frozen=True, kw_only=True)
class Faced:
    """What each of n samples faces, in the world."""

    partner: Ints  # (n,) the sample that carries the plane, NOBODY or OBSTACLE
    obstacle: Ints  # (n,) which obstacle; -1: none
    normal: Floats  # (n, 3) unit, out of what is faced
    point: Floats  # (n, 3) [m] on the plane: of an obstacle, or from the partner
    velocity: Floats  # (n, 3) [m/s] of an obstacle

    @property
    def active(self) -> Ints:
        """Samples that face something or are faced."""
        faced = self.partner[self.partner >= 0]
        return np.union1d(np.flatnonzero(self.partner != NOBODY), faced)

    def forget(self, rows: Ints) -> None:
        """Samples `rows` face nothing."""
        away = nothing(len(rows))
        for name in ARRAYS:
            getattr(self, name)[rows] = getattr(away, name)

    def lists(self) -> tuple[Ints, Ints]:
        """(n + 1,) and (m,): for each sample those that face it, in order."""
        who = np.flatnonzero(self.partner >= 0)
        order = who[np.argsort(self.partner[who], kind="stable")]
        start = np.searchsorted(self.partner[order], np.arange(len(self.partner) + 1))
        return start, order

    def depth(self, x: Floats, elapsed: float) -> Floats:
        """(n,) [m] of samples at x (n, 3) [m] under their planes, elapsed [s] since the look."""
        active = np.flatnonzero(self.partner != NOBODY)
        who = self.partner[active]
        q = self.point[active] + elapsed * self.velocity[active]
        q += np.where((who >= 0)[:, None], x[np.maximum(who, 0)], 0.0)
        out = np.zeros(len(x))
        out[active] = np.maximum(0.0, ((q - x[active]) * self.normal[active]).sum(1))
        return out


def nothing(n: int) -> Faced:
    """n samples that face nothing."""
    return Faced(
        partner=np.full(n, NOBODY),
        obstacle=np.full(n, -1),
        normal=np.zeros((n, 3)),
        point=np.zeros((n, 3)),
        velocity=np.zeros((n, 3)),
    )


def eased(faced: Faced, deeper: Floats) -> Faced:
    """The planes moved back along their normals by deeper (n,) [m] >= 0."""
    return replace(faced, point=faced.point - deeper[:, None] * faced.normal)


class Looking:
    """Collects, of all that a sample might face, what it is deepest in or nearest to.

    x : (n, 3) [m]; reach : [m] from where something is faced; least : (n,) [m] the gap that each
    may have come to since the last look.

    A surface that a crash folded or turned inside out shows a wrong side to what is near it.  A
    sample that seems deeper than it can have come is let go there, and counted: a spring that
    begins deep would throw it out with energy that nobody's motion paid for.
    """

    def __init__(self, x: Floats, reach: float, least: Floats) -> None:
        self.x, self.reach, self._least = x, reach, least
        self.gap = np.full(len(x), reach)
        self.faced = nothing(len(x))
        self._gone = np.zeros(len(x), bool)

    @property
    def let_go(self) -> int:
        """How many samples were let go."""
        return int(self._gone.sum())

    def plane(
        self, rows: Ints, gap: Floats, normal: Floats, point: Floats, carried: Ints | None,
        velocity: Floats | None = None, obstacle: int = -1,
    ) -> None:  # fmt: skip
        """Offer samples `rows` a plane each, carried by samples, or by an obstacle at a velocity.

        gap : (k,) [m]; point : (k, 3) [m] on it.
        """
        likely = gap >= self._least[rows]
        self._gone[rows[~likely]] = True
        nearer = likely & (gap < self.gap[rows])
        rows, f = rows[nearer], self.faced
        self.gap[rows], f.normal[rows] = gap[nearer], normal[nearer]
        f.obstacle[rows] = obstacle
        if carried is None:
            f.partner[rows], f.point[rows] = OBSTACLE, point[nearer]
            f.velocity[rows] = 0.0 if velocity is None else velocity[nearer]
        else:
            who = carried[nearer]
            f.partner[rows], f.point[rows] = who, point[nearer] - self.x[who]
            f.velocity[rows] = 0.0


def facing_itself(
    x: Floats, normal: Floats, X: Floats, members: Ints, reach: float, spacing: float
) -> tuple[Ints, Ints]:
    """Samples of one body, and for each the nearest one far off at rest that looks it in the face.

    x, normal, X : (n, 3) of all samples, now, now and at rest; members : (m,) those of the body.
    """
    k = min(CROWD, len(members))
    distance, at = kd_tree(x[members]).query(x[members], k=k, distance_upper_bound=reach)
    distance, at = distance.reshape(len(members), k), at.reshape(len(members), k)
    there = at < len(members)
    b = members[np.where(there, at, 0)]
    fit = there & (np.einsum("na,nka->nk", normal[members], normal[b]) < 0.0)
    fit &= np.linalg.norm(X[b] - X[members][:, None], axis=2) > APART * spacing
    rows = np.flatnonzero(fit.any(1))
    return members[rows], b[rows, fit[rows].argmax(1)]


def pair_values(
    faced: Faced,
    stiffness: Floats,
    mass: Floats,
    friction: Floats,
    restitution: Floats,
    walls: Sequence[tuple[float | None, float | None]],
) -> dict[str, Floats]:
    """k, m, friction and restitution of each sample with what it faces.

    Stiffer than the floor, since here both sides give way.  Two bodies meet with the softer's
    stiffness, their reduced mass, the geometric mean of their frictions and the lower restitution;
    walls : (friction, restitution) of each obstacle, None: the sample's own.
    """
    k, m, mu, e = (np.array(v, float) for v in (STIFFER * stiffness, mass, friction, restitution))
    a = np.flatnonzero(faced.partner >= 0)
    b = faced.partner[a]
    k[a] = STIFFER * np.minimum(stiffness[a], stiffness[b])
    m[a] = mass[a] * mass[b] / (mass[a] + mass[b])
    mu[a], e[a] = np.sqrt(friction[a] * friction[b]), np.minimum(restitution[a], restitution[b])
    for number, (wall_friction, wall_restitution) in enumerate(walls):
        at = faced.obstacle == number
        if wall_friction is not None:
            mu[at] = wall_friction
        if wall_restitution is not None:
            e[at] = wall_restitution
    return {"stiffness": k, "mass": m, "friction": mu, "restitution": e}
