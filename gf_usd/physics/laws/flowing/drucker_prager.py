"""Drucker-Prager plasticity with Hencky's elastic law: sand, gravel, soil.

With the Kirchhoff stress tau = 2 mu e + lam tr(e) 1, its deviator s and its pressure p = -K tr(e),
K = lam + 2 mu / 3, the admissible shear stress increases with pressure,

    |s| / sqrt(2) <= internal_friction p + cohesion

[Drucker and Prager 1952; with |s| / sqrt(2) the convention of mu(I) rheology, for which an infinite
slope is stable below tan(theta) = internal_friction]. Beyond it the material shears at constant
volume (no dilatancy); under tension beyond the tip of the cone, cohesion / internal_friction, it
separates [Klar et al. 2016, section 6]:

    e -= (1 - k) dev e,   k = sqrt(2) (internal_friction p + cohesion) / (2 mu |dev e|)
    dev e = 0,   tr e = cohesion / (internal_friction K)      beyond the tip

The volume gained by separation, `loosening` = sum of tr(e*) - tr(e), is closed before the material
resists pressure again [Tampubolon et al. 2017, section 4.1]: tr(e) is increased by as much, up to
0. Where a stretch of F_e is below 0.1 or F_e is inverted no flow occurs, as in `von_mises`.
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
from gf_usd.physics.laws.simd3x3 import (
    assign,
    choose,
    cofactor,
    determinant,
    log,
    product,
    scaled,
)

ROOT = 1.4142135623730951


@ti.func
def flow(F, q, a, dt, converged):
    """The return mapping of the module; arguments and results as in `registry`."""
    D, C = gram(F)
    Z = cayley(D, C)
    E = F
    loose = a[0]
    work = a[0] * 0.0
    J = determinant(F, cofactor(F))
    if near(Z, converged) and J.min() > LEAST_J:
        X = deviator_of_series(Z)
        size = ti.sqrt(size_squared(X))
        trace = log(J)
        acts, k, t = returned(q, a[0], size, trace)
        if acts.max() > 0.0:
            loose = ti.select(acts > 0.0, ti.max(a[0] + (trace - t), 0.0), a[0])
            work = ti.select(acts > 0.0, dissipated(q, size, trace, k, t), 0.0)
            assign(X, scaled(k - 1.0, X))
            grown = exp((t - trace) / 3.0)
            choose(E, acts, scaled(grown, product(F, exponential(X))))
    else:
        d, trace, V, least = strains(F)
        size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        acts, k, t = returned(q, a[0], size, trace)
        acts = ti.select(least > J_EXTENSION, acts, 0.0)
        if acts.max() > 0.0:
            loose = ti.select(acts > 0.0, ti.max(a[0] + (trace - t), 0.0), a[0])
            work = ti.select(acts > 0.0, dissipated(q, size, trace, k, t), 0.0)
            m = (t - trace) / 3.0
            n = k - 1.0
            back = [exp(n * d[0] + m), exp(n * d[1] + m), exp(n * d[2] + m)]
            choose(E, acts, product(F, spectral(back, V)))
    return E, [loose], work


@ti.func
def returned(q, loose, size, trace):
    """Positive where the trial strain is not admissible; the factor k on its deviator, and its
    trace.

    size : |dev e| of the trial; trace : tr e of it.
    """
    K = q[1] + q[0] * (2.0 / 3.0)
    t = ti.select(trace < 0.0, ti.min(trace + loose, 0.0), trace)
    tip = q[3] / (q[2] * K)
    most = ROOT * (q[3] - q[2] * K * t) / (2.0 * q[0])
    k = ti.select(size > most, most / ti.max(size, 1e-30), 1.0)
    k = ti.select(t > tip, 0.0, k)
    t = ti.min(t, tip)
    acts = ti.select((k < 1.0) | (t > trace) | (t < trace), trace * 0.0 + 1.0, 0.0)
    return acts, k, t


@ti.func
def dissipated(q, size, trace, k, t):
    """tau : (e* - e) [J/m^3] of the final stress: deviatoric part and pressure part."""
    K = q[1] + q[0] * (2.0 / 3.0)
    return 2.0 * q[0] * k * (1.0 - k) * size * size + K * t * (trace - t)
