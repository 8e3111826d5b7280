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
    bulk_modulus,
    moduli,
    pk1,
    psi,
    return_strain,
    stored,
)

ROOT = 1.4142135623730951


@ti.func
def flow(F, q, a, dt, converged):
    """The return mapping of the module; arguments and results as in `registry`."""
    return return_strain(F, q, a, dt, converged, trial, mapped)


@ti.func
def trial(q, loosening, dt, square, trace):
    """Positive where the trial strain is not admissible; k of the module, and the admissible tr e.

    square, trace : |dev e|^2 and tr e of the trial.
    """
    size = ti.sqrt(square)
    K = bulk_modulus(q)
    t = ti.select(trace < 0.0, ti.min(trace + loosening, 0.0), trace)
    tip = q[3] / (q[2] * K)
    most = ROOT * (q[3] - q[2] * K * t) / (2.0 * q[0])
    k = ti.select(size > most, most / ti.max(size, 1e-30), 1.0)
    k = ti.select(t > tip, 0.0, k)
    t = ti.min(t, tip)
    acts = ti.select((k < 1.0) | (t > trace) | (t < trace), trace * 0.0 + 1.0, 0.0)
    return acts, [k, t]


@ti.func
def mapped(q, loosening, acts, square, trace, values):
    """The return of `hencky.return_strain`; values : of `trial`."""
    k, t = values[0], values[1]
    gained = ti.select(acts > 0.0, ti.max(loosening + (trace - t), 0.0), loosening)
    work = ti.select(acts > 0.0, dissipated(q, ti.sqrt(square), trace, k, t), 0.0)
    return k - 1.0, (t - trace) / 3.0, gained, work


@ti.func
def dissipated(q, size, trace, k, t):
    """tau : (e* - e) [J/m^3] of the final stress: deviatoric part and pressure part."""
    K = bulk_modulus(q)
    return 2.0 * q[0] * k * (1.0 - k) * size * size + K * t * (trace - t)
