"""Updated Lagrangian MLS-MPM: the usual way, to compare with (GaussianFlesh section 4.4).

The state is x, v, C, F and L = grad v on the particles.  The grid is built anew in every substep
around where they are now, fixed in the world, and forgotten: `kernels`.  Contact samples and mesh
vertices are embedded in the particles: `embedded_points`.  APIC acts in every substep, so there is
no filter rate.

Positions are kept relative to `offset`, which moves with the body by whole cells, so that a long
fall costs them no digits and the grid stays where it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames import Frame, Particles, Pose, Settings, SurfaceSamples
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Pin
from gf_usd.physics import taichi_arrays
from gf_usd.physics.contact.floor import pressed_step
from gf_usd.physics.frame_loop import FrameStats, Guard, Solver
from gf_usd.physics.time_step import per_cell, strained_step
from gf_usd.physics.updated_lagrangian.energies import measure, strained_speed, world_stiffness
from gf_usd.physics.updated_lagrangian.setup import build_body, refuse
from gf_usd.physics.updated_lagrangian.state import State
from gf_usd.physics.updated_lagrangian.walls import Wall

SERIAL_BELOW = 12_000  # particles; smaller bodies run all substeps in one launch


class UpdatedLagrangian(Solver):
    """One asset in motion; parameters as for `TotalLagrangian`, and walls.

    Raises UsageError for what only the other solver can do: pins, WLS and the shape correction.
    """

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
        h: float | None = None,
        real: type = np.float32,
    ) -> None:
        from gf_usd.system.taichi_runtime import init_taichi

        refuse(settings, pins)
        init_taichi(settings.device, settings.threads, f64=real is np.float64)
        self.particles, self.settings = particles, settings
        self.body = body = build_body(
            particles, materials, settings, samples=samples, embedded=embedded, velocity=velocity,
            walls=walls, h=h, real=real,
        )  # fmt: skip
        self.coarse = settings.substeps or max(1, int(np.ceil(self.frame_time / body.step.dt)))
        # What flows without end may go as far as it likes.
        flows = bool(body.law.unbounded.all())
        extent = np.inf if flows else float(np.linalg.norm(np.ptp(particles.X, axis=0)))
        self.guard = Guard(float(body.m.sum()) * G0 * particles.radius, extent)
        self.state = State(body)

    def not_finite(self) -> tuple[int, str]:
        """See `Solver`."""
        return self.state.not_finite()

    def advance(self, index: int, substeps: int) -> FrameStats:
        """Move by a frame; `index` is the frame that this leads to."""
        state = self.state
        before = state.save()
        active = self._launch(substeps)
        while state.lacks_room and state.make_room():
            state.load(before)
            active = self._launch(substeps)
        state.move_springs(0.5 * self.frame_time / substeps)
        state.take_wall_impulse()
        state.done += substeps
        state.time += substeps * (self.frame_time / substeps)
        state.recenter()
        stats = FrameStats(
            clamped=int(state.get("clamped").sum()),
            stress_capped=int(state.get("stress_capped").sum()),
            plastic_dissipation=state.take_dissipated(),
        )
        if not active:
            return stats
        return replace(
            stats,
            friction_capped=int(state.get("sample_capped").sum()),
            penetration=float(state.get("sample_depth").max()),
        )

    def _launch(self, substeps: int) -> int:
        """Run the kernels for a frame; how many samples were watched for contact."""
        import taichi as ti

        body, state, s, n = self.body, self.state, self.settings, len(self.particles)
        dt = self.frame_time / substeps
        state.clear("grid", "clamped", "stress_capped", "wall_impulse")
        lift = float(state.offset @ s.normal) - (s.floor or 0.0)
        active = state.watch_floor(lift)
        state.move_springs(-0.5 * dt)
        low, high = s.clamp or (0.0, 0.0)
        capacities = (state.node_capacity, state.cell_capacity)
        planes, whole = state.planes, ti.types.vector(3, ti.i32)
        vector = ti.types.vector(3, ti.f64 if body.real is np.float64 else ti.f32)
        tail = (
            *(vector(list(a)) for a in (s.gravity, s.normal, body.phase)),
            lift, dt, float(np.exp(-s.drag * dt)), 1.0 / body.h,
            s.stress_cap or 0.0, low, high, body.converged,
            *(whole(a.tolist()) for a in (planes.first, planes.last, planes.stuck)),
        )  # fmt: skip
        if n < SERIAL_BELOW:
            body.kernels.serial(state.pack, n, active, *capacities, substeps, *tail)
        else:
            body.kernels.start(state.pack, n, 0.5 * dt)
            for k in range(substeps):
                drift = dt if k < substeps - 1 else 0.5 * dt
                body.kernels.parallel(state.pack, n, active, *capacities, *tail, drift)
                if self.on_launch:
                    self.on_launch()
        return active

    def read(self, index: int) -> Frame:
        """See `Solver`."""
        from gf_usd.physics.per_particle import strains

        body, state, s = self.body, self.state, self.settings
        x, v, F, L = state.motion()
        cells = x / body.h - body.phase
        x = x + state.offset
        flows = body.law.set.flows
        if (grains := body.law.unbounded).any():
            # Grains keep their shape: what a neighborhood was strained by says nothing of them.
            F = np.where(grains[:, None, None], state.elastic, F)
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
            health=measure(
                pose, (stretch, J), C, body.m, body.h, s,
                elastic=elastic, contact=state.contact_energy(), flows=flows,
            ),
        )  # fmt: skip

    def _strained(self, stretch: Floats, J: Floats, cells: Floats) -> int:
        """Substeps a frame that the body as strained now asks for; none where they are given."""
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
        return self.asked(int(np.ceil(self.frame_time / dt)), depth)

    def von_mises(self) -> Floats:
        """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
        cap, value = self.settings.stress_cap or 0.0, self.state.value
        args = (self.state.pack, len(self.particles), value, cap, self.body.converged)
        self.body.kernels.stress(*args)
        return taichi_arrays.values(value).astype(float)
