"""What a frame says of its own health."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gf_usd.model import Floats, Health
from gf_usd.physics.probes import pair_energy, strain_energy

if TYPE_CHECKING:
    from gf_usd.physics.moment import Moment
    from gf_usd.physics.solver import TotalLagrangian


NEXT, LAST = (1, 2, 0), (2, 0, 1)  # axes after and before each


def measure(solver: TotalLagrangian, now: Moment, stretch: Floats, J: Floats) -> Health:
    """Energies, momenta and stretches of one frame, in float64; see `stretches`.

    Momentum and kinetic energy are those of the nodes, p = sum m_i v_i and sum m_i v_i^2 / 2,
    which the solver conserves; angular momentum is sum m_i x_i x v_i about the world's origin.
    """
    m, x, v = solver.stencil.mass, now.x, now.v
    whole = m.sum()
    return Health(
        kinetic=float(0.5 * m @ (v * v).sum(1)),
        elastic=strain_energy(solver, stretch, J),
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
