"""A weakly compressible fluid: Tait equation of state, viscosity, and bounded tension.

    p = K / gamma (J^-gamma - 1),  gamma = 7,  K = lam + 2 mu / 3
    psi = mu |dev e|^2 + K / gamma ((J^(1 - gamma) - 1) / (gamma - 1) + J - 1)

[Tait's equation as in Batchelor 1967, section 1.8; for particles Monaghan 1994, for grids
Tampubolon et al. 2017]. e is the logarithmic strain of F_e, whose deviator relaxes like that of a
Maxwell fluid, by backward Euler,

    dev e = k dev e*,   k = viscosity / (viscosity + mu dt)

so that the deviatoric stress is 2 viscosity D at a strain rate D below mu / viscosity, for any mu.
K is not a physical property: with K = rho (10 v)^2 a flow at v is compressed by at most 1 %
[Monaghan 1994].

At a free surface, and where it separates, the fluid has no more tension than `cavitation`; the
volume gained there, `loosening`, is closed before pressure builds up again, as in `drucker_prager`.
Below J = 0.5, p is continued by its tangent, so that it is defined for every F.
"""

import numpy as np
import taichi as ti

from gf_usd.physics.laws import hencky
from gf_usd.physics.laws.hencky import bulk_modulus, exp, return_strain
from gf_usd.physics.laws.simd3x3 import cofactor, combination, determinant, log

GAMMA = 7
J_TANGENT = 0.5
LEAST = 1e-6  # lower bound of 1 - gamma cavitation / K


@ti.func
def flow(F, q, a, dt, converged):
    """The return mapping of the module; arguments and results as in `registry`."""
    return return_strain(F, q, a, dt, converged, trial, mapped)


@ti.func
def trial(q, loosening, dt, square, trace):
    """Positive where the trial strain changes; k of the module, and the admissible tr e.

    square, trace : |dev e|^2 and tr e of the trial.
    """
    k = q[2] / ti.max(q[2] + q[0] * dt, 1e-30)
    t = admissible_trace(q, loosening, trace)
    return (1.0 - k) * square + ti.max(t - trace, trace - t), [k, t]


@ti.func
def mapped(q, loosening, acts, square, trace, values):
    """The return of `hencky.return_strain`; values : of `trial`."""
    k, t = values[0], values[1]
    gained = ti.select(acts > 0.0, ti.max(loosening + (trace - t), 0.0), loosening)
    work = ti.select(acts > 0.0, dissipated(q, square, trace, k, t), 0.0)
    return k - 1.0, (t - trace) / 3.0, gained, work


@ti.func
def admissible_trace(q, loosening, trace):
    """tr e after closing the volume gained by separation and bounding tension."""
    t = ti.select(trace < 0.0, ti.min(trace + loosening, 0.0), trace)
    borne = ti.max(1.0 - GAMMA * q[3] / bulk_modulus(q), LEAST)
    return ti.min(t, (0.0 - log(borne)) / GAMMA)


@ti.func
def dissipated(q, square, trace, k, t):
    """tau : (e* - e) [J/m^3] of the final stress: deviatoric part and pressure part."""
    J = exp(t)
    K = bulk_modulus(q)
    return 2.0 * q[0] * k * (1.0 - k) * square + J * slope(J, K) * (trace - t)


@ti.func
def slope(J, K):
    """-p = dU/dJ = K / gamma (1 - J^-gamma), continued by its tangent below J_TANGENT."""
    r = 1.0 / ti.max(J, J_TANGENT)
    r2 = r * r
    r7 = r2 * r2 * r2 * r
    return K * ((1.0 - r7) / GAMMA + r7 * r * ti.min(J - J_TANGENT, 0.0))


@ti.func
def psi(F, q, converged):
    """psi = mu |dev e|^2 + U(J)."""
    J = determinant(F, cofactor(F))
    K = bulk_modulus(q)
    r = 1.0 / ti.max(J, J_TANGENT)
    r2 = r * r
    r6 = r2 * r2 * r2
    at = ti.max(J, J_TANGENT)
    t = ti.min(J - J_TANGENT, 0.0)
    U = ((r6 - 1.0) / (GAMMA - 1) + at - 1.0) / GAMMA
    U = U + t * ((1.0 - r6 * r) / GAMMA + 0.5 * t * r6 * r2)
    return hencky.psi(F, [q[0], q[0] * (-2.0 / 3.0)], converged) + K * U


@ti.func
def pk1(F, q, converged):
    """P = F V diag(2 mu dev e_i / s_i) V^T - p cof F."""
    cof = cofactor(F)
    J = determinant(F, cof)
    K = bulk_modulus(q)
    shear = hencky.pk1(F, [q[0], q[0] * (-2.0 / 3.0)], converged)
    return combination(J * 0.0 + 1.0, shear, slope(J, K), cof)


def stored(s, J, q):
    """psi of signed stretches."""
    K = bulk_modulus(q)
    at, t = np.maximum(J, J_TANGENT), np.minimum(J - J_TANGENT, 0.0)
    U = ((at ** (1 - GAMMA) - 1.0) / (GAMMA - 1) + at - 1.0) / GAMMA
    U = U + t * ((1.0 - at**-GAMMA) / GAMMA + 0.5 * t * at ** (-GAMMA - 1))
    return hencky.stored(s, J, (q[0], q[0] * (-2.0 / 3.0))) + K * U


def moduli(s, J, q):
    """Bounds as in `hencky`: of the deviator, which has 4/3 mu along a stretch, and d^2 U / dJ^2.

    With d = dev e and g = ln s a wave along the least stretch has 2 mu (2/3 g'^2 + d g''), one
    along another at most its tension over the stretch; the quadratic form of waves is convex, so
    that its maximum is along an axis.
    """
    mu, e, least = q[0], hencky.logarithms(s), np.maximum(s[:, 0], hencky.J_EXTENSION)
    t = np.minimum(s[:, 0] - hencky.J_EXTENSION, 0.0) / hencky.J_EXTENSION
    d = e - e.mean(1)[:, None]
    slope, curvature = (1.0 - t) / least, -1.0 / least**2
    pressed = 2.0 * mu * (2.0 / 3.0 * slope**2 + d[:, 0] * curvature)
    pulled = 2.0 * mu[:, None] * d / np.maximum(s, hencky.J_EXTENSION) ** 2
    shear = np.maximum(np.maximum(pressed, pulled.max(1)), 0.0)
    K = bulk_modulus(q)
    return shear, K * np.maximum(J, J_TANGENT) ** (-GAMMA - 1.0)
