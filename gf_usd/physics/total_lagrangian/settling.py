"""What lets bodies come to rest on a floor: rolling resistance, and damping of the last trembling.

Rolling resistance is the moment by which the floor opposes the rolling of a body (Johnson 1985,
section 9.4; Ai et al. 2011, model A):

    |M| <= c m g_n r,    r = (3 V / 4 pi)^(1/3)

with c the coefficient, m g_n the weight on the floor.  Over a frame its impulse changes the
velocities by a rotation about the point P of the floor below the center of mass, where a body that
rolls stands still:

    v_i += dw x (x_i - P),    dw = -min(1, c m g_n r dt / |I w|) w,    I w = sum m_i (x_i - P) x v_i

w and I in the plane of the floor, so that it stops the body and does not turn it back.

A viscous material loses ever less in slow vibrations, and never all.  A body that has been calm for
T = sqrt(r / g0), with a kinetic energy of at most CALM m g0 r and its center of mass within
AMPLITUDE r, is damped as a whole, dv/dt = -v / (2 T): its kinetic energy falls e-fold in T.  In
flight no body is as slow for so long, and one that slides or rolls leaves that radius.  Game
engines do the same before they put a body to sleep (the stabilization threshold of PhysX).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials.dimensionless import G0, time_scale
from gf_usd.core.matrices import across
from gf_usd.physics.bodies import bodies_of, node_sums
from gf_usd.physics.total_lagrangian.energies import cross, kinetic_energies
from gf_usd.physics.total_lagrangian.setup import Body
from gf_usd.physics.total_lagrangian.state import State

CALM = 1e-2  # [m g0 r] a body with that energy bounces by a hundredth of its radius
AMPLITUDE = 0.05  # [r]


class Settling:
    """Takes energy from bodies on the floor between frames; see the module."""

    def __init__(self, body: Body) -> None:
        s = body.settings
        bodies = bodies_of(body.particles, body.per["density"])
        free = not body.in_place and body.regions is None and not s.fields
        self._body = body
        self._rolls = free and s.rolling > 0.0 and body.contact is not None
        self._calms = free and s.settling
        self._mass, self._radius = bodies.mass, bodies.radius
        self._patience = np.array([time_scale(float(r)) for r in bodies.radius])
        self._limit = CALM * bodies.mass * G0 * bodies.radius
        self.calm = np.zeros(bodies.count)  # [s] since each body last moved visibly
        self.place = np.full((bodies.count, 3), np.inf)  # [m] of its center of mass then

    @property
    def active(self) -> bool:
        """Whether anything may be taken from any body."""
        return self._rolls or self._calms

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {"calm": self.calm.copy(), "calm_place": self.place.copy()}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        self.calm = np.array(saved["calm"], float)
        self.place = np.array(saved["calm_place"], float)

    def wake(self) -> None:
        """What acts on the bodies was changed: none is calm."""
        self.calm = np.zeros_like(self.calm)

    def frame(self, state: State) -> float | None:
        """Energy [J] taken from the bodies after a frame with substeps; None where none can be."""
        if not self.active:
            return None
        count = len(self.calm)
        before = kinetic_energies(self._body, state.view(), count)
        body = self._body.stencil.node_body[: self._body.stencil.free_count]
        m, x = self._body.stencil.mass, state.view().x[: len(body)]
        mass = np.bincount(body, m, count)
        centers = node_sums(m[:, None] * x, body, count) / mass[:, None]
        rolling = self._on_floor(state) if self._rolls else np.zeros(count, bool)
        calm = self._calmed(before, centers) if self._calms else np.zeros(count, bool)
        if not (rolling.any() or calm.any()):
            return 0.0
        v = state.rows("v")
        new = v[: len(body)].astype(float)
        if rolling.any():
            new += self._resist(m, x, new, body, centers, rolling)
        rate = np.where(calm, 0.5 / self._patience, 0.0)
        new *= np.exp(-rate * self._body.settings.frame_time)[body][:, None]
        v[: len(body)] = new
        state.put("v", v)
        return float((before - kinetic_energies(self._body, state.view(), count)).sum())

    def _on_floor(self, state: State) -> Ints:
        """(B,) whether a sample of each body was in the floor during the frame."""
        assert self._body.contact is not None
        of = self._body.contact.samples.body
        depth = state.get("sample_depth")[: len(self._body.contact.samples.X)]
        out = np.zeros(len(self.calm), bool)
        out[0 if of is None else of[depth > 0.0]] = depth.any()
        return out

    def _calmed(self, kinetic: Floats, centers: Floats) -> Ints:
        """(B,) which bodies have been calm for T."""
        way = np.linalg.norm(centers - self.place, axis=1)
        calm = (kinetic <= self._limit) & (way <= AMPLITUDE * self._radius)
        self.place = np.where(calm[:, None], self.place, centers)
        self.calm = np.where(calm, self.calm + self._body.settings.frame_time, 0.0)
        return self.calm >= self._patience

    def _resist(
        self, m: Floats, x: Floats, v: Floats, body: Ints, centers: Floats, rolling: Ints
    ) -> Floats:
        s = self._body.settings
        normal = np.asarray(s.normal, float)
        weight = max(0.0, -float(np.dot(s.gravity, normal)))
        most = s.rolling * self._mass * weight * self._radius * s.frame_time
        height = centers @ normal - (s.floor or 0.0)
        pivot = centers - height[:, None] * normal
        return resistance(m, x, v, body, pivot, normal, np.where(rolling, most, 0.0))


def resistance(
    m: Floats, x: Floats, v: Floats, body: Ints, pivot: Floats, normal: Floats, most: Floats
) -> Floats:
    """dw x (x - P), (n, 3) [m/s]: the change of velocities by rolling resistance.

    m : (n,) [kg], x : (n, 3) [m], v : (n, 3) [m/s], body : (n,) of nodes.
    pivot : (B, 3) [m] P of each body; normal : (3,) unit, of the floor.
    most : (B,) [N m s] the largest impulse of the moment.
    """
    count = len(most)
    arm = x - pivot[body]
    first, second = across(normal)
    flat = np.stack([second, -first], 1)
    spin = node_sums(m[:, None] * cross(arm, v), body, count) @ flat
    # I = sum m (|a|^2 1 - a a^T), in the plane of the floor
    along = arm @ flat
    square = np.bincount(body, m * (arm**2).sum(1), count)
    products = (along[:, :, None] * along[:, None, :]).reshape(-1, 4)
    inertia = square[:, None, None] * np.eye(2)
    inertia = inertia - node_sums(m[:, None] * products, body, count).reshape(-1, 2, 2)
    w = np.linalg.solve(inertia, spin[:, :, None])[:, :, 0]
    moment = np.linalg.norm(spin, axis=1)
    share = np.divide(most, moment, out=np.ones(count), where=moment > most)
    return cross((-share[:, None] * w @ flat.T)[body], arm)
