"""Von Mises plasticity over the Neo-Hookean law: see `radial_flow`."""

import taichi as ti

from gf_usd.physics.laws.neo_hookean import moduli, pk1, powers, psi, stored
from gf_usd.physics.laws.radial_flow import flow_along_strain

__all__ = ["flow", "moduli", "pk1", "psi", "stored"]


@ti.func
def flow(F, q, a, dt, converged):
    """See `radial_flow`."""
    return flow_along_strain(powers, F, q, a, dt, converged)
