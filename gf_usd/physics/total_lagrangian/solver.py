"""Total Lagrangian APIC: the production solver.

The state is a displacement u and a velocity v on the nodes of a grid that never moves
(docs/physics.md).  Everything that rides on the body, particles included, is read off them:
x = X + offset + W u, F = I + G u.  `offset` is a rigid translation taken out of u once a frame, so
that a long fall costs the strain no digits.  The paper's options are in `options` and `reanchor`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames import Frame, Particles, Pose, Settings, SurfaceSamples
from gf_usd.core.materials import G0, Material
from gf_usd.core.stage import Encounters, Pin
from gf_usd.physics import taichi_arrays
from gf_usd.physics.bodies import fastest, start_velocity
from gf_usd.physics.contact.active import attend, watch
from gf_usd.physics.contact.narrow_phase import pack_arrays
from gf_usd.physics.contact.pairs import Meeting
from gf_usd.physics.frame_loop import Guard, Marcher, Passage
from gf_usd.physics.grid.dependent_nodes import FREE_MASS
from gf_usd.physics.grid.embedding import pose, rider_rows
from gf_usd.physics.grid.pins import Holder, held_by
from gf_usd.physics.grid.reference import Rows, build_stencil
from gf_usd.physics.laws.registry import GRADIENT, particle_laws, take_dissipated
from gf_usd.physics.total_lagrangian import limits, setup
from gf_usd.physics.total_lagrangian.energies import measure, von_mises
from gf_usd.physics.total_lagrangian.launch import Launches
from gf_usd.physics.total_lagrangian.layout import batch_particles, from_lanes, single_particles
from gf_usd.physics.total_lagrangian.rest_and_flight import Shortcuts, strained_substeps
from gf_usd.physics.total_lagrangian.shape_correction import Reanchor
from gf_usd.physics.total_lagrangian.state import Moment, anchor, given

CELL_PER_LATTICE = 2.0  # h over the lattice's edge: eight strata, so eight particles, a full cell


class TotalLagrangian(Marcher):
    """One asset in motion.

    Parameters
    ----------
    particles, materials, settings : see `core.frames` and `core.materials`; any mix of laws.
    samples : surface points that feel the floor; None or no floor: no contact.
    riders : named points (n, 3) [m] that ride along; their poses come with every frame.
    velocity : (3,) [m/s] or a callable X (n, 3) -> (n, 3) [m/s]: the motion at the start; or a list
        of these, one a body.
    pins : regions whose motion is given.
    encounters : what the bodies meet besides the floor.
    rider_body : the body that a named set of points rides on; the first where it is not named.
    acceleration : X (n, 3) [m] -> (n, 3) [m/s^2]: a body force besides gravity, constant in time.
    real : numpy dtype of the kernels.
    plain : one thread a particle in place of eight cells side by side; None: on a GPU.

    Raises InputError for pins that hold nothing, or everything.
    """

    def __init__(
        self,
        particles: Particles,
        materials: Sequence[Material],
        settings: Settings,
        *,
        samples: SurfaceSamples | None = None,
        riders: Mapping[str, Floats] | None = None,
        velocity: Any = (0.0, 0.0, 0.0),
        pins: Sequence[Pin] = (),
        encounters: Encounters | None = None,
        rider_body: Mapping[str, int] | None = None,
        acceleration: Any = None,
        h: float | None = None,
        real: type = np.float32,
        plain: bool | None = None,
    ) -> None:
        from gf_usd.system.taichi_runtime import init_taichi

        init_taichi(settings.device, settings.threads, f64=real is np.float64)
        self.particles, self.settings, self.real = particles, settings, real
        self.holder = Holder(pins, particles.X) if pins else None
        held = self.holder.particles.pin if self.holder else None
        self.per = per = setup.per_particle(particles, materials, held)
        self.law = particle_laws(materials, particles.material, per)
        self.m = per["density"] * per["V0"]
        self.h = h or settings.cell or CELL_PER_LATTICE * particles.lattice
        self.stencil = build_stencil(
            particles.X,
            self.m,
            self.h,
            particles.corner,
            free_mass=FREE_MASS if settings.followers else 0.0,
            holder=self.holder,
            body=particles.body,
        )
        if self.holder:
            self.holder.check(self.stencil.held)
        self.rows = self.stencil.rows(particles.X, particles.body)
        on = rider_body or {}
        self.riders = {
            name: rider_rows(self.stencil, X, np.full(len(X), on.get(name, 0)))
            for name, X in (riders or {}).items()
        }
        if self.holder:
            self.held = {name: held_by(pins, X) for name, X in (riders or {}).items()}
            self.held[""] = self.holder.particles
        self.normal = settings.normal
        self.offset = np.asarray(settings.lift, float)
        start = start_velocity(velocity, self.stencil.node_X, self.stencil.node_body)
        meets = encounters is not None and encounters.any
        self.contact = setup.surface_contact(
            samples, particles, self.stencil, settings, per, pins,
            meets=meets,
            datum=encounters.lowest(self.normal) if encounters else np.inf,
            speed=fastest(start),
        )  # fmt: skip
        self.step = setup.largest_step(particles, self.h, self.contact, settings, per)
        self.coarse = settings.substeps or max(1, int(np.ceil(self.frame_time / self.step.dt)))
        extent = float(np.linalg.norm(np.ptp(particles.X, axis=0)))
        self.guard = Guard(float(self.m.sum()) * G0 * particles.radius, extent, particles.body)
        self.time = 0.0
        self.done = 0  # substeps since the start
        b = np.zeros((self.stencil.free_count, 3))
        self.acceleration = b if acceleration is None else acceleration(self.stencil.free_X)
        self._moment: Moment | None = None
        self.attended: Any = None  # contact samples that the kernels look at, see `attend`
        plain = settings.device != "cpu" if plain is None else plain
        several = self.law.of if self.law.set.several else None
        self.batches = (
            single_particles(self.stencil) if plain else batch_particles(self.stencil, several)
        )
        self.meeting = None
        if meets and encounters and self.contact:
            self.meeting = Meeting(encounters, self.contact, self)
        self.options = limits.options_of(settings, self.meeting is not None, plain)
        self.reanchor = Reanchor(self)
        self.shortcuts = Shortcuts(self)
        values = setup.arrays(
            particles, self.stencil, self.batches, self.contact, settings, per, self.law, start,
            self.acceleration, self.converged,
        ) | (self.meeting.arrays() if self.meeting else pack_arrays(0))  # fmt: skip
        self.arrays = setup.to_device(values | self.reanchor.start(self), real)
        self._start_kernels(bool((per["damping_time"] > 0).any()))

    def _start_kernels(self, damped: bool) -> None:
        import taichi as ti

        from gf_usd.physics.total_lagrangian.kernels.substep import build, pack_type
        from gf_usd.system.taichi_runtime import epoch

        kind = ti.f64 if self.real is np.float64 else ti.f32
        self.pack = pack_type(kind, epoch())(**self.arrays)
        self.kernels = build(self.law.set, damped, kind, epoch(), self.options)
        self._vec = ti.types.vector(3, kind)
        self.launches = Launches(self)
        self.cell_energy = ti.ndarray(kind, self.batches.cells.size)
        self.lane_stress = ti.ndarray(kind, self.batches.source.size)

    @property
    def _names(self) -> tuple[str, ...]:
        """Arrays that are the state."""
        return ("u", "v", "history") if self.law.set.flows else ("u", "v")

    def elastic(self, F: Floats) -> Floats:
        """F_e = F F_p^-1 of gradients F (N, 3, 3) of the particles."""
        if not self.law.set.flows:
            return F
        history = from_lanes(self.batches, taichi_arrays.values(self.arrays["history"]))
        return F @ history[:, :GRADIENT].reshape(-1, 3, 3).astype(float)

    def save(self) -> dict[str, Any]:
        """u and v of every node, F0, the offset, the time and the count of substeps."""
        state = {name: taichi_arrays.values(self.arrays[name]) for name in self._names}
        if self.options.anchored:
            state["F0"] = self.reanchor.F0.copy()
        if self.meeting:
            state |= self.meeting.save()
        state |= self.shortcuts.save()
        return {**state, "offset": self.offset.copy(), "time": self.time, "done": self.done}

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to what `save` returned."""
        for name in self._names:
            taichi_arrays.put(self.arrays[name], saved[name])
        if self.options.anchored:
            self.reanchor.put(self, saved["F0"])
        if self.meeting:
            self.meeting.restore(saved)
        self.shortcuts.restore(saved)
        self.offset = np.asarray(saved["offset"], float).copy()
        self.time, self.done = float(saved["time"]), int(saved["done"])

    def not_finite(self) -> tuple[int, str]:
        """See `Marcher`."""
        return self.moment().not_finite()

    def advance(self, index: int, substeps: int) -> Passage:
        """Move by a frame; `index` is the frame that this leads to."""
        anchor(self, index)
        limits.clear(self)
        near = watch(self, float(self.offset @ self.normal))
        self._moment = None  # no room for it during the substeps of a large body
        if (passage := self.shortcuts.take(self, near, substeps)) is not None:
            return passage
        if self.meeting:
            self.meeting.begin(self)
        dt, left = self.frame_time / substeps, substeps
        active = 0
        while left:
            chunk, watched = left, near
            if self.meeting:
                chunk = self.meeting.look(self, index, dt, (substeps - left), left)
                watched = np.union1d(near, self.meeting.faced.active)
            active = max(active, attend(self, watched))
            self.launches.run(self, chunk, dt, len(watched))
            left -= chunk
        self.time += substeps * dt
        self._recentre()
        touched = limits.touched(self)
        clipped, injected = self.reanchor.frame(self, index)
        work, given, overlap = self.meeting.passage(self) if self.meeting else (0.0, 0.0, 0.0)
        passage = Passage(
            work=float(taichi_arrays.values(self.arrays["work"]).astype(float).sum()) + work,
            injected=injected + given,
            overlap=overlap,
            let_go=self.meeting.let_go if self.meeting else 0,
            clamped=int((touched["clamped"] | clipped).sum()),
            stress_capped=int(touched["stress_capped"].sum()),
            plastic_dissipation=(
                take_dissipated(self.law.set, self.arrays["history"])
                if self.law.set.flows
                else None
            ),
        )
        if active:
            passage = replace(
                passage,
                friction_capped=int(taichi_arrays.values(self.arrays["sample_capped"]).sum()),
                penetration=float(taichi_arrays.values(self.arrays["sample_depth"]).max()),
            )
        self.shortcuts.note(self, passage)
        return passage

    def vector(self, values: Any) -> Any:
        """Three numbers as the kernels take them."""
        return self._vec([float(v) for v in values])

    @property
    def converged(self) -> float:
        return 1e-7 if self.real is np.float32 else 1e-15

    def _recentre(self) -> None:
        """Move the mean displacement from u to the offset; a pinned body stays where it is."""
        if self.holder:
            return
        u = taichi_arrays.values(self.arrays["u"]).astype(float).reshape(-1, 3)
        mean = self.stencil.mass @ u[: self.stencil.free_count] / self.stencil.mass.sum()
        self.offset = self.offset + mean
        taichi_arrays.put(self.arrays["u"], (u - mean).astype(self.real).ravel())

    def state(self) -> tuple[Floats, Floats]:
        """Displacement (without the offset) and velocity of the free nodes, (free, 3), float64."""
        now = self.moment()
        return now.u, now.v

    def moment(self) -> Moment:
        """The present state, with what was found out about it so far."""
        found = given(self)
        if self._moment is None or not self._moment.stands(found):
            self._moment = Moment(self, found)
        return self._moment

    def read(self, index: int) -> Frame:
        """See `Marcher`."""
        now = self.moment()
        particles = self.pose_at(now, index)
        stretch, J = now.strains(index, particles.F)
        elastic = now.elastic_strains(index)
        self.strained = strained_substeps(self, *elastic)
        return Frame(
            index=index,
            time=self.time,
            particles=particles,
            riders={
                n: self._held(n, rows, pose(rows, *now.nodes, self.offset), index)
                for n, rows in self.riders.items()
            },
            stress=von_mises(self) if self.settings.stress else None,
            health=measure(self, now, stretch, J, elastic),
        )

    def particle_pose(self, index: int) -> Pose:
        """x, v and F of the particles at frame `index`; F is what the stress is taken of."""
        return self.pose_at(self.moment(), index)

    def pose_at(self, now: Moment, index: int) -> Pose:
        """`particle_pose` of a state."""
        free = replace(now.particles, F=self.reanchor.anchored(now.F))
        return self._held("", self.rows, free, index)

    def gradients(self, now: Moment, index: int) -> Floats:
        """F (N, 3, 3) of `pose_at`."""
        if self.holder is None:
            return self.reanchor.anchored(now.F)
        return self.pose_at(now, index).F

    def _held(self, name: str, rows: Rows, free: Pose, index: int) -> Pose:
        if self.holder is None:
            return free
        of, offset = self.held[name], self.offset
        return self.holder.override(of, rows.X, free, index, self.frame_time, offset)
