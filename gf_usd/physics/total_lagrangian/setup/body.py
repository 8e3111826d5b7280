"""The constant data of one or several Total Lagrangian bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.frame import Pose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.floor import FloorContact
from gf_usd.physics.grid.embedding import SplineRows
from gf_usd.physics.grid.goals import NodeGoals
from gf_usd.physics.grid.mass import NodalMass
from gf_usd.physics.grid.pins import PinConstraint, PinnedPoints
from gf_usd.physics.grid.reference.stencil import Stencil
from gf_usd.physics.grid.rigid import RigidRegions
from gf_usd.physics.laws.registry import MODULI, ParticleLaws, convergence
from gf_usd.physics.time_step import StableStep
from gf_usd.physics.total_lagrangian import layout, limits

if TYPE_CHECKING:
    from types import SimpleNamespace


@dataclass(frozen=True, kw_only=True)
class Body:
    """The constant data of one or several bodies on one grid."""

    particles: Particles
    settings: Settings
    real: type  # numpy dtype of the kernels
    per: Mapping[str, Floats]  # material values of the particles, (N,) each: `per_particle`
    m: Floats  # (N,) [kg]; 0 for pinned particles
    h: float  # [m] edge of a cell
    stencil: Stencil
    mass: NodalMass  # of the free nodes
    rows: SplineRows  # of the particles on the nodes
    embedded: Mapping[str, SplineRows]  # of each set of embedded points
    pin_constraint: PinConstraint | None  # the pins
    regions: RigidRegions | None  # the rigid regions
    goals: NodeGoals | None  # springs that pull the free nodes to a pose
    held: Mapping[str, PinnedPoints]  # embedded points that a pin holds; "": particles
    contact: FloorContact | None
    contact_setup: ContactSetup | None  # contact besides that with the floor; None: there is none
    start: Floats  # (M, 3) [m/s] velocity of the nodes at the start
    step: StableStep
    frequency: float | None  # [c/h] highest at rest, c by `wave_speed`; None: by `grid_frequency`
    damped: Ints | None  # (N,) whether particles are damped; None: all alike
    layout: layout.Batches  # order of cells and particles in the kernels' arrays
    options: limits.Options
    law: ParticleLaws
    kernels: SimpleNamespace
    pack_type: Any  # of the kernels' arguments

    @property
    def in_place(self) -> bool:
        """Whether pins or goals determine the position of the body, so that it cannot fall as a
        whole.
        """
        pins = self.pin_constraint
        return (pins is not None and pins.prescribed) or self.goals is not None

    @property
    def driven(self) -> bool:
        """Whether pins or goals are animated."""
        pins, goals = self.pin_constraint, self.goals
        return (pins is not None and pins.moving) or (goals is not None and goals.moving)

    @property
    def converged(self) -> float:
        """See `convergence`."""
        return convergence(self.real)

    def law_at(self, index: int) -> ParticleLaws:
        """The constitutive laws between frames `index` - 1 and `index`, with the moduli at the
        middle.
        """
        if self.particles.keys is None:
            return self.law
        values, q = self.values_at(index), np.array(self.law.q)
        q[:MODULI] = values["mu"], values["lam"]
        return replace(self.law, q=q)

    def values_at(self, index: int) -> Mapping[str, Floats]:
        """`per` with animated values as they are in the middle between frames `index` - 1 and
        `index`.
        """
        keys = self.particles.keys
        if keys is None:
            return self.per
        return {**self.per, **keys.at(self.settings.time_code(max(index - 0.5, 0.0)))}

    @property
    def internal(self) -> tuple[str, ...]:
        """Names of the per-particle arrays that are part of the state besides u and v."""
        anchored = ("F0",) if self.options.anchored else ()
        return (*anchored, "history") if self.law.set.flows else anchored

    def constrained(
        self, name: str, rows: SplineRows, free: Pose, index: int, offset: Floats
    ) -> Pose:
        """The pose of embedded points (or "", the particles) at a frame, with pinned points as
        prescribed.

        rows, free : of the embedded points; offset : (3,) [m] of the moving frame.
        """
        if self.pin_constraint is None:
            return free
        time = self.settings.frame_time
        return self.pin_constraint.override(self.held[name], rows.X, free, index, time, offset)
