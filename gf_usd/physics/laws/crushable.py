"""Crushable foam over Hencky's elastic law: volume that is lost stays lost.

With the Kirchhoff stress of `von_mises`, its pressure p = -tr(tau) / 3 and sigma = sqrt(3/2) |s|,
the material flows where the equivalent stress of Deshpande and Fleck (2000, eq. 3) exceeds a yield
stress that grows as the cells close:

    Q = sqrt((sigma^2 + alpha^2 p^2) / (1 + alpha^2 / 9)) > Y(c) = yield_stress + hardening c

c is the volume lost for good, -ln det F_p where that is above 0, and alpha the shape of the cap
(1.5 * sqrt(2) = 2.1 makes a uniaxial test show no plastic Poisson's ratio).  Associated flow
de_p = l d(Q^2 (1 + alpha^2/9))/d tau returns stress along (its eq. 7, backward Euler)

    s = s* / (1 + 6 mu l),   p = p* / (1 + 2 alpha^2 K l),   K = lam + 2 mu / 3

with l >= 0 such that Q = Y(c): Newton from below, since Q - Y falls with l.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import (  # noqa: F401  (functions of the law: see `registry`)
    exp,
    moduli,
    pk1,
    psi,
    spectral,
    stored,
    strains,
)
from gf_usd.physics.laws.simd3x3 import choose, product

ITERATIONS = 20
CLOSE = 1e-6  # of Q: the step from such a residual ends at its square


@ti.func
def flow(F, q, a, dt):
    """See the module; with m = 2 mu l and b = alpha^2 K / mu."""
    d, trace, V = strains(F)
    size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    bulk = q[1] + q[0] * (2.0 / 3.0)
    cap = q[4] * q[4]
    inward = ti.max(0.0 - trace, 0.0)
    stress = ti.sqrt(6.0) * q[0] * size
    pressure = bulk * trace
    scale = 1.0 / (1.0 + cap / 9.0)
    b = cap * bulk / q[0]
    y = ti.sqrt(scale * (stress * stress + cap * pressure * pressure)) - q[2] - q[3] * a[0]
    m = y * 0.0
    if y.max() > 0.0:
        steps, unsolved = 0, 1.0
        while unsolved > 0.0 and steps < ITERATIONS:
            u = 1.0 / (1.0 + 3.0 * m)
            w = 1.0 / (1.0 + b * m)
            s = stress * u
            p = pressure * w
            Q = ti.sqrt(scale * (s * s + cap * p * p))
            r = Q - q[2] - q[3] * (a[0] + inward * (1.0 - w))
            slope = scale * (3.0 * s * s * u + cap * b * p * p * w) / ti.max(Q, 1e-30)
            slope = slope + q[3] * inward * b * w * w
            r = ti.select(y > 0.0, r, 0.0)
            m = m + r / ti.max(slope, 1e-30)
            unsolved = (ti.max(r, 0.0 - r) - CLOSE * Q).max()
            steps += 1
    u = 1.0 / (1.0 + 3.0 * m) - 1.0
    w = 1.0 / (1.0 + b * m)
    t = trace * (w - 1.0) / 3.0
    E = F
    if y.max() > 0.0:
        back = [exp(u * d[0] + t), exp(u * d[1] + t), exp(u * d[2] + t)]
        choose(E, y, product(F, spectral(back, V)))
    return E, [a[0] + inward * (1.0 - w)]
