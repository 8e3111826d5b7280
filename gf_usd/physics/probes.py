"""What is read off a Total Lagrangian body: energies and stress."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Floats
from gf_usd.physics import host

if TYPE_CHECKING:
    from gf_usd.physics.moment import Moment
    from gf_usd.physics.solver import TotalLagrangian


def strain_energy(solver: TotalLagrangian, stretch: Floats, J: Floats) -> float:
    """sum_p V0 psi(F_p) [J] of singular values (N, 3), ascending, and determinants (N,).

    With a clamp it is that of the clipped F, of which the stress is taken.  No kernel: what a frame
    says of itself costs a small body more in launches and kernels than in arithmetic.
    """
    s, clamp = stretch, solver.settings.clamp
    if (J < 0.0).any():
        s = s.copy()
        s[:, 0] *= np.where(J < 0.0, -1.0, 1.0)
    if clamp is not None:
        s = np.clip(s, *clamp)
        J = s.prod(1)
    per = solver.per
    return float(per["V0"] @ solver.law.stored(s, J, per["signed_mu"], per["lam"]))


def elastic_energy(solver: TotalLagrangian) -> float:
    """The same from the kernels, of which the nodal forces are the gradient [J]."""
    solver.kernels.energy(solver.pack, solver.batches.groups, solver.cell_energy)
    return float(host.values(solver.cell_energy).astype(float).sum())


def von_mises(solver: TotalLagrangian) -> Floats:
    """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
    groups = solver.batches.groups
    solver.kernels.stress(solver.pack, groups, solver.lane_stress)
    out = np.empty(len(solver.particles))
    lanes = host.values(solver.lane_stress).astype(float)
    filled = solver.batches.filled.ravel() > 0.0
    out[solver.batches.source.ravel()[filled]] = lanes[filled]
    return out


def kinetic_energies(solver: TotalLagrangian, bodies: int) -> Floats:
    """sum_i m_i v_i^2 / 2 [J] over the nodes of each body, (bodies,)."""
    m, v = solver.stencil.mass, solver.state()[1]
    return np.bincount(solver.stencil.node_body[: len(m)], 0.5 * m * (v * v).sum(1), bodies)


def stored_energy(solver: TotalLagrangian, now: Moment, stretch: Floats, J: Floats) -> float:
    """Elastic, potential and contact energy [J] of a state; see `strain_energy`."""
    return strain_energy(solver, stretch, J) + now.potential + now.contact


def pair_energy(solver: TotalLagrangian) -> float:
    """[J] stored in the springs between bodies and with obstacles."""
    if solver.meeting is None:
        return 0.0
    return solver.meeting.energy(solver.meeting.motion(solver)[0], solver.time)
