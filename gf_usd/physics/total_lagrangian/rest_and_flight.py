"""Frames that need no substeps: bodies in free flight, and bodies that sleep.

A body flies where nothing holds it, drags on it or can touch it before the next frame, and where it
is as good as rigid and does not turn:

    |F - I| <= FLIGHT of every particle,    |v_i - vbar| <= FLIGHT c of every node

with c the slowest wave speed among the materials: a vibration with that speed has a strain of that
size.  It moves by the closed form, x += vbar t + g t^2 / 2 and v += g t for all its nodes alike;
what little strain and vibration it has stays as it is.

A body sleeps once its kinetic energy has been at most REST m g0 r for T = sqrt(r / g0).  It stands
still with v = 0 until something reaches it: another body that is awake, or an obstacle that moves.
Without gravity to press it on something it does not sleep, since it may drift.

All bodies share their substeps, so these are left out in the frames in which every body flies or
sleeps.  In all others a body that could have is simulated with the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials import G0, time_scale
from gf_usd.physics import taichi_arrays
from gf_usd.physics.bodies import bodies_of
from gf_usd.physics.contact.pairs import CROWD
from gf_usd.physics.frame_loop import Passage
from gf_usd.physics.time_step import per_cell, stiffness, strained_step, wave_speed
from gf_usd.physics.total_lagrangian.energies import kinetic_energies

if TYPE_CHECKING:
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


FLIGHT = 1e-5  # strain, and speed over that of waves; far below what is seen, above rounding
REST = 1e-7  # of m g0 r: a speed of 4.5e-4 sqrt(g0 r), 1.4 mm/s for a ball of 1 m
PRESSING = 1e-2  # [g0] gravity that would have moved a body without support within T


class Shortcuts:
    """What a solver knows of its bodies for it: how long each has been at rest."""

    def __init__(self, solver: TotalLagrangian) -> None:
        s = solver.settings
        bodies = bodies_of(solver.particles, solver.per["density"])
        held = solver.holder is not None
        plain = s.shortcuts and not solver.reanchor.acts
        self._g = np.asarray(s.gravity, float)
        self._flies = plain and not held and s.drag == 0.0 and not solver.acceleration.any()
        pressed = held or float(np.linalg.norm(self._g)) > PRESSING * G0
        self._sleeps = plain and pressed and not (solver.holder and solver.holder.moving)
        self._wave = float(solver.per["wave_speed"].min())
        self._limit = REST * bodies.mass * G0 * bodies.radius
        self._patience = np.array([time_scale(float(r)) for r in bodies.radius])
        self.at_rest = np.zeros(bodies.count)  # [s] since each body last moved
        self.depth = np.zeros(2)  # [m] penetration and overlap of the last frame with substeps

    def save(self) -> dict[str, Any]:
        """What `restore` wants."""
        return {"at_rest": self.at_rest.copy(), "at_rest_depth": self.depth.copy()}

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to what `save` returned."""
        self.at_rest = np.array(saved["at_rest"], float)
        self.depth = np.array(saved["at_rest_depth"], float)

    def note(self, solver: TotalLagrangian, passage: Passage) -> None:
        """See which bodies rest after a frame with substeps."""
        if not self._sleeps:
            return
        self.depth = np.array([passage.penetration, passage.overlap])
        rests = kinetic_energies(solver, len(self.at_rest)) <= self._limit
        self.at_rest = np.where(rests, self.at_rest + solver.frame_time, 0.0)

    def take(self, solver: TotalLagrangian, near: Ints, substeps: int) -> Passage | None:
        """Move by a frame without substeps; None where that cannot be done.

        near : contact samples that the floor may reach within the frame; substeps : those left out,
        which the filter counts on.
        """
        sleeping = self._sleeps & (self.at_rest >= self._patience)
        flying = ~sleeping
        if flying.any():
            if not self._flies or _near(solver, near, len(flying))[flying].any():
                return None
            if not self._rigid(solver, flying):
                return None
        if solver.meeting and solver.meeting.imminent(solver, sleeping):
            return None
        self._move(solver, flying)
        solver.done += substeps
        depth = self.depth if sleeping.any() else np.zeros(2)
        return Passage(
            penetration=float(depth[0]),
            overlap=float(depth[1]),
            flying=int(flying.sum()),
            sleeping=int(sleeping.sum()),
        )

    def _rigid(self, solver: TotalLagrangian, flying: Ints) -> bool:
        u, v = solver.state()
        nodes = solver.stencil.node_body[: len(v)]
        for body in np.flatnonzero(flying):
            mine = v[nodes == body]
            if np.abs(mine - mine.mean(0)).max() > FLIGHT * self._wave:
                return False
        of = solver.particles.body
        which = slice(None) if of is None else flying[of]
        if solver.law.set.flows:  # it may be bent for good: strain is that of F_e, however turned
            F = solver.elastic(solver.moment().F)[which]
            return np.abs(F.swapaxes(1, 2) @ F - np.eye(3)).max() <= FLIGHT
        return all(np.abs((G @ u)[which]).max() <= FLIGHT for G in solver.rows.G)

    def _move(self, solver: TotalLagrangian, flying: Ints) -> None:
        time = solver.frame_time
        u, v = (
            taichi_arrays.values(solver.arrays[name]).astype(float).reshape(-1, 3) for name in "uv"
        )
        nodes, m = solver.stencil.node_body, solver.stencil.mass
        mine = nodes[: len(m)]
        mean = np.stack([np.bincount(mine, m * v[: len(m), a], len(flying)) for a in range(3)], 1)
        mean /= np.bincount(mine, m, len(flying))[:, None]
        way = np.where(flying[:, None], mean * time + 0.5 * self._g * time**2, 0.0)
        # What moves all bodies moves the frame of u, which then keeps its digits.
        common = way[0] if (way == way[0]).all() else m @ way[mine] / m.sum()
        solver.offset = solver.offset + common
        u += (way - common)[nodes]
        v = np.where(flying[nodes][:, None], v + self._g * time, 0.0)
        taichi_arrays.put(solver.arrays["u"], u.astype(solver.real).ravel())
        taichi_arrays.put(solver.arrays["v"], v.astype(solver.real).ravel())
        solver.time += time
        if solver.meeting:
            solver.meeting.pass_by(flying, solver.time)


def _near(solver: TotalLagrangian, near: Ints, bodies: int) -> Ints:
    """(B,) bodies with a contact sample among those that the floor may reach."""
    out = np.zeros(bodies, bool)
    if solver.contact and len(near):
        of = solver.contact.samples.body
        out[np.zeros(1, int) if of is None else of[near]] = True
    return out


def strained_substeps(solver: TotalLagrangian, stretch: Floats, J: Floats) -> int:
    """Substeps a frame that a body as strained now asks for; 1 where they are given."""
    if solver.settings.substeps:
        return 1
    step = solver.step
    if solver.meeting and solver.meeting.imminent(solver):
        step = step.crowded(CROWD)
    k = stiffness(solver.law, stretch, J)
    nodes = solver.stencil
    speed = wave_speed(k, solver.per["density"], nodes.order, nodes.cell_start)
    dt = strained_step(step, speed, solver.h, per_cell(solver.particles, solver.h))
    return int(np.ceil(solver.frame_time / dt))
