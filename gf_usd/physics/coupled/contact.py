"""Contact between a flow and solid bodies: surface planes, and the reactions on the solids.

In a span of a few substeps the flow moves against planes of constant velocity, and each of its
samples receives an impulse J with the moment L about the origin (`FlowPlanes`). Half of the
reaction -J acts on the solid body before its own substeps of the span and half after them, which
makes the coupling position Verlet: for a spring of frequency w between the solvers and a span T it
is stable up to w T = 2 and conserves energy, where a single impulse before the substeps dissipates
and one after them adds energy.

The impulse acts on the three samples k that carry the plane, with weights w_k,

    p_k = -w_k J / 2 + alpha x r_k,    J_3 alpha = -L / 2 + (sum_k w_k x_k) x J / 2

with r_k from their centroid and J_3 their moment of inertia with unit masses, and from there on the
nodes by W^T and M~^-1: sum_k p_k = -J / 2 and sum_k x_k x p_k = -L / 2, so that momentum and
angular momentum are conserved to rounding.
"""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.physics.contact.detection.narrow_phase import TRAVEL
from gf_usd.physics.contact.planes.continuity import EASE
from gf_usd.physics.contact.planes.support_triangles import turn
from gf_usd.physics.grid.bodies import bodies_of, fastest
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.planes import SolidContact
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian

COVER = 1.5  # [spacings] from any place of a surface, strained, to its nearest sample
STEP = 1.0  # w T of a span at most: (w T)^2 is a quarter of the stable limit


class SolidBodies:
    """The solid bodies as contact partners of the flow: `planes.Solids`."""

    def __init__(self, solver: TotalLagrangian) -> None:
        assert solver.pairs is not None
        assert solver.body.contact is not None
        contact = solver.body.contact
        self._solver, self._pairs = solver, solver.pairs
        self._spacing = solver.particles.spacing
        self.stiffness, self.mass = contact.pair_stiffness, contact.mass
        self.friction, self.restitution = contact.friction, contact.restitution
        self.bodies = bodies_of(solver.particles, solver.body.per["density"])

    def motion(self) -> tuple[Floats, Floats]:
        """x [m] and v [m/s] of the contact samples, (m, 3)."""
        return self._pairs.motion(self._solver.state.view())

    def boxes(self) -> list[tuple[Floats, Floats, float]]:
        """The corners (3,) [m] of each body's bounding box, and the largest speed [m/s] of its
        samples.
        """
        x, v = self.motion()
        members = [m for m in self._pairs.members if len(m)]
        return [(x[m].min(0), x[m].max(0), fastest(v[m])) for m in members]

    def faces(self, x: Floats, face: Ints, gap: Floats, reach: float) -> list[SolidContact]:
        """See `planes.Solids`."""
        now = self._solver.state.view()
        place = self._pairs.motion(now)[0]
        out = []
        for k, members in enumerate(self._pairs.members):
            if not len(members):
                continue
            theirs = place[members]
            low = theirs.min(0) - reach - COVER * self._spacing
            high = theirs.max(0) + reach + COVER * self._spacing
            rows = np.flatnonzero(((x >= low) & (x <= high)).all(1))
            if not len(rows):
                continue
            # points inside at the last detection may still be; others that seem to be inside
            # may be at a fold of the surface
            was = (gap[rows] < 0.0) & (face[rows] == k)
            known = np.where(was, gap[rows] - EASE * self._spacing, 0.0)
            seen, carriers, weights = self._pairs.surface(
                k, x[rows], known, now.nodes[0], now.offset, reach
            )
            out.append(
                SolidContact(
                    body=k,
                    rows=rows[seen.rows],
                    gap=seen.gap,
                    normal=seen.normal,
                    point=seen.point,
                    carriers=carriers,
                    weights=weights,
                )
            )
        return out


