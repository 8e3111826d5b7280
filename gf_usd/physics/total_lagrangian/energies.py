"""What is read off a Total Lagrangian body: energies and stress.

What a frame says of its own health.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames import Health
from gf_usd.physics import taichi_arrays

if TYPE_CHECKING:
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
    from gf_usd.physics.total_lagrangian.state import Moment


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
    return float(solver.per["V0"] @ solver.law.stored(s, J))


def elastic_energy(solver: TotalLagrangian) -> float:
    """The same from the kernels, of which the nodal forces are the gradient [J]."""
    solver.kernels.energy(solver.pack, solver.batches.groups, solver.cell_energy)
    return float(taichi_arrays.values(solver.cell_energy).astype(float).sum())


def von_mises(solver: TotalLagrangian) -> Floats:
    """sqrt(3/2 s:s) [Pa] of each particle, s the deviator of sigma = P F^T / J; (N,)."""
    groups = solver.batches.groups
    solver.kernels.stress(solver.pack, groups, solver.lane_stress)
    out = np.empty(len(solver.particles))
    lanes = taichi_arrays.values(solver.lane_stress).astype(float)
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


NEXT, LAST = (1, 2, 0), (2, 0, 1)  # axes after and before each


def measure(
    solver: TotalLagrangian,
    now: Moment,
    stretch: Floats,
    J: Floats,
    elastic: tuple[Floats, Floats],
) -> Health:
    """Energies, momenta and stretches of one frame, in float64; elastic : strains of F_e.

    Momentum and kinetic energy are those of the nodes, p = sum m_i v_i and sum m_i v_i^2 / 2,
    which the solver conserves; angular momentum is sum m_i x_i x v_i about the world's origin.
    """
    m, x, v = solver.stencil.mass, now.x, now.v
    whole = m.sum()
    return Health(
        kinetic=float(0.5 * m @ (v * v).sum(1)),
        elastic=strain_energy(solver, *elastic),
        potential=now.potential,
        contact=now.contact + pair_energy(solver),
        mass=float(whole),
        centre=_triple(m @ x / whole),
        momentum=_triple(m @ v),
        angular_momentum=_triple(m @ cross(x, v)),
        min_J=float(J.min()),
        max_J=float(J.max()),
        min_stretch=float(stretch.min()),
        max_stretch=float(stretch.max()),
        inverted=int((J <= 0.0).sum()),
    )


def cross(a: Floats, b: Floats) -> Floats:
    """a x b of rows (n, 3): `numpy.cross` without its questions about axes and shapes."""
    out = a.take(NEXT, 1) * b.take(LAST, 1)
    out -= a.take(LAST, 1) * b.take(NEXT, 1)
    return out


def _triple(a: Floats) -> tuple[float, float, float]:
    return (float(a[0]), float(a[1]), float(a[2]))
