"""The compressible Neo-Hookean law with a logarithmic volumetric term.

    psi = mu/2 (|F|^2 - 3) - mu g(J) + lam/2 g(J)^2,   P = mu F + (lam g - mu) g' cof F

where g is ln J, continued below J0 by its second-order Taylor polynomial, so that both are defined
for every F [Bonet and Wood 2008, eq. 6.28].
"""

import numpy as np
import taichi as ti

from gf_usd.core.arrays import row_dots
from gf_usd.physics.laws.simd3x3 import cofactor, combination, determinant, double_dot, log

J_EXTENSION = 0.1  # J0


@ti.func
def log_extended(J):
    """g(J) = ln J for J >= J0, its second-order Taylor polynomial about J0 below."""
    t = (ti.min(J, J_EXTENSION) - J_EXTENSION) / J_EXTENSION
    return log(ti.max(J, J_EXTENSION)) + t - 0.5 * t * t


@ti.func
def log_extended_slope(J):
    """dg/dJ of `log_extended`."""
    t = (ti.min(J, J_EXTENSION) - J_EXTENSION) / J_EXTENSION
    return ti.select(J >= J_EXTENSION, 1.0 / ti.max(J, J_EXTENSION), (1.0 - t) / J_EXTENSION)


@ti.func
def psi(F, q, converged):
    """psi = mu/2 (|F|^2 - 3) - mu g(J) + lam/2 g(J)^2."""
    mu = q[0]
    g = log_extended(determinant(F, cofactor(F)))
    return 0.5 * mu * (double_dot(F, F) - 3.0) - mu * g + 0.5 * q[1] * g * g


@ti.func
def pk1(F, q, converged):
    """P = mu F + (lam g - mu) g' cof F; for J >= J0 this is mu (F - F^-T) + lam ln J F^-T."""
    mu = q[0]
    cof = cofactor(F)
    J = determinant(F, cof)
    p = (q[1] * log_extended(J) - mu) * log_extended_slope(J)
    return combination(mu, F, p, cof)


@ti.func
def powers(q):
    """c1 and c2 of `radial_flow`: F^T P = mu U^2 + (lam g - mu) g' J 1."""
    return [0.0 * q[0], q[0]]


def stored(s, J, q):
    """psi of stretches: |F|^2 = sum s_i^2."""
    t = (np.minimum(J, J_EXTENSION) - J_EXTENSION) / J_EXTENSION
    g = np.log(np.maximum(J, J_EXTENSION)) + t - 0.5 * t * t
    return 0.5 * q[0] * (row_dots(s, s) - 3.0) - q[0] * g + 0.5 * q[1] * g * g


def moduli(s, J, q):
    """mu, and d^2/dJ^2 of lam/2 g^2 - mu g: lam g'^2 + (lam g - mu) g''."""
    del s
    mu, lam = q[0], q[1]
    t = (np.minimum(J, J_EXTENSION) - J_EXTENSION) / J_EXTENSION
    g = np.log(np.maximum(J, J_EXTENSION)) + t - 0.5 * t * t
    slope = np.where(J >= J_EXTENSION, 1.0 / np.maximum(J, J_EXTENSION), (1.0 - t) / J_EXTENSION)
    curvature = -1.0 / np.maximum(J, J_EXTENSION) ** 2
    return mu, lam * slope**2 + (lam * g - mu) * curvature
