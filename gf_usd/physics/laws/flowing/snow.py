"""Snow: corotated elasticity within critical stretches, with hardening by compaction.

    psi = h (mu |F_e - R_e|^2 + lam/2 (J_e - 1)^2),   h = exp(hardening_coefficient (1 - J_p))

[Stomakhin, Schroeder, Chai, Teran and Selle 2013, section 5]. The stretches of F_e are clamped to

    1 - critical_compression <= s_i <= 1 + critical_stretch

and the rest is plastic: det F_e J_p is unchanged, with J_p = det F_p. Compaction (J_p < 1) hardens,
and expansion (J_p > 1) softens to powder, which has no strength until it is compacted again. h is
bounded by HARDEST, to bound the time step.

The clamp is not an associated flow. Where several stretches differ in sign the work of the final
stress may be negative, and is counted with its sign (`LawSpec.associated`), less the energy stored
by hardening,

    work = h' P(F_e) : (F_e* - F_e) - (h' - h) psi(F_e)         h before, h' after the flow
"""

import numpy as np
import taichi as ti

from gf_usd.physics.laws.corotated import (  # noqa: F401  (functions of the law: see `registry`)
    moduli,
    pk1,
    psi,
    stored,
)
from gf_usd.physics.laws.hencky import exp, gram, over, spectral, stretches
from gf_usd.physics.laws.simd3x3 import choose, cofactor, determinant, product

HARDEST = 50.0  # bound of h, reached at J_p = 0.6 with the coefficient 10
LEAST = 0.01  # lower bound of a stretch of a trial state in J_p


@ti.func
def flow(F, q, a, dt, converged):
    """The return mapping of the module; arguments and results as in `registry`."""
    E = F
    Jp = a[0]
    work = a[0] * 0.0
    J = determinant(F, cofactor(F))
    D, C = gram(F)
    # Where |F^T F - 1| is less than the limits allow, no stretches are computed: the common case.
    u = D[0] - 1.0
    v = D[1] - 1.0
    w = D[2] - 1.0
    off = u * u + v * v + w * w + 2.0 * (C[0] * C[0] + C[1] * C[1] + C[2] * C[2])
    low = ti.min(q[2], 1.0)
    most = ti.min(low * (2.0 - low), q[3] * (2.0 + q[3]))
    if (off - most * most).max() > 0.0 or J.min() <= 0.0:
        s, V = stretches(F)
        low = 1.0 - q[2]
        high = 1.0 + q[3]
        c0 = ti.min(ti.max(s[0], low), high)
        c1 = ti.min(ti.max(s[1], low), high)
        c2 = ti.min(ti.max(s[2], low), high)
        x, y, z = s[0] - c0, s[1] - c1, s[2] - c2
        acts = x * x + y * y + z * z
        if acts.max() > 0.0:
            Je = c0 * c1 * c2
            trial = ti.max(s[0], LEAST) * ti.max(s[1], LEAST) * ti.max(s[2], LEAST)
            Jp = ti.select(acts > 0.0, a[0] * trial / Je, a[0])
            p = q[1] * (Je - 1.0) * Je
            m = 2.0 * q[0]
            along = x * (m * (c0 - 1.0) + p / c0) + y * (m * (c1 - 1.0) + p / c1)
            along = along + z * (m * (c2 - 1.0) + p / c2)
            kept = q[0] * ((c0 - 1.0) * (c0 - 1.0) + (c1 - 1.0) * (c1 - 1.0))
            kept = kept + q[0] * (c2 - 1.0) * (c2 - 1.0) + 0.5 * q[1] * (Je - 1.0) * (Je - 1.0)
            after = hardness(q, [Jp])
            work = ti.select(
                acts > 0.0, after * along - (after - hardness(q, a)) * kept, a[0] * 0.0
            )
            choose(
                E, acts, product(F, spectral([over(c0, s[0]), over(c1, s[1]), over(c2, s[2])], V))
            )
    return E, [Jp], work


@ti.func
def hardness(q, a):
    """h of J_p."""
    return ti.min(exp(ti.min(q[4] * (1.0 - a[0]), 80.0)), HARDEST)


def hardnesses(q, a):
    """h (N,) of J_p; q rows (N,), a (N, 1)."""
    return np.minimum(np.exp(np.minimum(q[4] * (1.0 - a[:, 0]), 80.0)), HARDEST)
