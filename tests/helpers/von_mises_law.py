"""A law that flows, for tests: Hencky elasticity, von Mises yield, hardening that depends on mu.

yields where sqrt(3/2) 2 mu |dev e| > sigma_y + H a,   H = mu / 10, with radial return in
logarithmic strain [Simo and Hughes 1998, boxes 3.1 and 9.1], a the equivalent plastic strain.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import (  # noqa: F401
    exp,
    moduli,
    pk1,
    psi,
    spectral,
    stored,
    strains,
)
from gf_usd.physics.laws.neo_hookean import J_EXTENSION
from gf_usd.physics.laws.simd3x3 import choose, product

HARDENING = 0.1  # [mu]


@ti.func
def flow(F, q, a, dt, converged):
    """Radial return: with y the excess, e -= g n and a += sqrt(2/3) g, g = y / (2 mu + 2/3 H)."""
    d, _, V, least = strains(F)
    size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    m = 2.0 * q[0]
    H = HARDENING * q[0]
    y = m * size - ti.sqrt(2.0 / 3.0) * (q[2] + H * a[0])
    y = ti.select(least > J_EXTENSION, y, 0.0)
    g = ti.max(y, 0.0) / (m + H * 2.0 / 3.0)
    r = 0.0 - g / ti.max(size, 1e-30)
    E = F
    choose(E, y, product(F, spectral([exp(r * d[0]), exp(r * d[1]), exp(r * d[2])], V)))
    return E, [a[0] + ti.sqrt(2.0 / 3.0) * g], (m * size - m * g) * g
