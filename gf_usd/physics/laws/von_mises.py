"""Von Mises plasticity with Hencky's elastic law: metals, clay, paste.

With the Kirchhoff stress tau = 2 mu e + lam tr(e) 1, s its deviator, sigma = sqrt(3/2) |s| and the
equivalent plastic strain a, plastic flow occurs where

    sigma > Y(a) = yield_stress + hardening a + saturation (1 - exp(-saturation_rate a))

(linear hardening, and saturating hardening by Voce), at the rate of Perzyna's viscoplasticity,
da/dt = (sigma - Y(a)) / viscosity; instantaneous for viscosity 0. Radial return, backward Euler in
a [Simo and Hughes 1998, boxes 3.1, 3.2 and 9.1; Perzyna 1966]: with the trial stress sigma*,

    sigma* - 3 mu g = Y(a + g) + viscosity g / dt,   e -= g sqrt(3/2) s / |s|,   a += g

The left side decreases and the right side increases with g, so that the solution is unique;
Newton's method converges to it from below, since Y is concave. The flow preserves det F_p = 1 and
dissipates (sigma* - 3 mu g) g. Where a stretch of F_e is below 0.1 or F_e is inverted no flow
occurs, until the elastic forces have restored the particle.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import (  # noqa: F401  (functions of the law: see `registry`)
    LEAST_J,
    cayley,
    deviator_of_series,
    exp,
    exponential,
    gram,
    moduli,
    near,
    pk1,
    psi,
    size_squared,
    spectral,
    stored,
    strains,
)
from gf_usd.physics.laws.neo_hookean import J_EXTENSION
from gf_usd.physics.laws.simd3x3 import assign, choose, cofactor, determinant, product, scaled

ITERATIONS = 12  # largest number of Newton steps: quadratic convergence, monotone from below
CLOSE = 1e-5  # residual relative to the excess; quadratic convergence squares it in one step
MARGIN = 1.02  # 1 + |Z|^2 of the series
INSTANT = 1e-30  # [s] lower bound of dt as a divisor: viscous flow then vanishes


@ti.func
def flow(F, q, a, dt, converged):
    """The return mapping of the module; arguments and results as in `registry`."""
    return radial_return(F, q, a, dt, converged, bearable, growth)


@ti.func
def radial_return(
    F, q, a, dt, converged, bears: ti.template(), grows: ti.template()
):  # fmt: skip
    """F, plastic strain and work after the radial return.

    bears : yield stress [Pa] as a function of q and the plastic strain; grows : as `growth`.
    """
    D, C = gram(F)
    Z = cayley(D, C)
    E = F
    g = a[0] * 0.0
    borne = g
    if near(Z, converged):
        Y = bears(q, a[0])
        # |dev E| <= |E| <= |Z| (1 + |Z|^2): below yield by this bound, no series is computed.
        if (ti.sqrt(6.0) * q[0] * ti.sqrt(size_squared(Z)) * MARGIN - Y).max() > 0.0:
            X = deviator_of_series(Z)
            size = ti.sqrt(size_squared(X))
            y = ti.sqrt(6.0) * q[0] * size - Y
            y = ti.select(determinant(F, cofactor(F)) > LEAST_J, y, 0.0)
            if y.max() > 0.0:
                g = grows(q, a[0], size, y, dt)
                borne = ti.sqrt(6.0) * q[0] * size - 3.0 * q[0] * g
                assign(X, scaled(0.0 - ti.sqrt(1.5) * g / ti.max(size, 1e-30), X))
                choose(E, y, product(F, exponential(X)))
    else:
        d, _, V, least = strains(F)
        size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        y = ti.sqrt(6.0) * q[0] * size - bears(q, a[0])
        y = ti.select(least > J_EXTENSION, y, 0.0)
        if y.max() > 0.0:
            g = grows(q, a[0], size, y, dt)
            borne = ti.sqrt(6.0) * q[0] * size - 3.0 * q[0] * g
            k = 0.0 - ti.sqrt(1.5) * g / ti.max(size, 1e-30)
            choose(E, y, product(F, spectral([exp(k * d[0]), exp(k * d[1]), exp(k * d[2])], V)))
    return E, [a[0] + g], borne * g


@ti.func
def growth(q, a, size, y, dt):
    """g of the module, 0 where the excess y [Pa] is not positive; size : |dev e| of the trial."""
    stress = ti.sqrt(6.0) * q[0] * size
    slow = q[6] / ti.max(dt, INSTANT)
    g = y * 0.0
    steps, unsolved = 0, 1.0
    while unsolved > 0.0 and steps < ITERATIONS:
        r = stress - 3.0 * q[0] * g - bearable(q, a + g) - slow * g
        r = ti.select(y > 0.0, r, 0.0)
        g = g + r / (3.0 * q[0] + hardening(q, a + g) + slow)
        unsolved = (ti.max(r, 0.0 - r) - CLOSE * ti.max(y, 0.0)).max()
        steps += 1
        if q[4].max() <= 0.0:  # linear: one step is exact
            unsolved = 0.0
    return g


@ti.func
def bearable(q, a):
    """Y(a) [Pa]."""
    Y = q[2] + q[3] * a
    if q[4].max() > 0.0:
        Y = Y + q[4] * (1.0 - exp(0.0 - q[5] * a))
    return Y


@ti.func
def hardening(q, a):
    """dY/da [Pa]."""
    H = q[3]
    if q[4].max() > 0.0:
        H = H + q[4] * q[5] * exp(0.0 - q[5] * a)
    return H
