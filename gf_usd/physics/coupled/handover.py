"""Bodies that are solid until the first of their particles is converted, and flow from then on.

The Total Lagrangian solver simulates a body until, at the end of a frame, one of its particles has
exceeded its limit. The state of the body is then transferred (`transfer`) to the Updated Lagrangian
solver, where the particles beyond their limit are converted (`updated_lagrangian.conversion`) and
the others keep their law.

Convertible particles then move to random positions (by d at rest, `Particles.scatter`),

    x = x_p + F d,   v = v_p + Fdot d,

since rows of a lattice would persist in a flow. Before, they are at the quadrature points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.frame import Frame, Health
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.conversion import STRESS
from gf_usd.core.materials.laws import law_internals
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import ContactSetup, Goals, Pin
from gf_usd.physics.coupled.parts import flowing_bodies, passing_obstacles, used_materials
from gf_usd.physics.coupled.solver import Coupled, refuse
from gf_usd.physics.coupled.transfer import (
    SolidState,
    copy_flow,
    copy_solid,
    flow_of,
    flowing_particles,
    read_solid,
    solid_of,
    write_flow,
)
from gf_usd.physics.frame_loop import FrameStats, Guard, Solver
from gf_usd.physics.taichi_arrays import Saved
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.conversion import past_limits
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian

FLOWING = "bodies_that_flow"  # in a saved state


class Converting(Solver):
    """Bodies of which some particles can be converted, and others; parameters as for `Coupled`.

    Raises UsageError for options that such a bake does not support.
    """

    def __init__(
        self,
        particles: Particles,
        materials: Sequence[Material],
        settings: Settings,
        *,
        samples: SurfaceSamples,
        embedded: Mapping[str, Floats] | None = None,
        velocity: Any = (0.0, 0.0, 0.0),
        pins: Sequence[Pin] = (),
        contact_setup: ContactSetup,
        goals: Goals | None = None,
        embedded_body: Mapping[str, int] | None = None,
        embedded_copy: Mapping[str, Ints] | None = None,
        h: float | None = None,
        real: type = np.float32,
    ) -> None:
        refuse(settings, pins, goals)
        if pins:
            raise UsageError(
                "a bake with --conversion does not support pins", "leave out one of the two"
            )
        self.particles, self.settings = particles, settings
        self._materials, self._samples = tuple(materials), samples
        self._velocity, self._setup = velocity, contact_setup
        self._more = {"embedded": embedded, "h": h, "real": real}
        self._on = {"embedded_body": embedded_body, "embedded_copy": embedded_copy}
        stressed = any(one.limit.kind == STRESS for one in particles.conversions)
        self._own = replace(
            settings, shortcuts=False, settling=False, rolling=0.0,
            stress=settings.stress or stressed,
        )  # fmt: skip
        first = replace(particles, conversions=())
        self.flows: NDArray[np.bool_] = flowing_bodies(first, materials)
        self._moved: Floats | None = None  # (N, 3) [m] d of the flowing particles
        if particles.scatter is not None:
            some = np.unique(np.concatenate([one.particles for one in particles.conversions]))
            self._moved = _centered(particles, some[particles.scatter[some].any(1)])
        self.now = self._solver()

    def _solver(self) -> Solver:
        """The solver of the bodies, of which `flows` (B,) flow, in its initial state."""
        flows, particles = self.flows, replace(self.particles, scatter=None)
        body = particles.body_of
        if self._moved is not None:
            X = particles.X + np.where(flows[body][:, None], self._moved, 0.0)
            particles = replace(particles, X=X)
        mine = tuple(
            replace(one, particles=rows)
            for one in particles.conversions
            if len(rows := one.particles[flows[body[one.particles]]])
        )
        samples = self._samples.with_grains(particles, flows & self._sampled_surfaces())
        particles = replace(particles, conversions=mine)
        more: dict[str, Any] = {**self._more, "samples": samples, "velocity": self._velocity}
        if flows.all():
            particles, materials = used_materials(replace(particles, copies=None), self._materials)
            own = replace(self._own, solver="ul")
            walls = ContactSetup(skins=(), colliders=self._setup.colliders, flows=True)
            made = UpdatedLagrangian(particles, materials, own, contact_setup=walls, **more)
            if walls.colliders and made.planes is not None:
                assert samples.body is not None
                made.face(walls, through=passing_obstacles(self._setup, samples.body))
            return made
        more |= {**self._on, "contact_setup": self._setup}
        if flows.any():
            return Coupled(particles, self._materials, self._own, flows=flows, **more)
        particles, materials = used_materials(particles, self._materials)
        return TotalLagrangian(particles, materials, replace(self._own, solver="tl"), **more)

    def _sampled_surfaces(self) -> NDArray[np.bool_]:
        """(B,) which bodies have contact samples of their surface, not of their particles."""
        body = self._samples.body
        of = np.zeros(len(self._samples.X), int) if body is None else np.asarray(body)
        if self._samples.normal is None:
            return np.ones(len(self.flows), bool)
        surfaces = np.asarray(self._samples.normal).any(1)
        return np.bincount(of, surfaces, len(self.flows)) > 0.0

    # the solver that currently advances the bodies has the values of `Solver`

    @property
    def body(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Solver`."""
        return self.now.body

    @property
    def guard(self) -> Guard:  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Solver`."""
        return self.now.guard

    @property
    def coarse(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Solver`."""
        return self.now.coarse

    @property
    def strained(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Solver`."""
        return self.now.strained

    @property
    def state(self) -> Saved:  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Solver`."""
        return self.now.state

    @property
    def damping_ratio(self) -> float:
        """See `Solver`."""
        return self.now.damping_ratio

    @property
    def contact_factor(self) -> float:
        """See `Solver`."""
        return self.now.contact_factor

    def pressed(self, depth: float) -> int:
        """See `Solver`."""
        return self.now.pressed(depth)

    def advance(self, index: int, substeps: int) -> FrameStats:
        """See `Solver`."""
        self.now.on_launch = self.on_launch
        return self.now.advance(index, substeps)

    def not_finite(self) -> tuple[int, str]:
        """See `Solver`."""
        return self.now.not_finite()

    def places(self) -> Floats:
        """See `Solver`."""
        return self.now.places()

    def throw(self, velocities: Floats) -> None:
        """See `Solver`."""
        self.now.throw(velocities)

    def save(self) -> dict[str, Any]:
        """See `Solver`."""
        return {**self.now.save(), FLOWING: self.flows.copy()}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Solver`."""
        flows = np.asarray(saved[FLOWING], bool)
        if (flows != self.flows).any():
            self.flows = flows
            self.now = self._solver()
        self.now.load(saved)

    def read(self, index: int) -> Frame:
        """See `Solver`; particles that are past their limit at the start are converted first."""
        frame = self.now.read(index)
        return self._with_conversions(self._hand_over(frame, index) if index == 0 else frame)

    def next(self, index: int, last: Health) -> Frame:
        """See `Solver`; after the frame, bodies that begin to flow change their solver."""
        self.now.on_launch = self.on_launch
        return self._with_conversions(self._hand_over(self.now.next(index, last), index))

    def _with_conversions(self, frame: Frame) -> Frame:
        """A frame with the conversions so far, and without a stress output that was not
        requested.
        """
        converted = frame.converted
        if converted is None:
            converted = np.zeros(len(self.particles), bool)
        health, internal = frame.health, dict(frame.internal)
        if self.settings.internal:  # of all laws, also those without particles at present
            nothing = np.full(len(self.particles), np.nan)
            for variable in law_internals(one.law for one in self._materials):
                internal.setdefault(variable.name, nothing)
        return replace(
            frame,
            internal=internal,
            stress=frame.stress if self.settings.stress else None,
            converted=converted,
            health=replace(
                health,
                converted=health.converted or 0,
                conversion_dissipation=health.conversion_dissipation or 0.0,
                plastic_dissipation=health.plastic_dissipation or 0.0,
            ),
        )

    def _hand_over(self, frame: Frame, index: int) -> Frame:
        """The frame after a change of solver of the bodies that begin to flow in it."""
        body = self.particles.body_of
        waiting = tuple(
            one for one in self.particles.conversions if not self.flows[body[one.particles]].all()
        )
        if not waiting:
            return frame
        passed = past_limits(
            waiting, self.flows[body], self.settings.time_code(index), frame.particles.F,
            frame.stress,
        )  # fmt: skip
        new = np.bincount(body, passed) > 0.0
        if not new.any():
            return frame
        before, solid = self.now, solid_of(self.now)
        assert solid is not None
        numbers = np.flatnonzero(~self.flows)
        mine = [read_solid(solid, int(k)) for k in np.flatnonzero(new[numbers])]
        if self._moved is not None:
            mine = [one.moved(self._moved[self._rows(numbers[one.body])]) for one in mine]
        self.flows = self.flows | new
        self.now = self._solver()
        self.now.guard.load(before.guard.save())
        self._transfer(before, numbers, mine, frame.time)
        after = self.now.read(index)
        seen = frame.health
        given = after.health.energy - seen.energy
        lost = max(0.0, -given)
        return replace(
            after,
            embedded=frame.embedded,
            health=replace(
                after.health,
                injected=seen.injected + max(0.0, given),
                plastic_dissipation=(seen.plastic_dissipation or 0.0) + lost,
                conversion_dissipation=(seen.conversion_dissipation or 0.0) + lost,
                **{
                    name: getattr(seen, name)
                    for name in (
                        "substeps", "rollbacks", "penetration", "overlap", "overlap_pair",
                        "overlap_names", "pierced", "pierced_through", "pierced_pair", "let_go",
                        "work", "planes", "clamped", "stress_capped", "friction_capped",
                    )
                },
            ),
        )  # fmt: skip

    def _transfer(
        self, before: Solver, numbers: Ints, mine: Sequence[SolidState], time: float
    ) -> None:
        """Transfer the state from the previous solver to the new one.

        numbers : of the bodies that were solid; mine : their particles in the new flow.
        """
        flow_before, solid_before = flow_of(before), solid_of(before)
        flow, solid = flow_of(self.now), solid_of(self.now)
        assert flow is not None
        assert solid_before is not None
        body = self.particles.body_of
        at = np.flatnonzero(self.flows[body])
        if flow_before is not None:
            was = flowing_particles(before, body)
            copy_flow(flow_before, flow, np.searchsorted(at, was))
        write_flow(
            flow, [(np.searchsorted(at, self._rows(numbers[one.body])), one) for one in mine]
        )
        flow.state.time = time
        if solid is not None:
            left = np.flatnonzero(~self.flows[numbers])
            copy_solid(solid_before, solid, left)
            solid.state.time = time

    def _rows(self, body: int) -> Ints:
        """The particles of a body."""
        return np.flatnonzero(self.particles.body_of == body)


def _centered(particles: Particles, rows: Ints) -> Floats:
    """(N, 3) [m] displacements `scatter` of particles `rows`, without the mean of each body."""
    assert particles.scatter is not None
    out = np.zeros((len(particles), 3))
    body, V0, d = particles.body_of[rows], particles.V0[rows], particles.scatter[rows]
    for k in np.unique(body):
        mine = body == k
        out[rows[mine]] = d[mine] - np.average(d[mine], axis=0, weights=V0[mine])
    return out
