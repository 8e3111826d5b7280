"""Total Lagrangian APIC: the default solver of solid bodies.

The state is a displacement u and a velocity v on the nodes of a fixed grid (docs/physics.md).
Particles and embedded points are evaluated from them: x = X + offset + W u, F = I + G u. `offset`
is a rigid translation that is removed from u once a frame, so that a long fall costs the strain no
digits. The paper's options are in `limits` and `shape_correction`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.frame import Frame
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.keys import KEYED
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import ContactSetup, Goals, Pin
from gf_usd.physics.contact.active import ActiveSamples
from gf_usd.physics.contact.pairs import BodyContact
from gf_usd.physics.contact.planes.intervals import Lateness
from gf_usd.physics.frame_loop import FrameStats, Guard, Solver
from gf_usd.physics.grid.bodies import bodies_of
from gf_usd.physics.grid.embedding import embedded_pose
from gf_usd.physics.grid.fields import Fields
from gf_usd.physics.total_lagrangian.energies import measure, strain_energy, von_mises
from gf_usd.physics.total_lagrangian.launch import Launches
from gf_usd.physics.total_lagrangian.limits import limited_particles
from gf_usd.physics.total_lagrangian.rest_and_flight import Fallen, Shortcuts, strained_substeps
from gf_usd.physics.total_lagrangian.settling import Settling
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.setup.build import build_body
from gf_usd.physics.total_lagrangian.shape_correction import ShapeCorrection
from gf_usd.physics.total_lagrangian.state import State


class Partner(Protocol):
    """A second solver that advances together with a body within its frames, and applies impulses to
    it.
    """

    def detect(self, index: int, dt: float, done: int, left: int) -> tuple[int, float]:
        """Detect contact; for how many of the next `left` substeps the result holds, and into how
        many shorter ones each must at least be divided.

        index : the frame at the end of the interval; done : substeps of dt [s] since the frame
        before it.
        """
        ...

    def begin(self, substeps: int, dt: float) -> int:
        """Advance by some of the next `substeps` substeps of dt [s] and apply the impulses; their
        number.
        """
        ...

    def end(self) -> None:
        """Called after the body's substeps."""
        ...


