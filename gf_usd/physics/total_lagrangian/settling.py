"""Rolling resistance, and damping of small bounces and residual vibration.

Rolling resistance is a moment of the floor that opposes rolling (Johnson 1985, section 9.4; Ai et
al. 2011, model A):

    |M| <= c N r,    r = (3 V / 4 pi)^(1/3)

with c the coefficient and N the weight m g_n on the floor. Over a frame its impulse changes the
velocities by a rotation about P, the point of the floor below the center of mass, which is the
instantaneous center of a rolling body:

    v_i += dw x (x_i - P),    dw = -min(1, c N r dt / |I w|, b) w,    I w = sum m_i (x_i - P) x v_i
    b = max(0, w . w_c / |w|^2)

with w and I restricted to the plane of the floor. The factor 1 bounds the impulse so that rolling
stops and does not reverse. w_c is the angular velocity about the center of mass. A sliding body has
an angular momentum about P as well; b is 0 for pure sliding and 1 for pure rolling, so that sliding
is not decelerated beyond Coulomb friction. On a static obstacle N is the force F = |sum f_s| on the
body, P the mean of the sample positions weighted by |f_s|, and the normal the direction of F.

Viscous damping of slow vibrations vanishes with their frequency. Two kinds of motion are therefore
damped between frames, like the bounce threshold and the stabilization threshold of PhysX:

Small bounces. The condition is a kinetic energy of at most LOW m g0 r and a center of mass within
REACH r, both for a time PATIENCE T with T = sqrt(r / g0), and at least one change between contact
and separation in that time. The translation then decays by dv_c/dt = -3/4 (1 - e^2) v_c / T, with e
the restitution of the material. A bounce of height r / 2 takes 2 T with a mean square speed of
v_0^2 / 3, and so loses the fraction 1 - e^2 of its energy, as for the restitution e.

Residual vibration. A body with a kinetic energy of at most CALM m g0 r and a center of mass within
AMPLITUDE r for a time T is damped as a whole by dv/dt = -v / (2 T): its kinetic energy decays by a
factor e in T.

A body in flight is not slow for that long, and a sliding or rolling one leaves these radii. Without
gravity neither acts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross, nonzero_rows, row_dots
from gf_usd.core.materials.dimensionless import G0, time_scale
from gf_usd.core.matrices import across
from gf_usd.physics.contact.planes import layout
from gf_usd.physics.contact.planes.contact_planes import OBSTACLE
from gf_usd.physics.grid.bodies import bodies_of, node_sums
from gf_usd.physics.taichi_arrays import host_view
from gf_usd.physics.total_lagrangian.energies import kinetic_energies
from gf_usd.physics.total_lagrangian.rest_and_flight import presses
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.state import State

CALM = 1e-2  # [m g0 r] energy of a bounce by a hundredth of the radius
AMPLITUDE = 0.05  # [r]
LOW = 0.5  # [m g0 r] energy of a bounce by half a radius
REACH = 0.5  # [r]
PATIENCE = 3.0  # [T] a bounce by half a radius takes 2 T


class Settling:
    """Applies rolling resistance and damping between frames: see the module."""

    def __init__(self, body: Body) -> None:
        s = body.settings
        bodies = bodies_of(body.particles, body.per["density"])
        free = not body.in_place and body.regions is None and not s.fields
        self._body = body
        self._touchable = body.contact is not None
        self._rolls = free and s.rolling > 0.0 and self._touchable and s.floor is not None
        setup = body.contact_setup
        walls = setup is not None and bool(setup.colliders)
        self._rolls_on_obstacles = free and s.rolling > 0.0 and self._touchable and walls
        self._calms = free and s.settling and presses(s.gravity)
        self._mass, self._radius = bodies.mass, bodies.radius
        self._scale = np.array([time_scale(float(r)) for r in bodies.radius])  # [s] T
        self._energy = bodies.mass * G0 * bodies.radius  # [J]
        restitution = body.per["density"] * body.particles.V0 * body.per["restitution"]
        e = np.bincount(bodies.of, restitution, bodies.count) / bodies.mass
        self._bounce_rate = 0.75 * (1.0 - e**2) / self._scale  # [1/s]
        self.calm = RestTimer(bodies.count)
        self.low = RestTimer(bodies.count)
        self.touching = np.zeros(bodies.count, bool)  # in contact at the end of the last frame
        self.bounced = np.zeros(bodies.count, bool)  # since its energy fell below LOW

    @property
    def active(self) -> bool:
        """Whether a body can lose energy here."""
        return self._rolls or self._rolls_on_obstacles or self._calms

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {
            "calm": self.calm.since.copy(), "calm_place": self.calm.place.copy(),
            "low": self.low.since.copy(), "low_place": self.low.place.copy(),
            "touching": self.touching.copy(), "bounced": self.bounced.copy(),
        }  # fmt: skip

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        self.calm.load(saved["calm"], saved["calm_place"])
        self.low.load(saved["low"], saved["low_place"])
        self.touching = np.array(saved["touching"], bool)
        self.bounced = np.array(saved["bounced"], bool)

    def wake(self) -> None:
        """Reset after a change of the loads."""
        self.calm.wake()
        self.low.wake()

    def frame(self, state: State) -> float | None:
        """Act after a frame with substeps; the dissipated energy [J], None where inactive."""
        if not self.active:
            return None
        count = len(self._mass)
        before = kinetic_energies(self._body, state.view(), count)
        body = self._body.stencil.node_body[: self._body.stencil.free_count]
        m, x = self._body.stencil.mass, state.view().x[: len(body)]
        mass = np.bincount(body, m, count)
        centers = node_sums(m[:, None] * x, body, count) / mass[:, None]
        rolling = self._on_floor(state) if self._rolls else np.zeros(count, bool)
        supports = self._supports(state) if self._rolls_on_obstacles else {}
        calm = self._nearly_at_rest(before, centers) if self._calms else np.zeros(count, bool)
        low = self._bounces(state, before, centers) if self._calms else np.zeros(count, bool)
        if not (rolling.any() or supports or calm.any() or low.any()):
            return 0.0
        v = state.rows("v")
        new = v[: len(body)].astype(float)
        if rolling.any():
            new += self._resist(m, x, new, body, centers, rolling)
        for k, support in supports.items():
            mine = body == k
            one = np.zeros(int(mine.sum()), int)
            most = np.array([self._most(support.force)[k]])
            pivot = support.point[None]
            new[mine] += resistance(m[mine], x[mine], new[mine], one, pivot, support.normal, most)
        rate = np.where(calm, 0.5 / self._scale, 0.0)
        new *= np.exp(-rate * self._body.settings.frame_time)[body][:, None]
        if low.any():
            rate = np.where(low & ~calm, self._bounce_rate, 0.0)
            mean = node_sums(m[:, None] * new, body, count) / mass[:, None]
            lost = -np.expm1(-rate * self._body.settings.frame_time)
            new -= (lost[:, None] * mean)[body]
        v[: len(body)] = new
        state.put("v", v)
        return float((before - kinetic_energies(self._body, state.view(), count)).sum())

    def _on_floor(self, state: State) -> Ints:
        """(B,) whether a sample of each body was in the floor during the frame."""
        assert self._body.contact is not None
        of = self._body.contact.samples.body
        depth = state.get("sample_depth")[: len(self._body.contact.samples.X)]
        out = np.zeros(len(self._mass), bool)
        out[0 if of is None else of[depth > 0.0]] = depth.any()
        return out

    def _supports(self, state: State) -> dict[int, Support]:
        """The forces of static obstacles on bodies, by body."""
        contact = self._body.contact
        assert contact is not None
        pair, n = state.rows("pair", layout.ROW), len(contact.samples.X)
        partner = state.rows("links", layout.LINKS)[: len(pair), layout.PARTNER].astype(int)
        point = (np.arange(len(pair)) >= n) & (partner >= 0)  # of an obstacle, in a body
        moves = np.where(point, layout.DRIFT, layout.VELOCITY)[:, None] + np.arange(3)
        fixed = (point | (partner == OBSTACLE)) & ~np.take_along_axis(pair, moves, 1).any(1)
        f = np.where(fixed[:, None], _three(pair, layout.FORCE), 0.0)
        f[point] *= -1.0
        pushed = np.flatnonzero(f.any(1))
        of = contact.samples.body
        of = np.zeros(n, int) if of is None else of
        of = np.append(of, of[np.maximum(partner[n:], 0)])
        # Not PLACE, which is relative to the offset during the frame: the first of the samples that
        # carry the plane of a point is next to it.
        place = state.view().samples
        place = np.append(place, place[np.maximum(partner[n:], 0)], axis=0)
        out = {}
        for k in np.unique(of[pushed]):
            mine = pushed[of[pushed] == k]
            total, size = f[mine].sum(0), np.linalg.norm(f[mine], axis=1)
            force = float(np.linalg.norm(total))
            if force > 0.0:
                point = size @ place[mine] / size.sum()
                out[int(k)] = Support(force=force, normal=total / force, point=point)
        return out

    def _bounces(self, state: State, kinetic: Floats, centers: Floats) -> Ints:
        """(B,) which bodies have made small bounces for PATIENCE T."""
        touching = self._touching(state) if self._touchable else np.zeros(len(kinetic), bool)
        step = self._body.settings.frame_time
        low = self.low.note(kinetic <= LOW * self._energy, centers, REACH * self._radius, step)
        self.bounced = low & (self.bounced | (touching != self.touching))
        self.touching = touching
        return self.bounced & (self.low.since >= PATIENCE * self._scale)

    def _touching(self, state: State) -> Ints:
        """(B,) whether a contact force acts on a sample of each body now."""
        assert self._body.contact is not None
        of = self._body.contact.samples.body
        forces = host_view(state.arrays["sample_force"]).reshape(-1, 3)
        pushed = nonzero_rows(forces[: len(self._body.contact.samples.X)])
        out = np.zeros(len(self._mass), bool)
        out[0 if of is None else of[pushed]] = len(pushed) > 0
        return out

    def _nearly_at_rest(self, kinetic: Floats, centers: Floats) -> Ints:
        """(B,) which bodies have been nearly at rest for T."""
        step = self._body.settings.frame_time
        self.calm.note(kinetic <= CALM * self._energy, centers, AMPLITUDE * self._radius, step)
        return self.calm.since >= self._scale

    def _most(self, force: Any) -> Floats:
        """(B,) [N m s] largest impulse of the moment in a frame, for a force [N] on each body."""
        s = self._body.settings
        return s.rolling * force * self._radius * s.frame_time

    def _resist(
        self, m: Floats, x: Floats, v: Floats, body: Ints, centers: Floats, rolling: Ints
    ) -> Floats:
        s = self._body.settings
        normal = np.asarray(s.normal, float)
        most = self._most(self._mass * max(0.0, -float(np.dot(s.gravity, normal))))
        height = centers @ normal - (s.floor or 0.0)
        pivot = centers - height[:, None] * normal
        return resistance(m, x, v, body, pivot, normal, np.where(rolling, most, 0.0))


@dataclass(frozen=True, kw_only=True)
class Support:
    """The total force of static obstacles on a body."""

    force: float  # [N]
    normal: Floats  # (3,) unit vector of the force
    point: Floats  # (3,) [m] P, its point of application


class RestTimer:
    """For how long each body has been slow and near one place, by its center of mass."""

    def __init__(self, count: int) -> None:
        self.since = np.zeros(count)  # [s]
        self.place = np.full((count, 3), np.inf)  # [m]

    def load(self, since: Floats, place: Floats) -> None:
        """Restore saved values."""
        self.since, self.place = np.array(since, float), np.array(place, float)

    def wake(self) -> None:
        """Reset."""
        self.since = np.zeros_like(self.since)

    def note(self, slow: Ints, centers: Floats, reach: Floats, step: float) -> Ints:
        """Update after a frame of step [s]; (B,) which bodies are slow and have stayed within reach
        [m].
        """
        still = slow & (np.linalg.norm(centers - self.place, axis=1) <= reach)
        self.place = np.where(still[:, None], self.place, centers)
        self.since = np.where(still, self.since + step, 0.0)
        return still


def _three(rows: Floats, at: int) -> Floats:
    return rows[:, at : at + 3]


def resistance(
    m: Floats, x: Floats, v: Floats, body: Ints, pivot: Floats, normal: Floats, most: Floats
) -> Floats:
    """dw x (x - P), (n, 3) [m/s]: the change of the velocities by rolling resistance.

    m : (n,) [kg], x : (n, 3) [m], v : (n, 3) [m/s], body : (n,) of the nodes.
    pivot : (B, 3) [m] P of each body; normal : (3,) unit normal of the floor.
    most : (B,) [N m s] the largest impulse of the moment.
    """
    count = len(most)
    arm = x - pivot[body]
    first, second = across(normal)
    flat = np.stack([second, -first], 1)
    w, spin = _rotation(m, arm, v, body, count, flat)
    mass = np.bincount(body, m, count)
    center = node_sums(m[:, None] * arm, body, count) / mass[:, None]
    own, _ = _rotation(m, arm - center[body], v, body, count, flat)
    square = (w**2).sum(1)
    turns = np.divide((w * own).sum(1), square, out=np.zeros(count), where=square > 0.0)
    moment = np.linalg.norm(spin, axis=1)
    share = np.divide(most, moment, out=np.ones(count), where=moment > most)
    share = np.minimum(share, np.clip(turns, 0.0, 1.0))
    return cross((-share[:, None] * w @ flat.T)[body], arm)


def _rotation(
    m: Floats, arm: Floats, v: Floats, body: Ints, count: int, flat: Floats
) -> tuple[Floats, Floats]:
    """w (B, 2) [1/s] and I w (B, 2) [N m s] of each body, in the plane spanned by the columns of
    `flat`.

    arm : (n, 3) [m] position relative to the center of rotation.
    """
    spin = node_sums(m[:, None] * cross(arm, v), body, count) @ flat
    # I = sum m (|a|^2 1 - a a^T), in the plane of the floor
    along = arm @ flat
    square = np.bincount(body, m * row_dots(arm, arm), count)
    products = (along[:, :, None] * along[:, None, :]).reshape(-1, 4)
    inertia = square[:, None, None] * np.eye(2)
    inertia = inertia - node_sums(m[:, None] * products, body, count).reshape(-1, 2, 2)
    return np.linalg.solve(inertia, spin[:, :, None])[:, :, 0], spin
