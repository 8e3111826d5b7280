"""The state of a Total Lagrangian body, and cached quantities that are derived from it.

The shape correction, the health report and the output of a frame need the energy and the positions
of the same state. `StateView` computes each such quantity once per state: for a small body these
computations take longer than the substeps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.frame import Pose
from gf_usd.physics.contact.floor import GIVEN_ROW, WORK, spring_energy
from gf_usd.physics.grid.bodies import node_sums
from gf_usd.physics.grid.embedding import embedded_pose, gradient
from gf_usd.physics.grid.goals import work_of
from gf_usd.physics.grid.rigid import ROW, D, Q, RigidMotion
from gf_usd.physics.laws.registry import GRADIENT, take_dissipated
from gf_usd.physics.taichi_arrays import DeviceState, host_view
from gf_usd.physics.total_lagrangian import layout
from gf_usd.physics.total_lagrangian.layout import ANCHOR, PIN_RATE, PIN_WORK
from gf_usd.physics.total_lagrangian.setup.arrays import arrays
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.setup.values import viscosities

Given = tuple[Floats, ...]


class RestGradients:
    """F0 (N, 3, 3) of the particles, F = F0 + G u, in the kernels' precision."""

    def __init__(self, F0: Floats) -> None:
        self.set(F0)

    def set(self, F0: Floats) -> None:
        """Replace F0 by a new array; the identity of the array shows a change."""
        self.F0 = F0
        self._ahead = F0.astype(float) - np.eye(3)

    def anchored(self, F: Floats) -> Floats:
        """F0 + G u from F = I + G u, (N, 3, 3)."""
        return F + self._ahead


