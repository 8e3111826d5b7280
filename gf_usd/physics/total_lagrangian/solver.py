"""Total Lagrangian APIC: the production solver.

The state is a displacement u and a velocity v on the nodes of a grid that never moves
(docs/physics.md).  Particles and embedded points are evaluated from them: x = X + offset + W u,
F = I + G u.  `offset` is a rigid translation taken out of u once a frame, so
that a long fall costs the strain no digits.  The paper's options are in `limits` and
`shape_correction`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import Frame, Particles, Settings, SurfaceSamples
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.keys import KEYED
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import ContactSetup, Goals, Pin
from gf_usd.physics.contact.active import ActiveSamples
from gf_usd.physics.contact.pairs import BodyContact
from gf_usd.physics.frame_loop import FrameStats, Guard, Solver
from gf_usd.physics.grid.bodies import bodies_of
from gf_usd.physics.grid.embedding import pose
from gf_usd.physics.grid.fields import Fields
from gf_usd.physics.total_lagrangian.energies import measure, strain_energy, von_mises
from gf_usd.physics.total_lagrangian.launch import Launches
from gf_usd.physics.total_lagrangian.limits import touched
from gf_usd.physics.total_lagrangian.rest_and_flight import Fallen, Shortcuts, strained_substeps
from gf_usd.physics.total_lagrangian.settling import Settling
from gf_usd.physics.total_lagrangian.setup import Body, build_body
from gf_usd.physics.total_lagrangian.shape_correction import ShapeCorrection
from gf_usd.physics.total_lagrangian.state import State


class Partner(Protocol):
    """A second solver that advances with a body within its frames, and gives it impulses."""

    def detect(self, index: int, dt: float, done: int, left: int) -> tuple[int, float]:
        """How many of `left` substeps what is found near now holds for, and how many shorter ones
        each is divided into at least.

        index : the frame that is marched to; done : substeps of dt [s] since the frame before it.
        """
        ...

    def begin(self, substeps: int, dt: float) -> int:
        """Advance over the next of so many substeps of dt [s], and push the body; how many."""
        ...

    def end(self) -> None:
        """They are done."""
        ...


class TotalLagrangian(Solver):
    """One asset in motion.

    Parameters
    ----------
    particles, materials, settings : see `core`; materials of any mix of laws.
    samples : surface points at which contact acts; None or no floor: no contact.
    embedded : named points (n, 3) [m] that move with the body; every frame has their poses.
    velocity : (3,) [m/s] or a callable X (n, 3) -> (n, 3) [m/s]: the motion at the start; or a list
        of these, one a body.
    pins : regions whose motion is given.
    contact_setup : what the bodies meet besides the floor.
    goals : springs that draw the body to a pose; None: none do.
    embedded_body : the body of a named set of points; the first where it is not named.
    embedded_copy : the copies of cells that the points of a named set are in, where
        `particles.copies` has several.
    acceleration : X (n, 3) [m] -> (n, 3) [m/s^2]: a body force besides gravity, constant in time.
    real : numpy dtype of the kernels.
    plain : one thread a particle, instead of eight cells side by side: the reference of tests.
    cells : one thread a cell; None: on a GPU.

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
        self._pushed = np.zeros((2, body.stencil.free_count, 3))  # [N] of fields, and [m] where
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

    def advance(self, index: int, substeps: int) -> FrameStats:
        """Move by a frame; `index` is the frame that this leads to."""
        state, pairs, partner = self.state, self.pairs, self.partner
        state.prescribe(index)
        changed = self._follow_keys(index)
        self._push(index)
        state.clear("touched")
        near = self.active.near_floor(state, everywhere=partner is not None)
        state.drop_view()  # a large body's substeps need its memory
        if (stats := self.shortcuts.take(state, pairs, near, substeps)) is not None:
            return stats
        if pairs:
            pairs.begin(state)
        whole, left = self.frame_time / substeps, substeps
        active = taken = 0
        last = 0.0  # [s] the substep before
        while left:
            chunk, parts, low, paired = left, left, near, near[:0]
            shorter = 1.0
            if partner:
                chunk, shorter = partner.detect(index, whole, substeps - left, left)
                parts = int(np.ceil(chunk * shorter))
            if pairs:
                chunk, parts = pairs.detect(
                    state, index, whole, substeps - left, chunk, floor=near, shorter=shorter
                )
                low = self.active.nearer(state, near, chunk * whole)
                paired = pairs.planes.active
            dt = chunk * whole / parts
            if dt != last:  # springs stand where the forces before are taken, half a step back
                self.active.move_springs(state, 0.5 * (last - dt))
            watched = self.active.select(state, low, paired, dt)
            active = max(active, watched)
            self._run(parts, dt, watched)
            left, taken, last = left - chunk, taken + parts, dt
            if pairs and not pairs.follow(state, dt, closed=left == 0):
                break  # `next` throws the frame away, and halves its step
        self.active.move_springs(state, 0.5 * last)
        state.time += substeps * whole
        state.recenter()
        settled = self.settling.frame(state)
        stats = self._stats(index, active)
        stats = replace(
            stats, work=stats.work + changed, substeps=taken, settling_dissipation=settled
        )
        self.shortcuts.note(state, stats)
        return stats

    def _run(self, substeps: int, dt: float, active: int) -> None:
        """So many substeps of dt [s] with `active` contact samples, and what a partner does."""
        if self.partner is None:
            self.launches.run(self.state, substeps, dt, active, self.on_launch)
            return
        while substeps:
            many = self.partner.begin(substeps, dt)
            self.launches.run(self.state, many, dt, active, self.on_launch)
            self.partner.end()
            substeps -= many

    def kick(self, samples: Floats) -> None:
        """Give the contact samples impulses (n, 3) [N s]: v += M~^-1 W^T of them."""
        contact, state = self.body.contact, self.state
        assert contact is not None
        v = state.rows("v")
        change = self.body.mass.acceleration(contact.rows.W.T @ samples)
        v[: len(change)] += change
        state.put("v", v)

    def _stats(self, index: int, active: int) -> FrameStats:
        """What was noticed in a frame with `active` contact samples, after the shape correction."""
        body, state, pairs = self.body, self.state, self.pairs
        limited = touched(state.get("touched"), body.options, body.layout, body.m)
        clipped, injected = self.correction.frame(state, index)
        work, given, overlap = pairs.totals(state) if pairs else (0.0, 0.0, 0.0)
        stats = FrameStats(
            work=state.work() + work + self._work_of_fields(),
            injected=injected + given,
            planes=given,
            overlap=overlap,
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
        """Set the material values of the way to a frame; [J] that this does to what is strained.

        They are constant on the way between two frames, so that all work of the moduli is done
        here: the strain energy at the new ones less that at the old ones.  Damping and friction
        do none.
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
        """Let the fields push on the way to a frame."""
        if self.fields:
            x = self.state.view().x
            b = self.fields.at(x, index)
            self.state.put("acceleration", self.state.acceleration + b)
            self._pushed = np.stack([self.body.mass.momentum(b), x])

    def _work_of_fields(self) -> float:
        """[J] since the start of the frame; the potential energy knows nothing of them."""
        if not self.fields:
            return 0.0
        force, start = self._pushed
        return float((force * (self.state.view().x - start)).sum())

    def push(self, acceleration: Floats) -> None:
        """Replace the body force of the frames to come: (free, 3) [m/s^2] besides gravity."""
        self.state.accelerate(np.asarray(acceleration, float))
        self.shortcuts.wake(self.state)
        self.settling.wake()

    def places(self) -> Floats:
        """See `Solver`; of the nodes that nothing holds."""
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
                name: body.constrained(name, rows, pose(rows, *now.nodes, now.offset), index,
                                       now.offset)
                for name, rows in body.embedded.items()
            },
            stress=von_mises(body, state) if body.settings.stress else None,
            internal=now.internal(stretch) if body.settings.internal else {},
            health=replace(
                measure(body, now, index, pairs.energy(now, time) if pairs else 0.0),
                **self.fallen.measured(now),
            ),
        )  # fmt: skip


def _particle_of_samples(body: Body) -> Ints | None:
    """(n,) the particle that each contact sample has its material of; None without contact."""
    if body.contact is None:
        return None
    samples, particles = body.contact.samples, body.particles
    of = np.zeros(len(samples.X), np.int64) if samples.body is None else samples.body
    return bodies_of(particles, body.per["density"]).nearest(samples.X, particles.X, of)
