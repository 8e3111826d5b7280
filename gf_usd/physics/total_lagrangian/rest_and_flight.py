"""Frames without substeps: bodies in free flight, and sleeping bodies.

A body is in free flight where no pin, goal, drag or field acts on it, nothing can touch it before
the next frame, and its deformation and rotation are negligible:

    |F - I| <= FLIGHT of every particle,    |v_i - vbar| <= FLIGHT c of every node

with c the slowest wave speed among the materials: a vibration with velocity FLIGHT c has a strain
of about FLIGHT. The frame is then the closed-form solution for all nodes, x += vbar t + g t^2 / 2
and v += g t; the remaining strain and vibration are left unchanged.

A body sleeps once its kinetic energy has been at most AT_REST m g0 r for a time T = sqrt(r / g0). A
sleeping body has v = 0 until another awake body or a moving obstacle comes near. Without gravity
bodies do not sleep, since a body without a support may drift.

All bodies share their substeps, so substeps are skipped only in frames in which every body is in
free flight or asleep.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.frame import AT_REST
from gf_usd.core.materials.dimensionless import G0, time_scale
from gf_usd.physics.contact.floor import pressed_step
from gf_usd.physics.contact.pairs import BodyContact
from gf_usd.physics.frame_loop import FrameStats
from gf_usd.physics.grid.bodies import bodies_of
from gf_usd.physics.laws.registry import ParticleLaws
from gf_usd.physics.time_step import (
    largest_mean,
    per_cell,
    stiffness,
    strained_step,
    substeps_of,
    wave_speed,
)
from gf_usd.physics.total_lagrangian.energies import kinetic_energies
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.shape_correction import is_active
from gf_usd.physics.total_lagrangian.state import State, StateView

FLIGHT = 1e-5  # strain, and speed relative to the wave speed: invisible, but above rounding
PRESSING = 1e-2  # [g0] gravity that would noticeably move an unsupported body within T


def presses(gravity: Any) -> bool:
    """Whether gravity (3,) [m/s^2] is strong enough to press bodies on their supports."""
    return float(np.linalg.norm(gravity)) > PRESSING * G0


class Shortcuts:
    """Decides which frames need no substeps; tracks how long each body has been at rest."""

    def __init__(self, body: Body, state: State) -> None:
        s = body.settings
        bodies = bodies_of(body.particles, body.per["density"])
        held = body.in_place
        possible = s.shortcuts and not is_active(s) and body.regions is None and not s.fields
        possible = possible and body.particles.keys is None
        self._body = body
        self._g = np.asarray(s.gravity, float)
        self._free = possible and not held and s.drag == 0.0
        self._flies = self._free and not state.acceleration.any()
        pressed = held or presses(self._g)
        self._sleeps = possible and pressed and not body.driven
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
        """Reset after a change of the loads: no body sleeps, and none is in free flight under a
        body force.
        """
        self.at_rest = np.zeros_like(self.at_rest)
        self._flies = self._free and not state.acceleration.any()

    def note(self, state: State, stats: FrameStats) -> None:
        """Update the rest times of the bodies after a frame with substeps."""
        if not self._sleeps:
            return
        self.depth = np.array([stats.penetration, stats.overlap])
        rests = kinetic_energies(self._body, state.view(), len(self.at_rest)) <= self._limit
        self.at_rest = np.where(rests, self.at_rest + self._body.settings.frame_time, 0.0)

    def take(
        self, state: State, pairs: BodyContact | None, near: Ints, substeps: int
    ) -> FrameStats | None:
        """Advance by a frame without substeps; None where the frame needs them.

        near : contact samples that the floor may reach within the frame.
        substeps : the number skipped, which the phase of the filter includes.
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
        state.advance_in_flight(flying, self._g, time)
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
            mine = now.v if len(flying) == 1 else now.v[nodes == body]
            if np.abs(mine - mine.mean(0)).max() > FLIGHT * self._wave:
                return False
        of = self._body.particles.body
        which = slice(None) if of is None else flying[of]
        if self._body.law.set.flows:  # plastic flow: the strain of F_e, rotated or not
            F = now.elastic(now.F)[which]
            return bool(np.abs(F.swapaxes(1, 2) @ F - np.eye(3)).max() <= FLIGHT)
        return bool(np.abs(now.F[which] - np.eye(3)).max() <= FLIGHT)

    def _near(self, near: Ints) -> Ints:
        """(B,) which bodies have a contact sample that the floor may reach."""
        out = np.zeros(len(self.at_rest), bool)
        if self._body.contact and len(near):
            of = self._body.contact.samples.body
            out[np.zeros(1, int) if of is None else of[near]] = True
        return out


class Fallen:
    """Detects bodies that have fallen below every obstacle of a scene without a floor.

    A body has fallen where all its nodes are lower, along gravity, than the lowest point that any
    obstacle reaches.
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
        """`fallen` and `fallen_kinetic` of `Health`; empty where a floor or pins make a fall
        impossible.
        """
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
    """Substeps per frame that the current strain requires; 1 where the settings prescribe them.

    Contact between samples uses shorter substeps: see `BodyContact.detect`.

    law : `Body.law_at`; depth : [m] of the deepest sample in the floor.
    stretch, J : of F_e. In a law with plastic flow a wave changes F by n (x) N, and so F_e by n (x)
    F_p^-T N. The stiffness on the reference grid is therefore that of F_e times |F_p^-1|^2:
    permanent compression of a cell shortens the time in which a wave crosses it.
    """
    if body.settings.substeps:
        return 1
    plastic = now.plastic_factor
    k = stiffness(law, stretch, J) * plastic
    nodes = body.stencil
    speed = wave_speed(k, body.per["density"], nodes.order, nodes.cell_start)
    damping = stretch[:, 2] ** 2 * plastic
    if body.damped is None:
        more = largest_mean(damping, nodes.order, nodes.cell_start)
    else:  # the rate at rest is exact, and may be that of the most stretched of them
        more = float(damping[body.damped].max())
    rest = pressed_step(body.contact, body.step, depth)
    dt = strained_step(
        rest, speed, body.h, per_cell(body.particles, body.h), body.frequency,
        damping=max(1.0, more),
    )  # fmt: skip
    return substeps_of(body.settings.frame_time, dt)