class State(DeviceState):
    """u and v of the nodes, the internal arrays of the particles, the offset, the time.

    acceleration : (free, 3) [m/s^2] of a body force besides gravity.
    """

    def __init__(self, body: Body, acceleration: Floats) -> None:
        import taichi as ti

        values = arrays(body, acceleration)
        saved = ("u", "v", "sample_spring", *(("rigid",) if body.regions else ()))
        super().__init__(values, body.real, saved, body.settings.lift)
        self._body = body
        self._view: StateView | None = None
        self.acceleration = acceleration
        self._weight: Floats | None = None
        self.pack = body.pack_type(**self.arrays)
        self.rest: RestGradients | None = None
        self._read_F0()
        kind = ti.f64 if body.real is np.float64 else ti.f32
        self.cell_energy = ti.ndarray(kind, body.layout.cells.size)  # [J], output of `energy`
        self.lane_stress = ti.ndarray(kind, body.layout.source.size)  # [Pa], output of `stress`

    def save(self) -> dict[str, Any]:
        """See `DeviceState`; internal arrays by particles, (N, k)."""
        internal = {n: layout.from_lanes(self._body.layout, self.get(n)) for n in self._internal}
        return {**super().save(), **internal}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `DeviceState`."""
        for name in self._internal:
            self.put_particles(name, saved[name])
        self._read_F0()
        super().load(saved)

    @property
    def _internal(self) -> tuple[str, ...]:
        return self._body.internal

    def put_particles(self, name: str, values: Floats) -> None:
        """Fill an internal array from per-particle values (N, k)."""
        self.put(name, layout.law_lanes(self._body.layout, values))

    def put_values(self, index: int) -> None:
        """Set the animated moduli and viscosities for the substeps between frames `index` - 1 and
        `index`.
        """
        body = self._body
        self.put_particles("constants", body.law_at(index).constants)
        viscosity = viscosities(body.values_at(index), body.h)
        self.put("viscosity", layout.lanes(body.layout, viscosity))

    def take_dissipated(self) -> float | None:
        """[J] dissipated by plastic flow since the last call; None without plastic flow."""
        laws = self._body.law.set
        return take_dissipated(laws, self.arrays["history"]) if laws.flows else None

    def put_F0(self, F0: Floats) -> None:
        """Set F0 (N, 3, 3) on the host and on the device."""
        assert self.rest is not None
        self.rest.set(np.asarray(F0, self.real))
        self.put_particles("F0", self.rest.F0.reshape(-1, 9))

    def _read_F0(self) -> None:
        if not self._body.options.anchored:
            return
        F0 = layout.from_lanes(self._body.layout, self.get("F0")).reshape(-1, 3, 3)
        if self.rest is None:
            self.rest = RestGradients(F0)
        else:
            self.rest.set(F0)

    def accelerate(self, b: Floats) -> None:
        """Replace the body force of the following frames; b (free, 3) [m/s^2]."""
        self.put("acceleration", b)
        self.acceleration, self._view, self._weight = b, None, None

    def _body_forces(self) -> Floats:
        """(free, 3) [N] M~ (g + b), the forces of gravity and of the body force."""
        if self._weight is None:
            g = np.asarray(self._body.settings.gravity, float)
            self._weight = self._body.mass.momentum(g + self.acceleration)
        return self._weight

    def prescribe(self, index: int) -> None:
        """Set the prescribed motion of held nodes between frames `index` - 1 and `index`."""
        if self._body.options.driven:
            given = self.rows("sample_given", GIVEN_ROW)
            given[:, WORK] = 0.0
            self.put("sample_given", given)
        if goals := self._body.goals:
            self.put("goal", goals.between(index, self._body.settings.frame_time))
        pin_constraint, nodes = self._body.pin_constraint, self._body.stencil
        if pin_constraint is None or not (pin_constraint.moving or self._body.regions):
            self.clear("anchor")
            return
        free = nodes.free_count
        anchor = np.zeros((max(1, nodes.node_count - free), ANCHOR))
        if pin_constraint.moving:
            held = nodes.held.at(slice(free, None))
            start, end = (
                pin_constraint.constants(
                    held, nodes.node_X[free:], nodes.mirror[free:], nodes.mirror_share[free:], frame
                )
                for frame in (index - 1, index)
            )
            anchor[:, :PIN_RATE] = start
            anchor[:, PIN_RATE:PIN_WORK] = (end - start) / self._body.settings.frame_time
        if regions := self._body.regions:
            c, rate = anchor[:, :PIN_RATE], anchor[:, PIN_RATE:PIN_WORK]
            RigidMotion.of(regions, self.get("rigid")).constants(regions, c, rate)
        self.put("anchor", anchor)

    def work(self) -> float:
        """[J] that pins and goals did on the body since `prescribe`."""
        drawn = work_of(self.get("goal")) if self._body.goals else 0.0
        samples = self.get("sample_given").reshape(-1, GIVEN_ROW)[:, WORK]
        held = self.rows("anchor", ANCHOR)[:, PIN_WORK]
        for of in self._body.regions.nodes if self._body.regions else ():
            held[of] = 0.0  # internal forces of a rigid region do no work
        return float(held.sum() + samples.astype(float).sum()) + drawn

    def recenter(self) -> None:
        """Move the mean displacement from u to the offset; not for a pinned body.

        A state that is not finite is left unchanged, so that it is reported where it began.
        """
        if self._body.in_place:
            return
        u, m = self.rows("u"), self._body.stencil.mass
        mean = m @ u[: self._body.stencil.free_count] / m.sum()
        if not np.isfinite(mean).all():
            return
        self.offset = self.offset + mean
        self.put("u", u - mean)
        if regions := self._body.regions:
            numbers = self.get("rigid").astype(float)
            numbers[: ROW * regions.count].reshape(-1, ROW)[:, D:Q] -= mean
            self.put("rigid", numbers)
            anchor = self.rows("anchor", ANCHOR)
            for of in regions.nodes:
                anchor[of, :PIN_RATE] -= mean
            self.put("anchor", anchor)

    def advance_in_flight(self, flying: Ints, g: Floats, time: float) -> None:
        """Advance bodies (B,) by free flight of `time` [s] under g (3,) [m/s^2]; the others do not
        move.

        x += vbar t + g t^2 / 2 and v += g t for all nodes of a body, with vbar its mean velocity.
        """
        u, v = self.rows("u"), self.rows("v")
        nodes, m = self._body.stencil.node_body, self._body.stencil.mass
        mine = nodes[: len(m)]
        mean = node_sums(m[:, None] * v[: len(m)], mine, len(flying))
        mean /= np.bincount(mine, m, len(flying))[:, None]
        way = np.where(flying[:, None], mean * time + 0.5 * g * time**2, 0.0)
        # A common translation of all bodies goes to the offset, so that u loses no digits.
        common = way[0] if (way == way[0]).all() else m @ way[mine] / m.sum()
        self.offset = self.offset + common
        self.put("u", u + (way - common)[nodes])
        self.put("v", np.where(flying[nodes][:, None], v + g * time, 0.0))

    def view(self) -> StateView:
        """The current state with its cached quantities."""
        names = ("u", "v") if self._body.pin_constraint is None else ("u", "v", "anchor", "rigid")
        names = (*names, "sample_spring")
        if self._body.law.set.flows:
            names = (*names, "history")
        seen = (*(host_view(self.arrays[name]) for name in names), self.offset)
        if self._view is None or not self._view.is_of(seen):
            given = tuple(a.copy() for a in seen)
            self._view = StateView(self._body, self.rest, self._body_forces, given)
        return self._view

    def drop_view(self) -> None:
        """Release the cached quantities."""
        self._view = None


class StateView:
    """A state and the quantities derived from it.

    u, v : (free, 3) [m], [m/s] of the free nodes, u without the offset; float64, read-only.
    """

    def __init__(
        self, body: Body, rest: RestGradients | None, weigh: Callable[[], Floats], given: Given
    ) -> None:
        self._body, self._rest, self._given, self._body_forces = body, rest, given, weigh
        self._strains: tuple[int, Floats | None, tuple[Floats, Floats]] | None = None
        free = body.stencil.free_count
        self.u, self.v = (a.astype(float).reshape(-1, 3)[:free] for a in given[:2])
        self.u.flags.writeable = self.v.flags.writeable = False

    def is_of(self, given: Given) -> bool:
        """Whether the view is of these arrays; False where a value is not finite."""
        return all((then == now).all() for then, now in zip(self._given, given))

    def not_finite(self) -> tuple[int, str]:
        """The particle nearest to a value that is not finite, and its description; (-1, "") without
        one.
        """
        if np.isfinite(self.u).all() and np.isfinite(self.v).all():
            return -1, ""
        bad = ~(np.isfinite(self.u).all(1) & np.isfinite(self.v).all(1))
        X, nodes = self._body.particles.X, self._body.stencil.free_X
        worst = int(np.linalg.norm(X - nodes[np.argmax(bad)], axis=1).argmin())
        return worst, (
            f"{int(bad.sum())} of {len(self.u)} grid nodes are no longer finite, the first near "
            f"particle {worst} at rest position {X[worst].round(4).tolist()} m"
        )

    def strains(self, index: int, F: Floats | None = None) -> tuple[Floats, Floats]:
        """Singular values (N, 3), ascending, and determinants (N,) of F at frame `index`.

        F : (N, 3, 3) where it is known. The result is cached for the frame and F0 of the last call.
        """
        from gf_usd.physics.per_particle import strains

        known = self._strains
        if known is None or known[0] != index or known[1] is not self._F0:
            found = self.gradients(index) if F is None else F
            self._strains = known = index, self._F0, strains(found)
        return known[2]

    def elastic_strains(self, index: int) -> tuple[Floats, Floats]:
        """Singular values and determinants of F_e at frame `index`; of F where no law has plastic
        flow.
        """
        if not self._body.law.set.flows:
            return self.strains(index)
        from gf_usd.physics.per_particle import strains

        return strains(self.elastic(self.gradients(index)))

    def elastic(self, F: Floats) -> Floats:
        """F_e = F F_p^-1 of gradients F (N, 3, 3) of the particles; F where no law has plastic
        flow.
        """
        if not self._body.law.set.flows:
            return F
        return F @ self._plastic

    def internal(self, stretch: Floats) -> dict[str, Floats]:
        """(N,) by name at stretches (N, 3) of F_e: see `ParticleLaws.written`."""
        if not self._body.law.set.flows:
            return {}
        return self._body.law.written(self.history, stretch)

    @cached_property
    def history(self) -> Floats:
        """(N, k) history variables of the particles, as counted by `LawSet.history`."""
        return layout.from_lanes(self._body.layout, self._given[-2]).astype(float)

    @cached_property
    def _plastic(self) -> Floats:
        """F_p^-1 (N, 3, 3)."""
        return self.history[:, :GRADIENT].reshape(-1, 3, 3)

    @property
    def plastic_factor(self) -> Floats | float:
        """|F_p^-1|^2 (N,) by its largest singular value; 1 where no law has plastic flow."""
        if not self._body.law.set.flows:
            return 1.0
        from gf_usd.physics.per_particle import strains

        return strains(self._plastic)[0][:, 2] ** 2

    def elastic_strains_of(self, index: int, other: Floats) -> tuple[Floats, Floats]:
        """`elastic_strains` of another F, computed in the same call as those of F at `index`."""
        from gf_usd.physics.per_particle import strains

        n = len(other)
        if self._body.law.set.flows:
            return strains(self.elastic(other))
        s, J = strains(np.concatenate([other, self.gradients(index)]))
        self._strains = index, self._F0, (s[n:], J[n:])
        return s[:n], J[:n]

    @property
    def _F0(self) -> Floats | None:
        return self._rest.F0 if self._rest else None

    @property
    def offset(self) -> Floats:
        """(3,) [m] of the moving frame of u."""
        return self._given[-1]

    @property
    def constants(self) -> tuple[Floats, Floats]:
        """c (dependent, 3) [m] of held nodes, and its rate [m/s]; only of a body with pins."""
        nodes = self._body.stencil
        count = nodes.node_count - nodes.free_count  # the kernels' arrays have at least one element
        rows = self._given[2].astype(float).reshape(-1, ANCHOR)[:count]
        return rows[:, :PIN_RATE], rows[:, PIN_RATE:PIN_WORK]

    @cached_property
    def rigid(self) -> RigidMotion | None:
        """The motion of the rigid regions; None without rigid regions."""
        regions = self._body.regions
        return RigidMotion.of(regions, self._given[3]) if regions else None

    @cached_property
    def nodes(self) -> tuple[Floats, Floats]:
        """u and v as stacked by `Rows`: with pins, the constants of dependent nodes come last."""
        if self._body.pin_constraint is None:
            return self.u, self.v
        c, rate = self.constants
        if (stencil := self._body.stencil).factors is not None:
            c, rate = c + stencil.slid(self.u), rate + stencil.slid(self.v)
        return np.concatenate([self.u, c]), np.concatenate([self.v, rate])

    @cached_property
    def node_motion(self) -> Floats:
        """The two side by side, (M, 6)."""
        return np.concatenate(self.nodes, 1)

    @cached_property
    def x(self) -> Floats:
        """(free, 3) [m] positions of the free nodes."""
        return self._body.stencil.free_X + self.offset + self.u

    @cached_property
    def F(self) -> Floats:
        """(N, 3, 3) I + G u of the particles."""
        return gradient(self._body.rows, self.nodes[0])

    @cached_property
    def particles(self) -> Pose:
        """Pose of the particles by interpolation alone, without F0 and without pins."""
        found = embedded_pose(self._body.rows, self.node_motion, self.offset)
        self.__dict__.setdefault("F", found.F)
        return found

    def pose(self, index: int) -> Pose:
        """x, v and F of the particles at frame `index`; the stress is computed from F."""
        free = self.particles
        free = Pose(x=free.x, v=free.v, F=self._anchored())
        return self._body.constrained("", self._body.rows, free, index, self.offset)

    def gradients(self, index: int) -> Floats:
        """F (N, 3, 3) of `pose`."""
        return self._anchored() if self._body.pin_constraint is None else self.pose(index).F

    def _anchored(self) -> Floats:
        return self._rest.anchored(self.F) if self._rest else self.F

    @cached_property
    def potential(self) -> float:
        """Potential energy -sum_i x_i . (M~ (g + b))_i [J], heights measured from the floor."""
        s, weight = self._body.settings, self._body_forces()
        datum = s.floor if s.floor is not None else 0.0
        height = self.x - datum * np.asarray(s.up)
        free = -float((height * weight).sum())
        if not (regions := self._body.regions) or self.rigid is None:
            return free
        rise = (self.rigid.x + self.offset - datum * np.asarray(s.up)) @ np.asarray(s.gravity)
        return free - float(regions.mass @ rise)

    @cached_property
    def momentum(self) -> Floats:
        """p = M~ v (free, 3) [kg m/s]."""
        return self._body.mass.momentum(self.v)

    @cached_property
    def samples(self) -> Floats:
        """x (n, 3) [m] of the contact samples of a body that has some."""
        contact = self._body.contact
        assert contact is not None
        x = contact.rows.X + self.offset + contact.rows.W @ self.u
        return x if contact.constants is None else x + contact.constants @ self.constants[0]

    @cached_property
    def rise(self) -> Floats:
        """(n,) [m] heights of the contact samples of a body that has some, by u alone."""
        contact = self._body.contact
        assert contact is not None
        return contact.rows.W @ (self.u @ self._body.settings.normal)

    @cached_property
    def contact(self) -> float:
        """[J] energy of the floor's contact springs, with k_t xi^2 / 2 of friction: see
        `contact.floor`.
        """
        contact, s = self._body.contact, self._body.settings
        if contact is None or s.floor is None:
            return 0.0
        rows, normal = contact.rows, s.normal
        height = rows.X @ normal + self.offset @ normal + self.rise
        if contact.constants is not None:
            height = height + contact.constants @ (self.constants[0] @ normal)
        depth = np.maximum(0.0, s.floor - height)
        xi = self._given[-3 if self._body.law.set.flows else -2].astype(float).reshape(-1, 3)
        held = spring_energy(contact.tangential, xi[: len(depth)])
        return held + contact.normal_energy(depth)
