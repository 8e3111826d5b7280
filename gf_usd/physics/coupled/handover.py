"""Bodies that are solid until the first of their particles is converted, and flow from then on.

The Total Lagrangian solver has a body until, at the end of a frame, one of its particles has passed
its limit.  Then the Updated Lagrangian solver takes it over, where the particles that are past
their limit are converted (`updated_lagrangian.conversion`) and the others keep their law.

Taken over are x, F, the internal variables and, of the nodal velocities v_i, what particles see of
them,

    v_p = W v + dv + w x (x_p - c),   C_p = s grad v

dv and w are such that momentum and angular momentum are those of the body before, and s in [0, 1]
such that its kinetic energy is, as far as that goes: an affine motion C holds the energy
m h^2 |C|^2 / 8 and the angular momentum m h^2 axial(C) / 4 on its own.  What is left of the
difference of the energies, and what springs of contact held, is counted: as lost by conversion
where it is less after, as injected where it is more.

Particles that can be converted then go to random places (by d at rest, `Particles.scatter`),

    x = x_p + F d,   v = v_p + Fdot d,

since rows of a lattice stay rows in what flows.  Before, they are where quadrature is most exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.core.frames import Frame, Health, Particles, Settings, SurfaceSamples
from gf_usd.core.materials.conversion import STRESS
from gf_usd.core.materials.laws import law_internals
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import ContactSetup, Goals, Pin
from gf_usd.physics.coupled.parts import flowing_bodies, in_use, passing_obstacles
from gf_usd.physics.coupled.solver import Coupled, refuse
from gf_usd.physics.frame_loop import FrameStats, Guard, Solver, energy
from gf_usd.physics.grid.embedding import stretches
from gf_usd.physics.laws.registry import GRADIENT, ParticleLaws
from gf_usd.physics.taichi_arrays import Saved
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.conversion import past_limits
from gf_usd.physics.updated_lagrangian.energies import axial
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian

PLACED = 1e-6  # [cells] that nodes of the same place in two grids may be apart


class Converting(Solver):
    """Bodies some of whose particles can be converted, and others; parameters as for `Coupled`.

    Raises UsageError for what such a bake does not know.
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
        self._moved: Floats | None = None  # (N, 3) [m] at rest, of what flows
        if particles.scatter is not None:
            some = np.unique(np.concatenate([one.particles for one in particles.conversions]))
            self._moved = _centered(particles, some[particles.scatter[some].any(1)])
        self.now = self._solver()

    def _solver(self) -> Solver:
        """The solver of the bodies, of which `flows` (B,) do so, at their start."""
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
        samples = self._samples.with_grains(particles, flows & self._shelled())
        particles = replace(particles, conversions=mine)
        more: dict[str, Any] = {**self._more, "samples": samples, "velocity": self._velocity}
        if flows.all():
            particles, materials = in_use(replace(particles, copies=None), self._materials)
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
        particles, materials = in_use(particles, self._materials)
        return TotalLagrangian(particles, materials, replace(self._own, solver="tl"), **more)

    def _shelled(self) -> NDArray[np.bool_]:
        """(B,) which bodies have samples of their surface, and not yet their particles."""
        body = self._samples.body
        of = np.zeros(len(self._samples.X), int) if body is None else np.asarray(body)
        if self._samples.normal is None:
            return np.ones(len(self.flows), bool)
        surfaces = np.asarray(self._samples.normal).any(1)
        return np.bincount(of, surfaces, len(self.flows)) > 0.0

    # What a solver is asked for is what the one that moves the bodies now says.

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
        return {**self.now.save(), "bodies_that_flow": self.flows.copy()}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Solver`."""
        flows = np.asarray(saved["bodies_that_flow"], bool)
        if (flows != self.flows).any():
            self.flows = flows
            self.now = self._solver()
        self.now.load(saved)

    def read(self, index: int) -> Frame:
        """See `Solver`; what is past its limit at the start is handed over first."""
        frame = self.now.read(index)
        return self._told(self._after(frame, index) if index == 0 else frame)

    def next(self, index: int, last: Health) -> Frame:
        """See `Solver`; after the frame, bodies that begin to flow are handed over."""
        self.now.on_launch = self.on_launch
        return self._told(self._after(self.now.next(index, last), index))

    def _told(self, frame: Frame) -> Frame:
        """A frame with what was converted so far, and without a stress that nobody asked for."""
        converted = frame.converted
        if converted is None:
            converted = np.zeros(len(self.particles), bool)
        health, internal = frame.health, dict(frame.internal)
        if self.settings.internal:  # of all laws, also those that nothing has yet, or no longer
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

    def _after(self, frame: Frame, index: int) -> Frame:
        """A frame after the bodies in it that begin to flow have changed their solver."""
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
        mine = [taken(solid, int(k)) for k in np.flatnonzero(new[numbers])]
        if self._moved is not None:
            mine = [one.moved(self._moved[self._rows(numbers[one.body])]) for one in mine]
        self.flows = self.flows | new
        self.now = self._solver()
        self.now.guard.load(before.guard.save())
        self._carry(before, numbers, mine, frame.time)
        after = self.now.read(index)
        seen = frame.health
        given = energy(after.health) - energy(seen)
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
                        "substeps", "rollbacks", "penetration", "overlap", "let_go", "work",
                        "planes", "clamped", "stress_capped", "friction_capped",
                    )
                },
            ),
        )  # fmt: skip

    def _carry(self, before: Solver, numbers: Ints, mine: Sequence[Taken], time: float) -> None:
        """Give the new solver the state of the one before.

        numbers : of the bodies that were solid; mine : what the new flow takes over of them.
        """
        flow_before, solid_before = flow_of(before), solid_of(before)
        flow, solid = flow_of(self.now), solid_of(self.now)
        assert flow is not None
        assert solid_before is not None
        body = self.particles.body_of
        at = np.flatnonzero(self.flows[body])
        if flow_before is not None:
            was = at_of(before, body)
            carry_flow(flow_before, flow, np.searchsorted(at, was))
        place(flow, [(np.searchsorted(at, self._rows(numbers[one.body])), one) for one in mine])
        flow.state.time = time
        if solid is not None:
            left = np.flatnonzero(~self.flows[numbers])
            carry_solid(solid_before, solid, left)
            solid.state.time = time

    def _rows(self, body: int) -> Ints:
        """The particles of a body."""
        return np.flatnonzero(self.particles.body_of == body)


def solid_of(solver: Solver) -> TotalLagrangian | None:
    """The part of a solver that moves the solid bodies; None: there are none."""
    if isinstance(solver, Coupled):
        return solver.solid
    return solver if isinstance(solver, TotalLagrangian) else None


def _centered(particles: Particles, rows: Ints) -> Floats:
    """(N, 3) [m] the moves `scatter` of particles `rows`, but those of the centers of bodies."""
    assert particles.scatter is not None
    out = np.zeros((len(particles), 3))
    body, V0, d = particles.body_of[rows], particles.V0[rows], particles.scatter[rows]
    for k in np.unique(body):
        mine = body == k
        out[rows[mine]] = d[mine] - np.average(d[mine], axis=0, weights=V0[mine])
    return out


def flow_of(solver: Solver) -> UpdatedLagrangian | None:
    """The part of a solver that moves what flows; None: nothing does."""
    if isinstance(solver, Coupled):
        return solver.flow
    return solver if isinstance(solver, UpdatedLagrangian) else None


def at_of(solver: Solver, body: Ints) -> Ints:
    """The particles of what flows, among all; body : (N,) of these."""
    return solver.flowing_at if isinstance(solver, Coupled) else np.arange(len(body))


@dataclass(frozen=True, kw_only=True)
class Taken:
    """A solid body, as it leaves its solver."""

    body: int  # among the solid ones
    x: Floats  # (n, 3) [m]
    v: Floats  # (n, 3) [m/s]
    F: Floats  # (n, 3, 3)
    elastic: Floats  # (n, 3, 3) F_e
    L: Floats  # (n, 3, 3) [1/s] grad v
    internal: Mapping[str, Floats]  # (n,) of each internal variable of the laws
    momentum: Floats  # (3,) [kg m/s]
    spin: Floats  # (3,) [kg m^2/s] about the world's origin
    kinetic: float  # [J]

    def moved(self, d: Floats) -> Taken:
        """With the particles at other places, by (n, 3) [m] at rest; to first order."""
        Fd = np.einsum("nab,nb->na", self.F, d)
        return replace(self, x=self.x + Fd, v=self.v + np.einsum("nab,nb->na", self.L, Fd))


def taken(solver: TotalLagrangian, body: int) -> Taken:
    """What a body, by its number in the solver, leaves it with."""
    made, now = solver.body, solver.state.view()
    rows = np.flatnonzero(made.particles.body_of == body)
    pose = now.particles
    rate = stretches(made.rows, made.rows.nodes(now.nodes[1]))
    nodes = made.stencil.node_body[: made.stencil.free_count] == body
    p, x = now.momentum[nodes], now.x[nodes]
    law = made.law
    internal: Mapping[str, Floats] = {}
    if law.set.flows:
        internal = {name: values[rows] for name, values in law.internal(now.history).items()}
    return Taken(
        body=body,
        x=pose.x[rows],
        v=pose.v[rows],
        F=pose.F[rows],
        elastic=now.elastic(pose.F)[rows],
        L=rate[rows] @ np.linalg.inv(pose.F[rows]),
        internal=internal,
        momentum=p.sum(0),
        spin=np.cross(x, p).sum(0),
        kinetic=float(0.5 * (now.v[nodes] * p).sum()),
    )


def place(flow: UpdatedLagrangian, bodies: Sequence[tuple[Ints, Taken]]) -> None:
    """Put bodies into the solver of what flows; with (n,) which of its particles each has."""
    state, body = flow.state, flow.body
    x, v = state.rows("x"), state.rows("v")
    C, F, L = (state.rows(name, 9) for name in ("C", "F", "L"))
    laws = body.law.set
    history = state.rows("history", laws.history) if laws.flows else None
    for rows, one in bodies:
        m = body.m[rows]
        moved, affine = matched(one, m, body.h)
        x[rows], v[rows] = one.x - state.offset, moved
        C[rows], L[rows] = affine.reshape(-1, 9), one.L.reshape(-1, 9)
        F[rows] = one.F.reshape(-1, 9)
        if history is not None:
            history[rows, :GRADIENT] = one.elastic.reshape(-1, 9)
            set_internal(history, rows, body.law, one.internal)
    for name, values in (("x", x), ("v", v), ("C", C), ("F", F), ("L", L)):
        state.put(name, values)
    if history is not None:
        state.put("history", history)
    state.recenter()
    state.make_room()


def matched(one: Taken, m: Floats, h: float) -> tuple[Floats, Floats]:
    """v (n, 3) [m/s] and C (n, 3, 3) [1/s] of particles of masses (n,) [kg] that have the momentum,
    the angular momentum and as far as it goes the kinetic energy of a body; see the module."""
    spread = 0.25 * h * h
    missing = one.kinetic - 0.5 * float(m @ (one.v**2).sum(1))
    whole = 0.5 * spread * float(m @ (one.L**2).sum((1, 2)))
    share = float(np.sqrt(np.clip(missing / whole, 0.0, 1.0))) if whole > 0.0 else 0.0
    C = share * one.L
    center = m @ one.x / m.sum()
    r = one.x - center
    dv = (one.momentum - m @ one.v) / m.sum()
    v = one.v + dv
    left = one.spin - m @ (np.cross(one.x, v) + spread * axial(C))
    inertia = np.eye(3) * float(m @ (r**2).sum(1)) - np.einsum("n,na,nb->ab", m, r, r)
    w = np.linalg.lstsq(inertia, left, rcond=None)[0]
    return v + np.cross(w, r), C


def set_internal(
    history: Floats, rows: Ints, law: ParticleLaws, internal: Mapping[str, Floats]
) -> None:
    """Set internal variables (n,) of particles `rows` in histories (N, k), by name and law."""
    for number, one in enumerate(law.set.laws):
        mine = law.of[rows] == number
        for k, variable in enumerate(one.spec.internal, GRADIENT):
            if variable.name in internal:
                history[rows[mine], k] = internal[variable.name][mine]


def carry_flow(before: UpdatedLagrangian, after: UpdatedLagrangian, to: Ints) -> None:
    """Give particles `to` (n,) of a solver the state of the n of another."""
    state, old = after.state, before.state
    for name, width in (("x", 3), ("v", 3), ("C", 9), ("F", 9), ("L", 9)):
        values = state.rows(name, width)
        values[to] = old.rows(name, width)
        if name == "x":
            values[to] += old.offset - state.offset
        state.put(name, values)
    if before.conversions is not None and after.conversions is not None:
        done = after.conversions.done.copy()
        done[to] = before.conversions.done
        after.conversions.load({"converted": done})
    laws, olds = after.body.law, before.body.law
    if not laws.set.flows or not olds.set.flows:
        return
    history, known = state.rows("history", laws.set.history), old.rows("history", olds.set.history)
    history[to, :GRADIENT] = known[:, :GRADIENT]
    set_internal(history, to, laws, olds.internal(known))
    state.put("history", history)


def carry_solid(before: TotalLagrangian, after: TotalLagrangian, left: Ints) -> None:
    """Give a solver of some of the bodies of another, `left` (b,), their state."""
    old, new = before.body, after.body
    number = np.full(int(old.stencil.node_body.max()) + 1, -1)
    number[left] = np.arange(len(left))

    of = number[old.stencil.node_body[: old.stencil.free_count]]
    kept = np.flatnonzero(of >= 0)
    there = new.stencil.node_body[: new.stencil.free_count]
    low = np.array([old.stencil.free_X[of == k].min(0) for k in range(len(left))])

    def order(X: Floats, body: Ints) -> Ints:
        # copies of a node have one place, and the same order in both
        return np.lexsort((*np.round((X - low[body]) / new.h).T, body))

    was = kept[order(old.stencil.free_X[kept], of[kept])]
    is_ = order(new.stencil.free_X, there)
    assert np.array_equal(of[was], there[is_])
    assert np.allclose(
        old.stencil.free_X[was], new.stencil.free_X[is_], rtol=0.0, atol=PLACED * new.h
    )
    for name in ("u", "v"):
        values, free = after.state.rows(name), new.stencil.free_count
        values[is_] = before.state.rows(name)[was]
        values[free:] = new.stencil.follow @ values[:free]
        after.state.put(name, values)
    after.state.offset = before.state.offset.copy()
    if old.contact is not None and new.contact is not None:
        body = old.contact.samples.body
        assert body is not None  # several bodies were solid: some leave, some stay
        mine = np.flatnonzero(number[np.asarray(body)] >= 0)
        after.state.put("sample_spring", before.state.rows("sample_spring")[mine])
    if new.law.set.flows and old.law.set.flows:
        body = number[old.particles.body_of]
        known, history = before.state.view().history, after.state.view().history.copy()
        history[:, :GRADIENT] = known[body >= 0, :GRADIENT]
        rows = np.arange(len(history))
        every = old.law.internal(known)
        internal = {name: values[body >= 0] for name, values in every.items()}
        set_internal(history, rows, new.law, internal)
        after.state.put_particles("history", history)
