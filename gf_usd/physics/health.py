"""What a frame says of its own health."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Floats, Health
from gf_usd.physics.probes import contact_energy, pair_energy, potential_energy, strain_energy

if TYPE_CHECKING:
    from gf_usd.physics.solver import TotalLagrangian


def measure(solver: TotalLagrangian, u: Floats, v: Floats, stretch: Floats, J: Floats) -> Health:
    """Energies, momenta and stretches of one frame, in float64; see `stretches`.

    Momentum and kinetic energy are those of the nodes, p = sum m_i v_i and sum m_i v_i^2 / 2,
    which the solver conserves; angular momentum is sum m_i x_i x v_i about the world's origin.
    """
    m = solver.stencil.mass
    x = solver.stencil.free_X + solver.offset + u
    return Health(
        kinetic=float(0.5 * m @ (v * v).sum(1)),
        elastic=strain_energy(solver, stretch, J),
        potential=potential_energy(solver, u),
        contact=contact_energy(solver, u) + pair_energy(solver),
        mass=float(m.sum()),
        centre=_triple(m @ x / m.sum()),
        momentum=_triple(m @ v),
        angular_momentum=_triple(m @ np.cross(x, v)),
        min_J=float(J.min()),
        max_J=float(J.max()),
        min_stretch=float(stretch.min()),
        max_stretch=float(stretch.max()),
        inverted=int((J <= 0.0).sum()),
    )


def _triple(a: Floats) -> tuple[float, float, float]:
    return (float(a[0]), float(a[1]), float(a[2]))
