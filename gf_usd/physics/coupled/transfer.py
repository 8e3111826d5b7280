"""Transfer of the state of bodies from one solver to another.

From the Total to the Updated Lagrangian solver, x, F and the internal variables are copied. The
velocities of particles follow from the nodal velocities v_i,

    v_p = W v + dv + w x (x_p - c),   C_p = s grad v

with dv and w such that momentum and angular momentum of the body are conserved, and s in [0, 1]
such that kinetic energy is, as far as possible: an affine velocity C has the energy m h^2 |C|^2 / 8
and the angular momentum m h^2 axial(C) / 4. `handover` reports the remaining difference of the
energies, and the energy of contact springs: a decrease as dissipated by conversion, an increase as
injected.

Bodies that keep their solver keep their state exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.coupled.solver import Coupled
from gf_usd.physics.frame_loop import Solver
from gf_usd.physics.grid.embedding import stretches
from gf_usd.physics.laws.registry import GRADIENT, ParticleLaws
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.energies import axial
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian

PLACED = 1e-6  # [cells] tolerance for nodes at the same position in two grids


def solid_of(solver: Solver) -> TotalLagrangian | None:
    """The Total Lagrangian part of a solver; None if no body is solid."""
    if isinstance(solver, Coupled):
        return solver.solid
    return solver if isinstance(solver, TotalLagrangian) else None


def flow_of(solver: Solver) -> UpdatedLagrangian | None:
    """The Updated Lagrangian part of a solver; None if no body flows."""
    if isinstance(solver, Coupled):
        return solver.flow
    return solver if isinstance(solver, UpdatedLagrangian) else None


def flowing_particles(solver: Solver, body: Ints) -> Ints:
    """(n,) indices of the flowing particles among all N; body : (N,) the body of each."""
    return solver.flowing_at if isinstance(solver, Coupled) else np.arange(len(body))


@dataclass(frozen=True, kw_only=True)
class SolidState:
    """The state of one body of a Total Lagrangian solver."""

    body: int  # index in that solver
    x: Floats  # (n, 3) [m]
    v: Floats  # (n, 3) [m/s]
    F: Floats  # (n, 3, 3)
    elastic: Floats  # (n, 3, 3) F_e
    L: Floats  # (n, 3, 3) [1/s] grad v
    internal: Mapping[str, Floats]  # (n,) of each internal variable of the laws
    momentum: Floats  # (3,) [kg m/s]
    spin: Floats  # (3,) [kg m^2/s] about the world's origin
    kinetic: float  # [J]

    def moved(self, d: Floats) -> SolidState:
        """The state with particles displaced by d (n, 3) [m] at rest, to first order: x + F d, v +
        Fdot d.
        """
        Fd = np.einsum("nab,nb->na", self.F, d)
        return replace(self, x=self.x + Fd, v=self.v + np.einsum("nab,nb->na", self.L, Fd))


def read_solid(solver: TotalLagrangian, body: int) -> SolidState:
    """The state of a body, given by its index in the solver."""
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
    return SolidState(
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


def write_flow(flow: UpdatedLagrangian, bodies: Sequence[tuple[Ints, SolidState]]) -> None:
    """Write bodies into an Updated Lagrangian solver; each with the indices (n,) of its particles
    there.
    """
    state, body = flow.state, flow.body
    x, v = state.rows("x"), state.rows("v")
    C, F, L = (state.rows(name, 9) for name in ("C", "F", "L"))
    laws = body.law.set
    history = state.rows("history", laws.history) if laws.flows else None
    for rows, one in bodies:
        m = body.m[rows]
        moved, affine = conserving_velocities(one, m, body.h)
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
    state.extend_grid()


def conserving_velocities(one: SolidState, m: Floats, h: float) -> tuple[Floats, Floats]:
    """v (n, 3) [m/s] and C (n, 3, 3) [1/s] of particles of masses m (n,) [kg].

    They conserve momentum, angular momentum and, as far as possible, kinetic energy: see the
    module.
    """
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


def copy_flow(before: UpdatedLagrangian, after: UpdatedLagrangian, to: Ints) -> None:
    """Copy the state of all n particles of one solver to particles `to` (n,) of another."""
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


def copy_solid(before: TotalLagrangian, after: TotalLagrangian, left: Ints) -> None:
    """Copy the state of bodies `left` (b,) of one solver to another, which has only these."""
    old, new = before.body, after.body
    number = np.full(int(old.stencil.node_body.max()) + 1, -1)
    number[left] = np.arange(len(left))

    of = number[old.stencil.node_body[: old.stencil.free_count]]
    kept = np.flatnonzero(of >= 0)
    there = new.stencil.node_body[: new.stencil.free_count]
    low = np.array([old.stencil.free_X[of == k].min(0) for k in range(len(left))])

    def order(X: Floats, body: Ints) -> Ints:
        # copies of a node have the same position, and the same order in both
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
        assert body is not None  # several bodies were solid: some are transferred
        mine = np.flatnonzero(number[np.asarray(body)] >= 0)
        springs = after.state.rows("sample_spring")
        springs[: len(mine)] = before.state.rows("sample_spring")[mine]
        after.state.put("sample_spring", springs)
    if new.law.set.flows and old.law.set.flows:
        body = number[old.particles.body_of]
        known, history = before.state.view().history, after.state.view().history.copy()
        history[:, :GRADIENT] = known[body >= 0, :GRADIENT]
        rows = np.arange(len(history))
        every = old.law.internal(known)
        internal = {name: values[body >= 0] for name, values in every.items()}
        set_internal(history, rows, new.law, internal)
        after.state.put_particles("history", history)
