"""Updated Lagrangian MLS-MPM (GaussianFlesh section 4.4), for flowing materials and for comparison.

The state is x, v, C, F and L = grad v of the particles. The grid is built in every substep around
their current positions and discarded afterwards: `kernels.substep`. Contact samples and mesh
vertices are embedded in the particles: `embedded_points`. APIC transfers occur in every substep, so
that there is no filter rate.

Positions are relative to `offset`, which moves with the body by whole cells: a long fall costs no
digits, and the grid does not shift relative to the world.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.frame import Frame, Pose
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import convertible
from gf_usd.core.stage import ContactSetup, Pin
from gf_usd.physics import taichi_arrays
from gf_usd.physics.contact.floor import FloorContact, pressed_step
from gf_usd.physics.frame_loop import FrameStats, Guard, Solver
from gf_usd.physics.taichi_arrays import Launcher
from gf_usd.physics.time_step import per_cell, strained_step, substeps_of
from gf_usd.physics.total_lagrangian.launch import GUESS, ends_of, fitting, require_resident
from gf_usd.physics.total_lagrangian.setup.contact import floor_height
from gf_usd.physics.total_lagrangian.stages import BLOCK
from gf_usd.physics.updated_lagrangian.conversion import Conversions
from gf_usd.physics.updated_lagrangian.energies import (
    Losses,
    measure,
    strained_speed,
    world_stiffness,
)
from gf_usd.physics.updated_lagrangian.planes import FlowPlanes, Solids
from gf_usd.physics.updated_lagrangian.setup import Body, build_body, refuse
from gf_usd.physics.updated_lagrangian.state import State
from gf_usd.physics.updated_lagrangian.walls import Wall

# particles; on a CPU smaller bodies run all substeps in one launch of one thread
SERIAL_BELOW = 12_000
ROUNDING = 1e-9  # relative tolerance of the length of a substep


class UpdatedLagrangian(Solver):
    """A flowing body, or an elastic one for comparison; parameters as for `TotalLagrangian`, and
    walls.

    Raises UsageError for options of the other solver only: pins, WLS and the shape correction.
    """

    body: Body
    state: State

    def __init__(
        self,
        particles: Particles,
        materials: Sequence[Material],
        settings: Settings,
        *,
        samples: SurfaceSamples | None = None,
        embedded: Mapping[str, Floats] | None = None,
        velocity: Any = (0.0, 0.0, 0.0),
        pins: Sequence[Pin] = (),
        walls: Sequence[Wall] = (),
        contact_setup: ContactSetup | None = None,
        h: float | None = None,
        real: type = np.float32,
    ) -> None:
        from gf_usd.system.taichi_runtime import init_taichi

        refuse(settings, pins)
        init_taichi(settings.device, settings.threads, f64=real is np.float64)
        self.particles, self.settings = particles, settings
        self.body = body = build_body(
            particles, materials, settings, samples=samples, embedded=embedded, velocity=velocity,
            walls=walls, h=h, real=real, contact_setup=contact_setup,
        )  # fmt: skip
        self.coarse = settings.substeps or max(1, int(np.ceil(self.frame_time / body.step.dt)))
        # There is no bound on the extent of a flow.
        flows = bool((body.law.unbounded | convertible(particles)).all())
        extent = np.inf if flows else float(np.linalg.norm(np.ptp(particles.X, axis=0)))
        self.guard = Guard(float(body.m.sum()) * G0 * particles.radius, extent)
        self.state = State(body)
        self._setup = contact_setup
        self.losses = Losses(settings, contact_setup, body.h, body.law.unbounded)
        self.planes: FlowPlanes | None = None
        # largest ratio of the stiffness of planes to that of the floor
        self._stiffness_ratio = body.contact.pair_ratio if body.contact else 1.0
        small = len(particles) < SERIAL_BELOW
        on_cpu = "serial" if small else "parallel"
        self.kernel = "resident" if settings.device == "cuda" else on_cpu
        self._launched: tuple[Any, Launcher] | None = None  # see `_launcher`
        self._pace = GUESS * len(particles)  # [s] a substep of the resident kernel
        if contact_setup is not None and contact_setup.colliders and body.pair_contact:
            passing = {c for _, c in contact_setup.through_colliders}
            count = len(body.contact.mass) if body.contact else 0
            self.face(contact_setup, through={c: np.full(count, True) for c in passing})
        self.conversions: Conversions | None = None
        if particles.conversions:
            self.conversions = Conversions(self, materials)
            self.state.parts.append(self.conversions)

    def face(
        self,
        setup: ContactSetup,
        solids: Solids | None = None,
        through: Mapping[int, Ints] | None = None,
    ) -> None:
        """Enable contact of the samples with obstacles and solid bodies: see `FlowPlanes`."""
        assert self.body.contact is not None
        self.state.parts = [one for one in self.state.parts if one is not self.planes]
        self.planes = FlowPlanes(
            self.body.contact, self.particles.spacing, setup, self.settings.gravity,
            self.particles.radius, self.frame_time, solids, through,
        )  # fmt: skip
        self.state.parts.append(self.planes)

    def follow(self, contact: FloorContact | None) -> None:
        """Use the laws and the contact samples of the body after a conversion."""
        body = self.body
        self.losses = Losses(self.settings, self._setup, body.h, body.law.unbounded)
        if self.planes is not None and contact is not None:
            self.planes.set_contact(contact)

    def places(self) -> Floats:
        """See `Solver`; of the particles."""
        return self.state.rows("x") + self.state.offset

    def throw(self, velocities: Floats) -> None:
        """See `Solver`; the affine part C of each particle's velocity becomes 0."""
        self.state.put("v", velocities)
        self.state.clear("C")

    def not_finite(self) -> tuple[int, str]:
        """See `Solver`."""
        return self.state.not_finite()

    def advance(self, index: int, substeps: int) -> FrameStats:
        """Advance by a frame, to frame `index`."""
        state = self.state
        before = state.save()
        while not self._frame(index, substeps) and state.extend_grid():
            state.load(before)
        return self.finish(substeps)

    def _frame(self, index: int, substeps: int) -> bool:
        """Advance by a frame; False where the grid's arrays were too small."""
        dt, planes = self.frame_time / substeps, self.planes
        self.begin(index)
        if planes is None:
            self.march(self.frame_time, dt)
            return not self.state.grid_overflowed
        done = 0
        while done < substeps and not self.state.grid_overflowed:
            span = (substeps - done) * dt
            hold = self.detect(index - 1 + done / substeps, span)
            chunk = int(np.clip(hold / dt, 1, substeps - done))
            self.march(chunk * dt, dt)
            done += chunk
        return not self.state.grid_overflowed

    def begin(self, index: int) -> None:
        """Begin the interval that ends at frame `index`."""
        state, s = self.state, self.settings
        if self.conversions:
            self.conversions.frame(index)
        state.clear("grid", "clamped", "stress_capped", "wall_impulse")
        self._lift = float(state.offset @ s.normal) - floor_height(s)
        self._near = state.near_floor(self._lift)
        self._active = state.watch(self._near, self._near[:0])
        self._watched = self._active > 0
        self._last = 0.0  # [s] length of the previous substep
        if self.planes:
            self.planes.begin()

    def detect(self, frame: float, span: float) -> float:
        """Detect the planes at a frame; the time [s] for which they hold, at most span [s]."""
        assert self.planes is not None
        x, v = self.state.sample_motion()
        hold = self.planes.detect(x + self.state.offset, v, frame, span)
        self._active = self.state.watch(self._near, self.planes.rows)
        self._watched = self._watched or self._active > 0
        return hold

    def march(self, span: float, dt: float) -> tuple[Floats, Floats] | None:
        """Advance by a span [s], in substeps of at most dt [s] that are stable for the planes'
        springs.

        Returns the impulses on the samples `planes.rows` as `FlowPlanes.follow` does; None without
        planes.
        """
        state, planes = self.state, self.planes
        faces = planes is not None and len(planes.rows) > 0
        if planes is not None and faces:
            stiffer = planes.locate(state.sample_motion()[0] + state.offset)
            if not self.settings.substeps:
                dt = min(dt, self.body.step.crowded(1.0 + self._stiffness_ratio * stiffer).dt)
        substeps = max(1, int(np.ceil(span / dt * (1.0 - ROUNDING))))
        dt = span / substeps
        state.move_springs(0.5 * (self._last - dt))
        self._last = dt
        if planes is None or not faces:
            self._launch(substeps, dt)
            return None
        plane, numbers = state.arrays["plane"], planes.numbers(state.offset, dt)
        taichi_arrays.put_first(plane, numbers.ravel())
        self._launch(substeps, dt)
        out = taichi_arrays.first(plane, numbers.size).astype(float).reshape(numbers.shape)
        return planes.follow(out, state.offset, span)

    def finish(self, substeps: int) -> FrameStats:
        """End a frame of `substeps` substeps."""
        state, planes = self.state, self.planes
        state.move_springs(0.5 * self._last)
        state.take_wall_impulse()
        state.done += substeps
        state.time += substeps * (self.frame_time / substeps)
        state.recenter()
        stats = FrameStats(
            clamped=int(state.get("clamped").sum()),
            stress_capped=int(state.get("stress_capped").sum()),
            plastic_dissipation=self._dissipated(),
            conversion_dissipation=self.conversions.dissipated if self.conversions else None,
            work=planes.work if planes else 0.0,
            injected=planes.injected if planes else 0.0,
            planes=planes.injected if planes else 0.0,
            overlap=planes.deepest if planes else 0.0,
            let_go=planes.released if planes else 0,
        )
        if not self._watched:
            return stats
        return replace(
            stats,
            friction_capped=int(state.get("sample_capped").sum()),
            penetration=float(state.get("sample_depth").max()),
        )

    def _dissipated(self) -> float | None:
        """[J] by plastic flow and by conversion in the frame; None where no law has
        plastic flow.
        """
        flow = self.state.take_dissipated()
        return flow if self.conversions is None or flow is None else (
            flow + self.conversions.dissipated
        )  # fmt: skip

    def _launch(self, substeps: int, dt: float) -> None:
        """Run the kernels for `substeps` substeps of dt [s]."""
        import taichi as ti

        body, state, s, n = self.body, self.state, self.settings, len(self.particles)
        active = self._active
        low, high = s.clamp or (0.0, 0.0)
        capacities = (state.node_capacity, state.cell_capacity)
        planes, whole = state.planes, ti.types.vector(3, ti.i32)
        vector = ti.types.vector(3, ti.f64 if body.real is np.float64 else ti.f32)
        tail = (
            *(vector(list(a)) for a in (s.gravity, s.normal, body.phase)),
            self._lift, dt, float(np.exp(-s.drag * dt)), 1.0 / body.h,
            s.stress_cap or 0.0, low, high, body.converged,
            *(whole(a.tolist()) for a in (planes.first, planes.last, planes.stuck)),
        )  # fmt: skip
        launch = self._launcher()
        if self.kernel == "serial":
            launch(n, active, *capacities, substeps, *tail)
        elif self.kernel == "resident":
            self._launch_resident((n, active, *capacities), substeps, tail)
        else:
            body.kernels.start(state.pack, n, 0.5 * dt)
            for k in range(substeps):
                drift = dt if k < substeps - 1 else 0.5 * dt
                launch(n, active, *capacities, *tail, drift)
                if self.on_launch:
                    self.on_launch()

    def _launcher(self) -> Launcher:
        """The launcher of the kernel for the current arrays."""
        pack = self.state.pack
        if self._launched is None or self._launched[0] is not pack:
            self._launched = pack, Launcher(getattr(self.body.kernels, self.kernel), pack)
        return self._launched[1]

    def _launch_resident(
        self, counts: tuple[int, ...], substeps: int, tail: tuple[Any, ...]
    ) -> None:
        """Launch the resident kernel, several times where the substeps take long."""
        launch, n = self._launcher(), counts[0]
        blocks = min(self.body.kernels.held, -(-n // BLOCK))
        done = 0
        while done < substeps:
            many = fitting(substeps - done, self._pace)
            began = time.perf_counter()
            launch(*counts, blocks, many, ends_of(done, many, substeps), *tail)
            require_resident(self.state, blocks)
            self._pace = (time.perf_counter() - began) / many
            done += many
            if self.on_launch:
                self.on_launch()

    def read(self, index: int) -> Frame:
        """See `Solver`."""
        from gf_usd.physics.per_particle import strains

        body, state, s = self.body, self.state, self.settings
        x, v, F, L = state.motion()
        cells = x / body.h - body.phase
        x = x + state.offset
        flows = body.law.set.flows
        if (grains := body.law.unbounded).any():
            # Grains do not deform with their neighborhood: they keep their shape.
            F = np.where(grains[:, None, None], state.elastic, F)
            # Plastic flow absorbs the strain rate of L; the elastic part rotates with its spin.
            L = np.where(grains[:, None, None], 0.5 * (L - L.transpose(0, 2, 1)), L)
        pose = Pose(x=x, v=v, F=F)
        stretch, J = strains(pose.F)
        elastic_strains = strains(state.elastic) if flows else (stretch, J)
        self.strained = self._strained(*elastic_strains, cells)
        C = state.rows("C", 9).reshape(-1, 3, 3)
        body.kernels.energy(state.pack, len(x), state.value, body.converged)
        elastic = float(taichi_arrays.values(state.value).astype(float).sum())
        return Frame(
            index=index,
            time=state.time,
            particles=pose,
            embedded={name: e.pose(x, v, F, L) for name, e in body.embedded.items()},
            stress=self.von_mises() if s.stress else None,
            internal=body.law.written(
                state.rows("history", body.law.set.history).astype(float), elastic_strains[0]
            )
            if s.internal and flows
            else {},
            converted=self.conversions.done.copy() if self.conversions else None,
            health=replace(
                measure(
                    pose, (stretch, J), C, body.m, body.h, s, elastic=elastic, flows=flows,
                    contact=state.contact_energy() + self._plane_energy(),
                ),
                **self.losses.measured(pose, body.m, self.particles.V0, elastic_strains[1]),
                converted=int(self.conversions.done.sum()) if self.conversions else None,
            ),
        )  # fmt: skip

    def _plane_energy(self) -> float:
        """[J] in the springs of the planes of the last detection."""
        if self.planes is None:
            return 0.0
        return self.planes.energy(self.state.sample_motion()[0] + self.state.offset)

    def _strained(self, stretch: Floats, J: Floats, cells: Floats) -> int:
        """Substeps per frame that the current strain requires; 1 where the settings
        prescribe them.
        """
        if self.settings.substeps:
            return 1
        body = self.body
        laws = body.law.set
        law = (
            body.law.hardened(self.state.rows("history", laws.history))
            if laws.hardens
            else body.law
        )
        k = world_stiffness(law, stretch, J)
        speed = strained_speed(k, body.per["density"], cells)
        depth = float(self.state.get("sample_depth").max())
        step = pressed_step(body.contact, body.step, depth)
        dt = strained_step(step, speed, body.h, per_cell(self.particles, body.h))
        return self.required_substeps(substeps_of(self.frame_time, dt), depth)

    def von_mises(self) -> Floats:
        """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
        cap, value = self.settings.stress_cap or 0.0, self.state.value
        args = (self.state.pack, len(self.particles), value, cap, self.body.converged)
        self.body.kernels.stress(*args)
        return taichi_arrays.values(value).astype(float)
