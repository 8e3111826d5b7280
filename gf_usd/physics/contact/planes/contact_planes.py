"""The contact plane of each sample until the next detection.

A plane belongs to an obstacle, with its own velocity, or to a body. A plane of a body moves with
three of its samples, the carriers (`support_triangles`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross, gather, lengths, nonzero_rows, row_dots
from gf_usd.physics.contact.planes.support_triangles import spin

ARRAYS = ("partner", "carriers", "weights", "obstacle", "normal", "point", "velocity", "spring")
NOBODY = -1  # as a partner: no plane
OBSTACLE = -2  # as a partner: a plane of an obstacle


@dataclass(frozen=True, kw_only=True)
class ContactPlanes:
    """The contact planes of n samples, in world coordinates."""

    partner: Ints  # (n,) the first of the samples that carry the plane, NOBODY or OBSTACLE
    carriers: Ints  # (n, 3) all of them: see `support_triangles`
    weights: Floats  # (n, 3) of the carriers
    obstacle: Ints  # (n,) which obstacle; -1: none
    normal: Floats  # (n, 3) outward unit normal of the partner
    point: Floats  # (n, 3) [m] on the plane; of a body, relative to sum w_k x_k
    velocity: Floats  # (n, 3) [m/s] of an obstacle
    spring: Floats  # (n, 3) [m] xi of friction, tangential

    @property
    def on_bodies(self) -> Ints:
        """(k,) samples whose plane belongs to a body."""
        return np.flatnonzero(self.partner >= 0)

    @property
    def active(self) -> Ints:
        """Samples that have a plane or carry one."""
        found = self.partner != NOBODY
        found[self.carriers[self.on_bodies]] = True
        return np.flatnonzero(found)

    @property
    def any_planes(self) -> bool:
        """Whether a sample has a plane."""
        return bool((self.partner != NOBODY).any())

    def bodies(self, of: Ints) -> Ints:
        """The body of each sample, and of each point of an obstacle, after the samples, the body
        that it is in contact with; -1: none.

        of : (n,) the bodies of the samples.
        """
        partner = self.partner[len(of) :]
        if not len(partner):
            return of
        return np.append(of, np.where(partner >= 0, of[partner], -1))

    def forget(self, rows: Ints) -> None:
        """Remove the planes of samples `rows`."""
        away = nothing(len(rows))
        for name in ARRAYS:
            getattr(self, name)[rows] = getattr(away, name)

    def only(self, rows: Ints) -> ContactPlanes:
        """The same samples, of which only `rows` (k,) have a plane."""
        off = np.ones(len(self.partner), bool)
        off[rows] = False
        return replace(
            self,
            partner=np.where(off, NOBODY, self.partner),
            carriers=np.where(off[:, None], NOBODY, self.carriers),
        )

    def lists(self) -> tuple[Ints, Ints]:
        """(n + 1,) and (3 m,): for each sample the 3 s + k of the planes s of which it is carrier
        k, in order.
        """
        who = self.on_bodies
        entries = (3 * who[:, None] + np.arange(3)).ravel()
        carriers = self.carriers[who].ravel()
        order = np.argsort(carriers, kind="stable")
        start = np.searchsorted(carriers[order], np.arange(len(self.partner) + 1))
        return start, entries[order]

    @property
    def facing(self) -> Ints:
        """Samples that have a plane."""
        return np.flatnonzero(self.partner != NOBODY)

    def of(self, rows: Ints) -> ContactPlanes:
        """The planes of samples `rows` (k,); carriers keep their indices."""
        return ContactPlanes(**{name: gather(getattr(self, name), rows) for name in ARRAYS})

    def interpolated(self, values: Floats) -> Floats:
        """Values (n, 3) of all samples, interpolated to the planes by sum_k w_k; 0 for
        obstacles.
        """
        out, who = np.zeros((len(self.partner), 3)), self.on_bodies
        out[who] = self.interpolated_to(who, values)
        return out

    def interpolated_to(self, rows: Ints, values: Floats) -> Floats:
        """The same for samples `rows` (k,) that have a plane."""
        # The carriers of an obstacle's plane are any sample, with weights of 0.
        corners = gather(values, gather(self.carriers, rows))
        return np.einsum("nk,nka->na", gather(self.weights, rows), corners)

    def depth(self, x: Floats, elapsed: float) -> Floats:
        """(n,) [m] of samples at x (n, 3) [m] under their planes, elapsed [s] since detection."""
        return np.maximum(0.0, self.below(x, elapsed))

    def below(self, x: Floats, elapsed: float = 0.0) -> Floats:
        """(n,) [m] the same, negative above; 0 where there is no plane."""
        rows, out = self.facing, np.zeros(len(x))
        q = gather(self.point, rows) + self.interpolated_to(rows, x)
        q += elapsed * gather(self.velocity, rows)
        out[rows] = row_dots(q - gather(x, rows), gather(self.normal, rows))
        return out

    def turned(self, rows: Ints, before: Floats, after: Floats) -> tuple[Floats, Floats]:
        """Normals and points (k, 3) of planes `rows` that their carriers have turned.

        before, after : (n, 3) [m] of all samples. The turn is that of the motion between them, by
        the rotation vector w = 2 atan(|a| / 2) a / |a|, a the spin about their mean positions.
        """
        who = gather(self.carriers, rows)
        begin, end = gather(before, who), gather(after, who)
        a = spin(0.5 * (begin + end), end - begin)
        size = np.maximum(lengths(a), 1e-30)[:, None]
        axis, angle = a / size, 2.0 * np.arctan(0.5 * size)

        def rotated(b: Floats) -> Floats:
            along_axis = row_dots(axis, b)[:, None] * axis
            return along_axis + np.cos(angle) * (b - along_axis) + np.sin(angle) * cross(axis, b)

        return rotated(gather(self.normal, rows)), rotated(gather(self.point, rows))


def nothing(n: int) -> ContactPlanes:
    """n samples without planes."""
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
    """The planes after a short time [s], moved with their carriers; those of obstacles are
    unchanged.

    x [m], v [m/s] : (n, 3) of the samples. Friction springs advance with the slip of their samples.
    """
    p, who = planes, planes.on_bodies
    normal, point, spring = p.normal.copy(), p.point.copy(), p.spring.copy()
    stuck = nonzero_rows(spring)
    turn = np.zeros_like(x) if len(stuck) else None
    if len(who):
        carriers = gather(p.carriers, who)
        turns = time * spin(gather(x, carriers), gather(v, carriers))
        turned = gather(normal, who)
        turned += cross(turns, turned)
        normal[who] = turned / lengths(turned)[:, None]
        at = gather(point, who)
        point[who] = at + cross(turns, at)
        if turn is not None:
            turn[who] = turns
    if turn is not None:
        f, turns = p.of(stuck), gather(turn, stuck)
        way = time * (gather(v, stuck) - f.interpolated(v) - f.velocity)
        way -= cross(turns, gather(x, stuck) - f.interpolated(x))
        spring[stuck] = along(f.spring + (way + cross(turns, f.spring)), gather(normal, stuck))
    return replace(p, normal=normal, point=point, spring=spring)


def along(vectors: Floats, normal: Floats) -> Floats:
    """(n, 3) the tangential components of vectors, for unit normals."""
    return vectors - row_dots(vectors, normal)[:, None] * normal