class Exchange:
    """Advances a flow together with solid bodies: the `Partner` of their solver."""

    def __init__(self, solid: TotalLagrangian, flow: UpdatedLagrangian) -> None:
        assert solid.body.contact is not None
        self._solid, self._flow = solid, flow
        self._contact = solid.body.contact
        self._span = np.inf  # [s] upper bound of a span
        self._dt = 0.0  # [s] upper bound of the flow's substeps
        self._half: tuple[Floats, Floats, Ints, Floats] | None = None
        self.full = False  # whether the flow left its grid

    def begin_frame(self, index: int, dt: float) -> None:
        """Begin the frame `index`, with substeps of dt [s]."""
        self._dt, self.full = dt, False
        self._flow.begin(index)

    def detect(self, index: int, dt: float, done: int, left: int) -> tuple[int, float]:
        """See `Partner`."""
        if self.full:
            return left, 1.0
        frame = index - 1 + done * dt / self._flow.frame_time
        hold = self._flow.detect(frame, left * dt)
        self._span = self._stable()
        flow = self._flow.state.rows("v")
        self._solid.active.pushed = fastest(flow)
        chunk = int(np.clip(hold / dt, 1, left))
        return chunk, max(1.0, dt / self._span)

    def _stable(self) -> float:
        """[s] stable length of a span for the springs between the bodies.

        Springs of planes whose samples can touch, distributed to the samples of the surface, are at
        most a known factor stiffer than the floor's, whose frequency on the grid is known.
        """
        planes, contact = self._flow.planes, self._contact
        assert planes is not None
        at = planes.of_solids
        at = at[planes.gap[planes.rows[at]] < TRAVEL * self._flow.particles.spacing]
        if not len(at) or self._flow.settings.substeps:
            return np.inf
        rows = planes.rows[at]
        share = np.abs(planes.weights[rows])
        x = self._flow.state.sample_motion()[0] + self._flow.state.offset
        stiffer = planes.locate(x)
        ratio = 0.0
        for own, values in (
            (contact.stiffness, planes.values[at, 0] * stiffer),
            (contact.damping, planes.values[at, 1]),
        ):
            on = np.zeros(len(own))
            np.add.at(on, planes.carriers[rows], share * values[:, None])
            most = float((on / np.maximum(own, 1e-300)).max()) if own.any() else 0.0
            ratio = max(ratio, most)
        w = np.sqrt(ratio * contact.omega2)
        rate = ratio * contact.damping_rate
        # a damper of rate c / m over a span: bound c T / m by a quarter
        return float(min(STEP / max(w, 1e-300), 0.5 / max(rate, 1e-300)))

    def begin(self, substeps: int, dt: float) -> int:
        """See `Partner`."""
        flow = self._flow
        planes = flow.planes
        assert planes is not None
        if self.full:
            return substeps
        at = planes.of_solids
        many = substeps
        if len(at):
            many = int(np.clip(self._span / dt * (1.0 + 1e-9), 1, substeps))
        span = many * dt
        given = flow.march(span, self._dt)
        self.full = flow.state.grid_overflowed
        self._half = None
        if given is not None and len(at) and not self.full:
            J, L = given
            rows = planes.rows[at]
            self._half = -0.5 * J[at], -0.5 * L[at], planes.carriers[rows], planes.weights[rows]
            self._kick()
        return many

    def end(self) -> None:
        """See `Partner`."""
        if self._half is not None:
            self._kick()

    def _kick(self) -> None:
        """Apply half of the impulses to the solid bodies."""
        assert self._half is not None
        impulse, moment, carriers, weights = self._half
        hit = np.flatnonzero(impulse.any(1))
        if not len(hit):
            return
        solid = self._solid
        assert solid.pairs is not None
        x = solid.pairs.motion(solid.state.view())[0]
        out = np.zeros_like(x)
        np.add.at(
            out, carriers[hit],
            distributed_impulses(impulse[hit], moment[hit], x[carriers[hit]], weights[hit]),
        )  # fmt: skip
        solid.kick(out)


def distributed_impulses(J: Floats, L: Floats, x: Floats, weights: Floats) -> Floats:
    """Impulses (k, 3, 3) [N s] on triples of points at x (k, 3, 3) [m], with weights (k, 3).

    The sum of each triple is J (k, 3) [N s].  Its moment about the origin is L (k, 3) [N m s],
    unless the three points are collinear; then it is that of the weights.
    """
    out = weights[:, :, None] * J[:, None]
    left = L - cross(np.einsum("nk,nka->na", weights, x), J)
    r = x - x.mean(1, keepdims=True)
    return out + np.cross(turn(r, left)[:, None], r)
