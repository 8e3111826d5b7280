"""Energies, momenta and von Mises stress of a Total Lagrangian body."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats, cross, row_dots, triple
from gf_usd.core.frames.frame import Health
from gf_usd.physics import taichi_arrays
from gf_usd.physics.laws.registry import ParticleLaws
from gf_usd.physics.total_lagrangian import layout
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.state import State, StateView


def strain_energy(body: Body, law: ParticleLaws, stretch: Floats, J: Floats) -> float:
    """sum_p V0_p psi(F_p) [J] of singular values (N, 3), ascending, and determinants (N,) of F_e.

    law : of the particles at that time, `Body.law_at`.

    With a stretch clamp it is the energy of the clipped F, from which the stress is computed.
    Evaluated in NumPy: for a small body, launching and loading a kernel costs more than the
    arithmetic.
    """
    s, clamp = stretch, body.settings.clamp
    if (J < 0.0).any():
        s = s.copy()
        s[:, 0] *= np.where(J < 0.0, -1.0, 1.0)
    if clamp is not None:
        s = np.clip(s, *clamp)
        J = s.prod(1)
    return float(body.per["V0"] @ law.stored(s, J))


def elastic_energy(body: Body, state: State) -> float:
    """sum_p V0_p psi(F_p) [J] by the kernels; the nodal forces are minus its gradient."""
    body.kernels.energy(state.pack, body.layout.groups, state.cell_energy)
    return float(taichi_arrays.values(state.cell_energy).astype(float).sum())


def von_mises(body: Body, state: State) -> Floats:
    """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
    body.kernels.stress(state.pack, body.layout.groups, state.lane_stress)
    lanes = taichi_arrays.values(state.lane_stress).astype(float)
    return layout.from_lanes(body.layout, lanes)[:, 0]


def kinetic_energies(body: Body, now: StateView, bodies: int) -> Floats:
    """sum_i m_i v_i^2 / 2 [J] over the nodes of each body, (bodies,): no less than v . M~ v / 2."""
    m, v = body.stencil.mass, now.v
    return np.bincount(body.stencil.node_body[: len(m)], 0.5 * m * row_dots(v, v), bodies)


def stored_energy(
    body: Body, law: ParticleLaws, now: StateView, stretch: Floats, J: Floats
) -> float:
    """Sum of elastic, potential and contact energy [J] of a state; see `strain_energy`."""
    return strain_energy(body, law, stretch, J) + now.potential + now.contact


def measure(body: Body, now: StateView, index: int, pairs: float) -> Health:
    """Energies, momenta and stretches of frame `index`, in float64.

    pairs : [J] in the springs between bodies and with obstacles.

    Momentum and kinetic energy are those of the nodes, p_i = (M~ v)_i, sum p_i = sum m_i v_i and
    sum v_i . p_i / 2, which the solver conserves; angular momentum is sum x_i x p_i about the
    world's origin.
    """
    m, x, v, p = body.stencil.mass, now.x, now.v, now.momentum
    stretch, J = now.strains(index)
    spin, kinetic = cross(x, p).sum(0), float(0.5 * (v * p).sum())
    if (regions := body.regions) and (rigid := now.rigid):
        kinetic += rigid.kinetic(regions)
        m = np.concatenate([m, regions.mass])
        x, v = np.concatenate([x, rigid.x + now.offset]), np.concatenate([v, rigid.v])
        there = rigid.x + now.offset
        spin = spin + (cross(there, regions.mass[:, None] * rigid.v) + rigid.spin).sum(0)
    whole = m.sum()
    return Health(
        kinetic=kinetic,
        elastic=strain_energy(body, body.law_at(index), *now.elastic_strains(index)),
        potential=now.potential,
        contact=now.contact + pairs,
        mass=float(whole),
        center=triple(m @ x / whole),
        momentum=triple(m @ v),
        angular_momentum=triple(spin),
        min_J=float(J.min()),
        max_J=float(J.max()),
        min_stretch=float(stretch.min()),
        max_stretch=float(stretch.max()),
        inverted=int((J <= 0.0).sum()),
        plastic_dissipation=0.0 if body.law.set.flows else None,
        settling_dissipation=0.0 if body.settings.settles else None,
    )
