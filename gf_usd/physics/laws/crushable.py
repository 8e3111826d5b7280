"""Crushable foam with Hencky's elastic law: plastic compaction.

With the Kirchhoff stress of `von_mises`, its pressure p = -tr(tau) / 3 and sigma = sqrt(3/2) |s|,
plastic flow occurs where the equivalent stress of Deshpande and Fleck (2000, eq. 3) exceeds a yield
stress that hardens with compaction:

    Q = sqrt((sigma^2 + alpha^2 p^2) / (1 + alpha^2 / 9)) > Y(c) = yield_stress + hardening c

c is the plastic compaction max(0, -ln det F_p), and alpha the shape of the yield surface (for 1.5 *
sqrt(2) = 2.1 the plastic Poisson's ratio of a uniaxial test is zero). Under tension, p < 0, alpha
in the numerator is alpha / r, with r the ratio of tensile to compressive strength: two half
ellipses with common widest point and normal. Associated flow de_p = l d(Q^2 (1 + alpha^2/9))/d tau
returns the stress (their eq. 7, backward Euler)

    s = s* / (1 + 6 mu l),   p = p* / (1 + 2 alpha^2 K l),   K = lam + 2 mu / 3

which preserves the sign of p, with l >= 0 such that Q = Y(c). Newton's method converges from below,
since Q - Y decreases with l. Where a stretch of F_e is below 0.1 or F_e is inverted no flow occurs,
until the elastic forces have restored the particle.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import (  # noqa: F401  (functions of the law: see `registry`)
    bulk_modulus,
    moduli,
    pk1,
    psi,
    return_strain,
    stored,
)

ITERATIONS = 20
CLOSE = 1e-6  # residual relative to Q; quadratic convergence squares it in one more step


@ti.func
def flow(F, q, a, dt, converged):
    """The return mapping of the module; arguments and results as in `registry`."""
    return return_strain(F, q, a, dt, converged, trial, mapped)


@ti.func
def trial(q, a, dt, square, trace):
    """Q* - Y(c) [Pa]; sigma* and -p* [Pa] of a trial strain with |dev e|^2 = square."""
    s = ti.sqrt(6.0) * q[0] * ti.sqrt(square)
    p = bulk_modulus(q) * trace
    Q = ti.sqrt((s * s + cap(q, p) * p * p) / (1.0 + q[4] * q[4] / 9.0))
    return Q - q[2] - q[3] * a, [s, p]


@ti.func
def mapped(q, a, excess, square, trace, values):
    """The return of `hencky.return_strain`; excess : Q* - Y(c) [Pa]; values : of `trial`."""
    s, p = values[0], values[1]
    m, compaction = multiplier(q, a, excess, s, p, ti.max(0.0 - trace, 0.0))
    k = 1.0 / (1.0 + 3.0 * m) - 1.0
    mean = trace * (1.0 / (1.0 + slope(q, p) * m) - 1.0) / 3.0
    return k, mean, a + compaction, dissipated(q, m, s, p)


@ti.func
def dissipated(q, m, stress, pressure):
    """tau : (e* - e) [J/m^3] of the final stress: deviatoric part and pressure part."""
    u = 1.0 / (1.0 + 3.0 * m)
    w = 1.0 / (1.0 + slope(q, pressure) * m)
    shear = stress * stress * u * (1.0 - u) / (3.0 * q[0])
    return shear + pressure * pressure * w * (1.0 - w) / bulk_modulus(q)


@ti.func
def cap(q, pressure):
    """alpha^2 for the sign of -p [Pa]: under tension divided by r^2."""
    return q[4] * q[4] * ti.select(pressure > 0.0, 1.0 / (q[5] * q[5]), 1.0)


@ti.func
def slope(q, pressure):
    """b = alpha^2 K / mu."""
    return cap(q, pressure) * (q[1] / q[0] + 2.0 / 3.0)


@ti.func
def multiplier(q, a, y, stress, pressure, inward):
    """m = 2 mu l of the return, and the increment of c; inward : max(0, -tr e*)."""
    alpha = cap(q, pressure)
    scale = 1.0 / (1.0 + q[4] * q[4] / 9.0)
    b = slope(q, pressure)
    m = y * 0.0
    steps, unsolved = 0, 1.0
    while unsolved > 0.0 and steps < ITERATIONS:
        u = 1.0 / (1.0 + 3.0 * m)
        w = 1.0 / (1.0 + b * m)
        s = stress * u
        p = pressure * w
        Q = ti.sqrt(scale * (s * s + alpha * p * p))
        r = Q - q[2] - q[3] * (a + inward * (1.0 - w))
        fall = scale * (3.0 * s * s * u + alpha * b * p * p * w) / ti.max(Q, 1e-30)
        fall = fall + q[3] * inward * b * w * w
        r = ti.select(y > 0.0, r, 0.0)
        m = m + r / ti.max(fall, 1e-30)
        unsolved = (ti.max(r, 0.0 - r) - CLOSE * Q).max()
        steps += 1
    return m, inward * (1.0 - 1.0 / (1.0 + b * m))
