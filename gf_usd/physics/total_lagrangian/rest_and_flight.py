"""Frames that need no substeps: bodies in free flight, and bodies that sleep.

A body flies where nothing holds it, drags on it or can touch it before the next frame, and where it
is as good as rigid and does not turn:

    |F - I| <= FLIGHT of every particle,    |v_i - vbar| <= FLIGHT c of every node

with c the slowest wave speed among the materials: a vibration with that speed has a strain of that
size.  It moves by the closed form, x += vbar t + g t^2 / 2 and v += g t for all its nodes alike;
what little strain and vibration it has stays as it is.

A body sleeps once its kinetic energy has been at most AT_REST m g0 r for T = sqrt(r / g0).  It
stands still with v = 0 until something reaches it: another body that is awake, or an obstacle that
moves.
Without gravity to press it on something it does not sleep, since it may drift.

All bodies share their substeps, so these are left out in the frames in which every body flies or
sleeps.  In all others a body that could have is simulated with the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import AT_REST
from gf_usd.core.materials.dimensionless import G0, time_scale
from gf_usd.physics.contact.floor import pressed_step
from gf_usd.physics.contact.pairs import BodyContact
from gf_usd.physics.frame_loop import FrameStats
from gf_usd.physics.grid.bodies import bodies_of
from gf_usd.physics.laws.registry import ParticleLaws
from gf_usd.physics.time_step import per_cell, stiffness, strained_step, wave_speed
from gf_usd.physics.total_lagrangian.energies import kinetic_energies
from gf_usd.physics.total_lagrangian.setup import Body
from gf_usd.physics.total_lagrangian.shape_correction import acts
from gf_usd.physics.total_lagrangian.state import State, StateView

FLIGHT = 1e-5  # strain, and speed over that of waves; far below what is seen, above rounding
PRESSING = 1e-2  # [g0] gravity that would have moved a body without support within T


def presses(gravity: Any) -> bool:
    """Whether gravity (3,) [m/s^2] presses bodies on what is below them."""
    return float(np.linalg.norm(gravity)) > PRESSING * G0


class Shortcuts:
    """Which frames need no substeps: how long each body has been at rest, and who flies."""

    def __init__(self, body: Body, state: State) -> None:
        s = body.settings
        bodies = bodies_of(body.particles, body.per["density"])
        held = body.in_place
        asked = s.shortcuts and not acts(s) and body.regions is None and not s.fields
        asked = asked and body.particles.keys is None
        self._body = body
        self._g = np.asarray(s.gravity, float)
        self._free = asked and not held and s.drag == 0.0
        self._flies = self._free and not state.acceleration.any()
        pressed = held or presses(self._g)
        self._sleeps = asked and pressed and not body.driven
        self._wave = float(body.per["wave_speed"].min())
        self._limit = AT_REST * bodies.mass * G0 * bodies.radius
        self._patience = np.array([time_scale(float(r)) for r in bodies.radius])
        self.at_rest = np.zeros(bodies.count)  # [s] since each body last moved
        self.depth = np.zeros(2)  # [m] penetration and overlap of the last frame with substeps

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {"at_rest": self.at_rest.copy(), "at_rest_depth": self.depth.copy()}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        self.at_rest = np.array(saved["at_rest"], float)
        self.depth = np.array(saved["at_rest_depth"], float)

    def wake(self, state: State) -> None:
        """What acts on the bodies was changed: none sleeps, and under a body force none flies."""
        self.at_rest = np.zeros_like(self.at_rest)
        self._flies = self._free and not state.acceleration.any()

    def note(self, state: State, stats: FrameStats) -> None:
        """See which bodies rest after a frame with substeps."""
        if not self._sleeps:
            return
        self.depth = np.array([stats.penetration, stats.overlap])
        rests = kinetic_energies(self._body, state.view(), len(self.at_rest)) <= self._limit
        self.at_rest = np.where(rests, self.at_rest + self._body.settings.frame_time, 0.0)

    def take(
        self, state: State, pairs: BodyContact | None, near: Ints, substeps: int
    ) -> FrameStats | None:
        """Move by a frame without substeps; None where that cannot be done.

        near : contact samples that the floor may reach within the frame; substeps : those left out,
        which the filter counts on.
        """
        sleeping = self._sleeps & (self.at_rest >= self._patience)
        flying = ~sleeping
        if flying.any():
            if not self._flies or self._near(near)[flying].any():
                return None
            if not self._rigid(state.view(), flying):
                return None
        if pairs and pairs.imminent(state.view(), state.time, sleeping):
            return None
        time = self._body.settings.frame_time
        state.fly(flying, self._g, time)
        state.time += time
        state.done += substeps
        if pairs:
            pairs.pass_by(flying, state.time)
        depth = self.depth if sleeping.any() else np.zeros(2)
        return FrameStats(
            penetration=float(depth[0]),
            overlap=float(depth[1]),
            flying=int(flying.sum()),
            sleeping=int(sleeping.sum()),
        )

    def _rigid(self, now: StateView, flying: Ints) -> bool:
        nodes = self._body.stencil.node_body[: len(now.v)]
        for body in np.flatnonzero(flying):
            mine = now.v[nodes == body]
            if np.abs(mine - mine.mean(0)).max() > FLIGHT * self._wave:
                return False
        of = self._body.particles.body
        which = slice(None) if of is None else flying[of]
        if self._body.law.set.flows:  # bent for good, it strains by F_e, and however it is turned
            F = now.elastic(now.F)[which]
            return bool(np.abs(F.swapaxes(1, 2) @ F - np.eye(3)).max() <= FLIGHT)
        return bool(np.abs(now.F[which] - np.eye(3)).max() <= FLIGHT)

    def _near(self, near: Ints) -> Ints:
        """(B,) bodies with a contact sample among those that the floor may reach."""
        out = np.zeros(len(self.at_rest), bool)
        if self._body.contact and len(near):
            of = self._body.contact.samples.body
            out[np.zeros(1, int) if of is None else of[near]] = True
        return out


class Fallen:
    """Which bodies have fallen past every obstacle, where there is no floor below.

    A body is below where all its nodes are deeper, along gravity, than the lowest point that any
    obstacle comes to.
    """

    def __init__(self, body: Body) -> None:
        s, setup = body.settings, body.contact_setup
        self._body = body
        self._count = bodies_of(body.particles, body.per["density"]).count
        self._level: float | None = None  # [m] along -g
        if s.floor is None and setup and presses(s.gravity) and not body.in_place:
            self._up = -np.asarray(s.gravity, float) / np.linalg.norm(s.gravity)
            self._level = setup.bottom(self._up)

    def measured(self, now: StateView) -> dict[str, Any]:
        """`fallen` and `fallen_kinetic` of `Health`; nothing where nothing can fall past."""
        if self._level is None:
            return {}
        body = self._body.stencil.node_body[: self._body.stencil.free_count]
        top = np.full(self._count, -np.inf)
        np.maximum.at(top, body, now.x[: len(body)] @ self._up)
        fallen = top < self._level
        kinetic = kinetic_energies(self._body, now, self._count)
        return {"fallen": int(fallen.sum()), "fallen_kinetic": float(kinetic[fallen].sum())}


def strained_substeps(
    body: Body, law: ParticleLaws, stretch: Floats, J: Floats, now: StateView, depth: float
) -> int:
    """Substeps a frame that a body as strained at a time [s] asks for; 1 where they are given.

    Contact between samples takes shorter ones: see `BodyContact.detect`.
    law : `Body.law_at`; depth : [m] of the deepest sample in the floor.
    stretch, J : of F_e.  Where a law flows, F changes by n (x) N, F_e by n (x) F_p^-T N, and so the
    stiffness in the grid's frame is that of F_e times |F_p^-1|^2: cells that are pressed flat for
    good are crossed sooner.
    """
    if body.settings.substeps:
        return 1
    k = stiffness(law, stretch, J) * now.plastic_factor
    nodes = body.stencil
    speed = wave_speed(k, body.per["density"], nodes.order, nodes.cell_start)
    rest = pressed_step(body.contact, body.step, depth)
    dt = strained_step(rest, speed, body.h, per_cell(body.particles, body.h), body.frequency)
    if dt == 0.0:  # a state that blew up: the guard judges it, and the step is halved from rest
        return 1
    return int(np.ceil(body.settings.frame_time / dt))
