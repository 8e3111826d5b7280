"""Contact planes of the samples of a flowing body: of obstacles, and of solid bodies.

A sample has at most one plane, tangent to the nearest surface at the last detection. A detection
holds until a relative motion of half a sample spacing is possible. The plane of an obstacle moves
with the obstacle. The plane of a solid body is carried by three of its contact samples, as between
solid bodies (`contact.planes.support_triangles`):

    q = sum_k w_k x_k + o,    v_q = sum_k w_k v_k + omega x (x_s - sum_k w_k x_k)

where o and the normal n rotate with omega. During a span of a few substeps a plane moves at
constant velocity; at depth d = (q - x_s) . n > 0 its force follows the contact law between bodies
(`contact.kernels`),

    f_n = max(0, k d (1 + (d / a)^2) - c (v_s - v_q) . n)

with friction by a tangential spring of the same k, up to mu f_n. The impulse J = sum dt f on each
sample in the span and its moment sum dt x_s x f are stored; the opposite of both acts on the body
that carries the plane (`coupled`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.detection.narrow_phase import FACING, TRAVEL
from gf_usd.physics.contact.floor import HARD, FloorContact, damping_coefficient
from gf_usd.physics.contact.obstacles.obstacle import Obstacle, obstacles
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes, along
from gf_usd.physics.contact.planes.continuity import EASE, EnergyBudget, Stored, continued
from gf_usd.physics.contact.planes.support_triangles import spin
from gf_usd.physics.grid.bodies import Bodies

# Layout of a plane in the kernels' array: springs; position and motion; accumulated results.
STIFFNESS, DAMPING, FRICTION, HARDENING = range(4)
POINT, NORMAL, VELOCITY, SPRING, IMPULSE, MOMENT, DEPTH, WORK = 4, 7, 10, 13, 16, 19, 22, 23
ROW = 24
# [spacings] decrease of a gap that ends a detection; TRAVEL is the part at the initial speeds.
CLOSER = 2.0 * TRAVEL
NOTHING = -1
ARRAYS = ("face", "carriers", "weights", "normal", "point", "velocity", "gap", "spring")


@dataclass(frozen=True, kw_only=True)
class SolidContact:
    """Contact of some samples with one solid body."""

    body: int
    rows: Ints  # (k,) samples
    gap: Floats  # (k,) [m] signed distance to the surface
    normal: Floats  # (k, 3) outward unit normal
    point: Floats  # (k, 3) [m] nearest point of the surface
    carriers: Ints  # (k, 3) contact samples of the solid
    weights: Floats  # (k, 3)


class Solids(Protocol):
    """The solid bodies, as obstacles of a flow."""

    stiffness: Floats  # (m,) [N/m] of their contact samples
    mass: Floats  # (m,) [kg]
    friction: Floats  # (m,)
    restitution: Floats  # (m,)
    bodies: Bodies

    def motion(self) -> tuple[Floats, Floats]:
        """Positions [m] and velocities [m/s] of the contact samples now, (m, 3)."""
        ...

    def boxes(self) -> list[tuple[Floats, Floats, float]]:
        """For each body the corners (3,) [m] of its bounding box, and the speed [m/s] of its
        fastest sample.
        """
        ...

    def faces(self, x: Floats, face: Ints, gap: Floats, reach: float) -> list[SolidContact]:
        """Contact of points x (n, 3) [m] with each body within reach [m].

        face, gap : (n,) at the previous detection, the body's number and the signed distance [m].
        """
        ...


class FlowPlanes:
    """The contact planes of the samples of a flowing body.

    contact : its samples; setup : contains the obstacles.
    solids : the solid bodies; None: there are obstacles only.
    radius : [m] of a ball of the flowing volume, for the scale of the energy.
    through : (n,) by the number of an obstacle, or of a body after them: samples that pass through
    it.
    """

    def __init__(
        self,
        contact: FloorContact,
        spacing: float,
        setup: ContactSetup,
        gravity: Sequence[float],
        radius: float,
        frame_time: float,
        solids: Solids | None = None,
        through: Mapping[int, Ints] | None = None,
    ) -> None:
        n = len(contact.mass)
        self._through = through or {}
        self._contact, self._spacing, self.solids = contact, spacing, solids
        self._walls = [(c.spec.friction, c.spec.restitution) for c in setup.colliders]
        self._obstacles: tuple[Obstacle, ...] = obstacles(setup.colliders, frame_time)
        self._g = float(np.linalg.norm(gravity))
        none = np.zeros(0)
        others = (solids.bodies.mass, solids.bodies.radius) if solids else (none, none)
        self._budget = EnergyBudget.of_flow(
            float(contact.mass.sum()), radius, others, len(self._obstacles), self._g
        )
        self._frame_time = frame_time
        self.reach = (FACING + TRAVEL) * spacing
        self.hardening = (HARD * spacing) ** -2
        self.face = np.full(n, NOTHING)  # number of the obstacle; solid bodies follow these
        self.carriers = np.zeros((n, 3), np.int64)
        self.weights = np.zeros((n, 3))
        self.normal = np.zeros((n, 3))
        self.point = np.zeros((n, 3))  # [m] in the world; for a solid body relative to sum w_k x_k
        self.velocity = np.zeros((n, 3))  # [m/s] of obstacles
        self.gap = np.full(n, -np.inf)  # [m] at the last detection
        self.spring = np.zeros((n, 3))  # [m] xi of friction
        self.detected = 0.0  # frame of the last detection
        self.rows = np.zeros(0, np.int64)  # samples with a plane
        self._seen = (np.zeros((0, 3)),) * 3  # points, velocities, angular velocities
        self.values = np.zeros((0, 3))  # k [N/m], c [N s/m] and mu of these
        self._number_cache: Ints | None = None
        self.begin()
        self._recompute_derived()

    def begin(self) -> None:
        """Reset the sums of a frame."""
        self.work = self.injected = self.deepest = 0.0  # [J], [J], [m]
        self.released = 0

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        arrays = {f"plane_{name}": getattr(self, name).copy() for name in ARRAYS}
        return {**arrays, "plane_detected": self.detected}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        for name in ARRAYS:
            setattr(self, name, np.array(saved[f"plane_{name}"]))
        self.detected = float(saved["plane_detected"])
        self._recompute_derived()

    def set_contact(self, contact: FloorContact) -> None:
        """Use other values of the samples: friction, restitution."""
        self._contact = contact
        self._recompute_derived()

    @property
    def of_solids(self) -> Ints:
        """(k,) indices in `rows` of samples whose plane is of a solid body."""
        return np.flatnonzero(self.face[self.rows] >= len(self._obstacles))

    def detect(self, x: Floats, v: Floats, frame: float, span: float) -> float:
        """Detect the planes; the time [s] for which they hold, at most `span` [s].

        x [m], v [m/s] : (n, 3) of the samples; frame : time of the obstacles.
        """
        old, first = self._stored(x), np.isinf(self.gap).all()
        old_face, old_gap = self.face, self.gap
        names = ("carriers", "weights", "normal", "point", "velocity")
        for name in names:  # copies: earlier results refer to the old arrays
            setattr(self, name, getattr(self, name).copy())
        # at the first detection any depth is accepted
        least = old_gap - CLOSER * self._spacing
        n = len(x)
        self.face, self.gap = np.full(n, NOTHING), np.full(n, self.reach)
        gone = np.zeros(n, bool)

        def offer(number: int, rows: Ints, gap: Floats, **planes: Floats) -> None:
            likely = gap >= least[rows]
            if number in self._through:
                likely |= self._through[number][rows]
            gone[rows[~likely]] = True
            if number in self._through:
                likely &= ~self._through[number][rows]
            nearer = likely & (gap < self.gap[rows])
            mine = rows[nearer]
            self.face[mine], self.gap[mine] = number, gap[nearer]
            for name, values in planes.items():
                getattr(self, name)[mine] = values[nearer]

        for number, obstacle in enumerate(self._obstacles):
            plane = obstacle.planes(x, self.reach, frame, span)
            seen = plane.seen
            offer(
                number, seen.rows, seen.gap, normal=seen.normal, point=seen.point,
                velocity=plane.velocity,
            )  # fmt: skip
        if self.solids is not None:
            place, _ = self.solids.motion()
            count = len(self._obstacles)
            for one in self.solids.faces(x, old_face - count, old_gap, self.reach):
                carried = np.einsum("nk,nka->na", one.weights, place[one.carriers])
                offer(
                    count + one.body, one.rows, one.gap, normal=one.normal,
                    point=one.point - carried, carriers=one.carriers, weights=one.weights,
                    velocity=np.zeros_like(carried),
                )  # fmt: skip
        self.released = max(self.released, int((gone & (self.face == NOTHING)).sum()))
        self._recompute_derived()
        if not first:
            time = (frame - self.detected) * self._frame_time
            new = continued(
                old, self._stored(x), ease=EASE * self._spacing, budget=self._budget, elapsed=time
            )
            self.point, self.spring = new.planes.point, new.planes.spring
            self.injected += new.energy - old.energy
        self.detected = frame
        self.deepest = max(self.deepest, -float(self.gap.min(initial=0.0)))
        return min(span, self._hold(x, v, frame, span))

    def _recompute_derived(self) -> None:
        """Recompute the rows and values that follow from the saved arrays."""
        self.rows = np.flatnonzero(self.face != NOTHING)
        c, rows, face = self._contact, self.rows, self.face[self.rows]
        k, m, mu, e = (
            np.array(a[rows], float) for a in (c.pair_stiffness, c.mass, c.friction, c.restitution)
        )
        for number, (friction, restitution) in enumerate(self._walls):
            mine = face == number
            mu[mine] = mu[mine] if friction is None else friction
            e[mine] = e[mine] if restitution is None else restitution
        if self.solids is not None and len(at := self.of_solids):
            s, first = self.solids, self.carriers[rows[at], 0]
            k[at] = np.minimum(k[at], s.stiffness[first])
            m[at] = m[at] * s.mass[first] / (m[at] + s.mass[first])
            mu[at] = np.sqrt(mu[at] * s.friction[first])
            e[at] = np.minimum(e[at], s.restitution[first])
        self.values = np.stack([k, damping_coefficient(k, m, e), mu], 1)

    def _hold(self, x: Floats, v: Floats, frame: float, span: float) -> float:
        """[s] until a sample may have moved too far relative to its plane, or come near a
        surface.
        """
        fall = self._g * span
        boxes = [(*one.box, one.speed(frame)) for one in self._obstacles if not one.endless] + (
            self.solids.boxes() if self.solids is not None else []
        )
        speed = np.linalg.norm(v, axis=1)
        hold = np.inf
        if len(rows := self.rows):
            u = v[rows] - self._moving(x)[1]
            hold = TRAVEL * self._spacing / float((np.linalg.norm(u, axis=1) + fall).max())
        far = np.flatnonzero(self.face == NOTHING)
        margin = max(self.reach - self._spacing, self._spacing)
        endless = max((o.speed(frame) for o in self._obstacles if o.endless), default=None)
        if endless is not None and len(far):
            hold = min(hold, margin / max(float(speed[far].max()) + endless + fall, 1e-30))
        for low, high, fastest in boxes if len(far) else ():
            apart = np.linalg.norm(np.maximum(np.maximum(low - x[far], x[far] - high), 0.0), axis=1)
            way = np.maximum(apart - self._spacing, margin)
            hold = min(hold, float((way / np.maximum(speed[far] + fastest + fall, 1e-30)).min()))
        return hold

    def _moving(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Of `rows`: points of the planes [m], their velocities at the samples x (n, 3) [m] [m/s],
        and their angular velocities [1/s].
        """
        rows = self.rows
        q, vq, turn = self.point[rows].copy(), self.velocity[rows].copy(), np.zeros((len(rows), 3))
        if self.solids is not None and len(at := self.of_solids):
            place, rate = self.solids.motion()
            who, w = self.carriers[rows[at]], self.weights[rows[at]]
            carried = np.einsum("nk,nka->na", w, place[who])
            turn[at] = spin(place[who], rate[who])
            q[at] += carried
            vq[at] = np.einsum("nk,nka->na", w, rate[who])
            vq[at] += cross(turn[at], x[rows[at]] - carried)
        return q, vq, turn

    def energy(self, x: Floats) -> float:
        """[J] stored in the springs of the planes, for samples at x (n, 3) [m]."""
        return self._stored(x).energy if len(self.rows) else 0.0

    def _stored(self, x: Floats) -> Stored:
        rows, n = self.rows, len(self.face)
        depth, stiffness = np.zeros(n), np.zeros(n)
        if len(rows):
            q = self._moving(x)[0]
            depth[rows] = np.maximum(0.0, ((q - x[rows]) * self.normal[rows]).sum(1))
            stiffness[rows] = self.values[:, 0]
        planes = ContactPlanes(
            partner=self.face, carriers=self.carriers, weights=self.weights, obstacle=self.face,
            normal=self.normal, point=self.point, velocity=self.velocity, spring=self.spring,
        )  # fmt: skip
        return Stored(
            planes=planes, depth=depth, stiffness=stiffness, hardening=self.hardening,
            pair=self.face,
        )  # fmt: skip

    def locate(self, x: Floats) -> float:
        """Update the positions of the planes, with samples at x (n, 3) [m]; the largest ratio of a
        spring's stiffness to its initial one.
        """
        if not len(self.rows):
            return 1.0
        self._seen = q, _, _ = self._moving(x)
        depth = float(((q - x[self.rows]) * self.normal[self.rows]).sum(1).max())
        return 1.0 + 3.0 * self.hardening * max(0.0, depth) ** 2

    def places(self) -> tuple[Floats, Floats]:
        """Points [m] and normals of the planes of `rows` at the last `locate`, (k, 3)."""
        return self._seen[0], self.normal[self.rows]

    def numbers(self, offset: Floats, dt: float) -> Floats:
        """The kernels' values (k, ROW) of `rows` at the last `locate`, for substeps of dt [s].

        offset : (3,) [m] of the moving frame.
        """
        rows = self.rows
        q, vq, _ = self._seen
        out = np.zeros((len(rows), ROW))
        out[:, :HARDENING] = self.values
        out[:, HARDENING] = self.hardening
        # a substep advances the plane first; forces are evaluated half a step after its start
        out[:, POINT:NORMAL] = q - 0.5 * dt * vq - offset
        out[:, NORMAL:VELOCITY] = self.normal[rows]
        out[:, VELOCITY:SPRING] = vq
        out[:, SPRING:IMPULSE] = self.spring[rows]
        return out

    def follow(self, numbers: Floats, offset: Floats, span: float) -> tuple[Floats, Floats]:
        """Store the results in `numbers` after a span [s] of substeps; of each of `rows` J [N s]
        and its moment about the world's origin [N m s], (k, 3).
        """
        rows = self.rows
        self.spring[rows] = numbers[:, SPRING:IMPULSE]
        self.deepest = max(self.deepest, float(numbers[:, DEPTH].max(initial=0.0)))
        free = self.face[rows] < len(self._obstacles)
        self.work += float(numbers[free, WORK].sum())
        self.point[rows[free]] += span * self.velocity[rows[free]]
        if len(at := self.of_solids):
            turn = span * self._seen[2][at]
            mine = rows[at]
            turned = self.normal[mine] + cross(turn, self.normal[mine])
            self.normal[mine] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
            self.point[mine] += cross(turn, self.point[mine])
            self.spring[mine] = along(
                self.spring[mine] + cross(turn, self.spring[mine]), self.normal[mine]
            )
        J = numbers[:, IMPULSE:MOMENT]
        return J, numbers[:, MOMENT:DEPTH] + cross(np.broadcast_to(offset, J.shape), J)