class TotalLagrangian(Solver):
    """Bodies simulated by the Total Lagrangian method.

    Parameters
    ----------
    particles, materials, settings : see `core`; the materials may have different laws.
    samples : surface points of contact; None or no floor: no contact.
    embedded : named points (n, 3) [m] that move with the body; every frame has their poses.
    velocity : initial velocity, (3,) [m/s] or a callable X (n, 3) -> (n, 3) [m/s]; or a list of
        these, one per body.
    pins : regions with a prescribed motion.
    contact_setup : contact of the bodies besides that with the floor.
    goals : springs that pull the body to a pose; None: there are none.
    embedded_body : the body of a named set of points; by default the first.
    embedded_copy : the copies of cells that contain the points of a named set, where
        `particles.copies` has several.
    acceleration : X (n, 3) [m] -> (n, 3) [m/s^2]: a body force besides gravity, constant in time.
    real : numpy dtype of the kernels.
    plain : one thread per particle, instead of eight cells at once: the reference implementation.
    cells : one thread per cell; None: on a GPU.

    Raises InputError for pins that hold nothing, or everything.
    """

    body: Body
    state: State
    takes_forces = True

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
        contact_setup: ContactSetup | None = None,
        goals: Goals | None = None,
        embedded_body: Mapping[str, int] | None = None,
        embedded_copy: Mapping[str, Ints] | None = None,
        acceleration: Any = None,
        h: float | None = None,
        real: type = np.float32,
        plain: bool = False,
        cells: bool | None = None,
    ) -> None:
        from gf_usd.system.taichi_runtime import init_taichi

        init_taichi(settings.device, settings.threads, f64=real is np.float64)
        self.particles, self.settings = particles, settings
        self.body = body = build_body(
            particles, materials, settings, samples=samples, embedded=embedded, velocity=velocity,
            pins=pins, contact_setup=contact_setup, goals=goals, embedded_body=embedded_body,
            embedded_copy=embedded_copy, h=h, real=real, plain=plain, cells=cells,
        )  # fmt: skip
        self.coarse = settings.substeps or max(1, int(np.ceil(self.frame_time / body.step.dt)))
        extent = float(np.linalg.norm(np.ptp(particles.X, axis=0)))
        self.guard = Guard(float(body.m.sum()) * G0 * particles.radius, extent, particles.body)
        b = np.zeros((body.stencil.free_count, 3))
        self.state = State(body, b if acceleration is None else acceleration(body.stencil.free_X))
        self.active = ActiveSamples(body)
        self.pairs = BodyContact(body) if body.contact_setup else None
        self.correction = ShapeCorrection(body)
        self.shortcuts = Shortcuts(body, self.state)
        self.settling = Settling(body)
        self.fallen = Fallen(body)
        self.state.parts += [
            *([self.pairs] if self.pairs else []), self.shortcuts, self.settling
        ]  # fmt: skip
        self.launches = Launches(body, self.state)
        self.fields = Fields(settings)
        self._pushed = np.zeros((2, body.stencil.free_count, 3))  # of fields [N], positions [m]
        keys = particles.keys
        self._sample_particle = (
            _particle_of_samples(body) if keys and keys.changes("friction") else None
        )
        self.partner: Partner | None = None  # advances with the body, and pushes it

    @property
    def in_place(self) -> bool:
        """See `Solver`."""
        return self.body.in_place

    def not_finite(self) -> tuple[int, str]:
        """See `Solver`."""
        return self.state.view().not_finite()

    @property
    def lateness(self) -> Lateness | None:
        """See `Solver`."""
        return self.pairs.lateness if self.pairs else None

    def advance(self, index: int, substeps: int) -> FrameStats:
        """Advance by a frame, to frame `index`."""
        state, pairs, partner = self.state, self.pairs, self.partner
        state.prescribe(index)
        changed = self._follow_keys(index)
        self._push(index)
        state.clear("touched")
        near = self.active.near_floor(state, everywhere=partner is not None)
        if (stats := self.shortcuts.take(state, pairs, near, substeps)) is not None:
            return stats
        state.drop_view()  # free its memory for the substeps of a large body
        if pairs:
            pairs.begin(state)
        whole, left = self.frame_time / substeps, substeps
        stable = self.frame_time / min(substeps, max(self.coarse, self.strained))
        active = taken = 0
        last = 0.0  # [s] length of the previous substep
        while left:
            chunk, parts, low, paired = left, left, near, near[:0]
            shorter = 1.0
            if partner:
                chunk, shorter = partner.detect(index, whole, substeps - left, left)
                parts = int(np.ceil(chunk * shorter))
            if pairs:
                chunk, parts = pairs.detect(
                    state, index, whole, substeps - left, chunk, shorter=shorter, stable=stable,
                    strained=self.frame_time / self.strained,
                    floor=partial(self.active.nearer, state, near),
                )  # fmt: skip
                low = self.active.nearer(state, near, chunk * whole)
                paired = pairs.active
            dt = chunk * whole / parts
            if dt != last:  # friction springs are stored at the time of the last forces
                self.active.move_springs(state, 0.5 * (last - dt))
            watched = self.active.select(state, low, paired, dt)
            active = max(active, watched)
            self._run(parts, dt, watched)
            left, taken, last = left - chunk, taken + parts, dt
            if pairs and not pairs.follow(state, dt, closed=left == 0):
                break  # `next` rejects the frame and halves the step
        self.active.move_springs(state, 0.5 * last)
        state.time += substeps * whole
        state.recenter()
        if pairs:
            pairs.note_way(state.view(), state.time, whole)
        settled = self.settling.frame(state)
        stats = self._stats(index, active)
        stats = replace(
            stats, work=stats.work + changed, substeps=taken, settling_dissipation=settled
        )
        self.shortcuts.note(state, stats)
        return stats

    def _run(self, substeps: int, dt: float, active: int) -> None:
        """Run substeps of dt [s] with `active` contact samples, interleaved with those of a
        partner.
        """
        if self.partner is None:
            self.launches.run(self.state, substeps, dt, active, self.on_launch)
            return
        while substeps:
            many = self.partner.begin(substeps, dt)
            self.launches.run(self.state, many, dt, active, self.on_launch)
            self.partner.end()
            substeps -= many

    def kick(self, samples: Floats) -> None:
        """Apply impulses (n, 3) [N s] to the contact samples: v += M~^-1 W^T samples."""
        contact, state = self.body.contact, self.state
        assert contact is not None
        v = state.rows("v")
        change = self.body.mass.acceleration(contact.rows.W.T @ samples)
        v[: len(change)] += change
        state.put("v", v)

    def _stats(self, index: int, active: int) -> FrameStats:
        """The counts and energies of a frame with `active` contact samples; applies the shape
        correction.
        """
        body, state, pairs = self.body, self.state, self.pairs
        limited = limited_particles(state.get("touched"), body.options, body.layout, body.m)
        clipped, injected = self.correction.frame(state, index)
        work, given, overlap = pairs.totals(state) if pairs else (0.0, 0.0, 0.0)
        deepest = pairs.deepest_pair() if pairs else None
        stats = FrameStats(
            work=state.work() + work + self._work_of_fields(),
            injected=injected + given,
            planes=given,
            overlap=overlap,
            overlap_pair=" and ".join(deepest) if deepest else None,
            overlap_names=deepest,
            let_go=pairs.released if pairs else 0,
            clamped=int((limited["clamped"] | clipped).sum()),
            stress_capped=int(limited["stress_capped"].sum()),
            plastic_dissipation=state.take_dissipated(),
        )
        if not active:
            return stats
        return replace(
            stats,
            friction_capped=int(state.get("sample_capped").sum()),
            penetration=float(state.get("sample_depth").max()),
        )

    def _follow_keys(self, index: int) -> float:
        """Set the animated material values for frame `index`; the work [J] of this change on the
        strained body.

        The values are constant between two frames, so that the work of a change of moduli is the
        difference of the strain energies at the new and at the old moduli. Damping and friction do
        no work.
        """
        body, state = self.body, self.state
        if body.particles.keys is None:
            return 0.0
        state.put_values(index)
        before, now = body.values_at(index - 1), body.values_at(index)
        if self._sample_particle is not None and body.contact is not None:
            contact = replace(body.contact, friction=now["friction"][self._sample_particle])
            state.put("sample_constants", contact.law.ravel())
            if self.pairs:
                self.pairs.set_friction(contact)
        if any((before[name] != now[name]).any() for name in KEYED):
            self.settling.wake()
        old, new = body.law_at(index - 1), body.law_at(index)
        if np.array_equal(old.q, new.q):
            return 0.0
        strains = state.view().elastic_strains(index - 1)
        return strain_energy(body, new, *strains) - strain_energy(body, old, *strains)

    def _push(self, index: int) -> None:
        """Apply the body forces of the fields for the substeps to frame `index`."""
        if self.fields:
            x = self.state.view().x
            b = self.fields.at(x, index)
            self.state.put("acceleration", self.state.acceleration + b)
            self._pushed = np.stack([self.body.mass.momentum(b), x])

    def _work_of_fields(self) -> float:
        """[J] done by the fields since the start of the frame; the potential energy does not
        include it.
        """
        if not self.fields:
            return 0.0
        force, start = self._pushed
        return float((force * (self.state.view().x - start)).sum())

    def push(self, acceleration: Floats) -> None:
        """Replace the body force of the following frames: (free, 3) [m/s^2] besides gravity."""
        self.state.accelerate(np.asarray(acceleration, float))
        self.shortcuts.wake(self.state)
        self.settling.wake()

    def places(self) -> Floats:
        """See `Solver`; of the free nodes."""
        return self.state.view().x

    def throw(self, velocities: Floats) -> None:
        """See `Solver`."""
        v = self.state.rows("v")
        v[: len(velocities)] = velocities
        self.state.put("v", v)
        self.shortcuts.wake(self.state)
        self.settling.wake()

    def read(self, index: int) -> Frame:
        """See `Solver`."""
        body, state, pairs = self.body, self.state, self.pairs
        now, time = state.view(), state.time
        particles = now.pose(index)
        now.strains(index, particles.F)
        stretch, J = now.elastic_strains(index)
        depth = float(state.get("sample_depth").max())
        self.strained = self.required_substeps(
            strained_substeps(body, body.law_at(index), stretch, J, now, depth), depth
        )
        return Frame(
            index=index,
            time=time,
            particles=particles,
            embedded={
                name: body.constrained(
                    name, rows, embedded_pose(rows, now.node_motion, now.offset), index, now.offset
                )
                for name, rows in body.embedded.items()
            },
            stress=von_mises(body, state) if body.settings.stress else None,
            internal=now.internal(stretch) if body.settings.internal else {},
            health=replace(
                measure(body, now, index, pairs.energy(now, time) if pairs else 0.0),
                **self.fallen.measured(now),
                **(pairs.pierced(now, index) if pairs else {}),
            ),
        )  # fmt: skip


def _particle_of_samples(body: Body) -> Ints | None:
    """(n,) the particle whose material each contact sample has; None without contact."""
    if body.contact is None:
        return None
    samples, particles = body.contact.samples, body.particles
    of = np.zeros(len(samples.X), np.int64) if samples.body is None else samples.body
    return bodies_of(particles, body.per["density"]).nearest(samples.X, particles.X, of)
