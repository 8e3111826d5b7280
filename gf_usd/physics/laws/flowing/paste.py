"""A Herschel-Bulkley paste with Hencky's elastic law: toothpaste, mud, cream.

Below its yield stress it is elastic, as `von_mises`; above, the equivalent plastic strain a grows
at the rate a' for which

    sigma = Y(a) + flow_viscosity (a')^n,   Y(a) = yield_stress + hardening a,   n = flow_exponent

[Herschel and Bulkley 1926, as the overstress of Perzyna 1966]. In simple shear at a rate D that is
tau = tau_y + k D^n with yield_stress = sqrt(3) tau_y and flow_viscosity = 3^((1 + n) / 2) k. With n
= 1 it is a Bingham paste, and without a yield stress a fluid.

Radial return, backward Euler: of the trial excess y = sigma* - Y(a) the fraction x remains,

    x + A x^(1/n) = 1,   A = (3 mu + hardening) dt / y (y / flow_viscosity)^(1/n)
    g = y A x^(1/n) / (3 mu + hardening)

For n <= 1 the left side is convex and increases with x, so that Newton's method converges from
above, starting where neither term exceeds 1.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import (  # noqa: F401  (functions of the law: see `registry`)
    exp,
    moduli,
    pk1,
    psi,
    stored,
)
from gf_usd.physics.laws.simd3x3 import log
from gf_usd.physics.laws.von_mises import INSTANT, radial_return

ITERATIONS = 20  # largest number of Newton steps: six suffice for exponents from 0.1 (measured)
CLOSE = 1e-6  # residual; quadratic convergence squares it in one more step
WIDE = 80.0  # bound of |ln A| in f32: beyond it the excess vanishes at once, or nothing flows


@ti.func
def flow(F, q, a, dt, converged):
    """The return mapping of the module; arguments and results as in `registry`."""
    return radial_return(F, q, a, dt, converged, bearable, growth)


@ti.func
def bearable(q, a):
    """Y(a) [Pa]."""
    return q[2] + q[3] * a


@ti.func
def growth(q, a, size, y, dt):
    """g of the module, 0 where the excess y [Pa] is not positive."""
    stiff = 3.0 * q[0] + q[3]
    most = ti.max(y, 1e-30)
    g = ti.max(y, 0.0) / stiff
    if q[4].max() > 0.0:
        m = 1.0 / ti.max(q[5], 0.1)
        slow = ti.max(q[4], 1e-30)
        A = log(ti.max(stiff * (ti.max(dt, INSTANT) / most), 1e-35))
        A = A + m * (log(most) - log(slow))
        A = ti.min(ti.max(A, -WIDE), WIDE)
        x = ti.min(exp((0.0 - A) / m), 1.0)
        flowed = exp(A + m * log(x))
        steps, unsolved = 0, 1.0
        while unsolved > 0.0 and steps < ITERATIONS:
            r = x + flowed - 1.0
            r = ti.select(y > 0.0, r, 0.0)
            x = ti.max(x - r / (1.0 + m * flowed / x), 1e-36)
            flowed = exp(A + m * log(x))
            unsolved = (ti.max(r, 0.0 - r) - CLOSE).max()
            steps += 1
        g = ti.select(q[4] > 0.0, g * (flowed / (x + flowed)), g)
    return g
