"""What is read off a Total Lagrangian body: energies and stress."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Floats
from gf_usd.physics import host
from gf_usd.physics.anchoring import constants
from gf_usd.physics.stretches import strains

if TYPE_CHECKING:
    from gf_usd.physics.solver import TotalLagrangian


def strain_energy(solver: TotalLagrangian, stretch: Floats, J: Floats) -> float:
    """sum_p V0 psi(F_p) [J] of singular values (N, 3), ascending, and determinants (N,).

    With a clamp it is that of the clipped F, of which the stress is taken.  No kernel: what a frame
    says of itself costs a small body more in launches and kernels than in arithmetic.
    """
    s, clamp = stretch.copy(), solver.settings.clamp
    s[:, 0] *= np.where(J < 0.0, -1.0, 1.0)
    if clamp is not None:
        s = np.clip(s, *clamp)
        J = s.prod(1)
    per = solver.per
    return float(per["V0"] @ solver.law.stored(s, J, per["signed_mu"], per["lam"]))


def elastic_energy(solver: TotalLagrangian) -> float:
    """The same from the kernels, of which the nodal forces are the gradient [J]."""
    solver.kernels.energy(
        solver.pack,
        solver.batches.groups,
        solver.cell_energy,
        1.0 / solver.h,
        solver.converged,
    )
    return float(host.values(solver.cell_energy).astype(float).sum())


def von_mises(solver: TotalLagrangian) -> Floats:
    """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
    groups = solver.batches.groups
    solver.kernels.stress(solver.pack, groups, solver.lane_stress, 1.0 / solver.h, solver.converged)
    out = np.empty(len(solver.particles))
    lanes = host.values(solver.lane_stress).astype(float)
    filled = solver.batches.filled.ravel() > 0.0
    out[solver.batches.source.ravel()[filled]] = lanes[filled]
    return out


def kinetic_energies(solver: TotalLagrangian, bodies: int) -> Floats:
    """sum_i m_i v_i^2 / 2 [J] over the nodes of each body, (bodies,)."""
    m, v = solver.stencil.mass, solver.state()[1]
    return np.bincount(solver.stencil.node_body[: len(m)], 0.5 * m * (v * v).sum(1), bodies)


def potential_energy(solver: TotalLagrangian, u: Floats) -> float:
    """-sum_i m_i x_i . (g + b) [J], heights over the floor; u (M, 3) without the offset."""
    s, m = solver.settings, solver.stencil.mass
    x = solver.stencil.free_X + solver.offset + u
    datum = s.floor if s.floor is not None else 0.0
    height = x - datum * np.asarray(s.up)
    return float(-(m @ (height @ np.asarray(s.gravity) + (x * solver.acceleration).sum(1))))


def stored_energy(solver: TotalLagrangian, F: Floats) -> float:
    """Elastic, potential and contact energy [J] of the present state; F (N, 3, 3)."""
    u = solver.state()[0]
    elastic = strain_energy(solver, *strains(F))
    return elastic + potential_energy(solver, u) + contact_energy(solver, u)


def contact_energy(solver: TotalLagrangian, u: Floats) -> float:
    """sum_s k d^2 / 2 [J] stored in the floor's springs; u (M, 3) without the offset."""
    if solver.contact is None or solver.settings.floor is None:
        return 0.0
    rows = solver.contact.rows
    x = rows.X + solver.offset + rows.W @ u
    if solver.contact.constants is not None:
        x = x + solver.contact.constants @ constants(solver)[0]
    height = x @ solver.normal - solver.settings.floor
    depth = np.maximum(0.0, -height)
    return float(0.5 * solver.contact.stiffness @ depth**2)


def pair_energy(solver: TotalLagrangian) -> float:
    """[J] stored in the springs between bodies and with obstacles."""
    if solver.meeting is None:
        return 0.0
    return solver.meeting.energy(solver.meeting.motion(solver)[0], solver.time)
