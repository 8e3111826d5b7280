"""The fixed corotated law.

    psi = mu |F - R|^2 + lam/2 (J - 1)^2,   P = 2 mu (F - R) + lam (J - 1) cof F

with F = R S the polar decomposition [GaussianFlesh eq. 5; Stomakhin et al. 2012].
"""

import numpy as np
import taichi as ti

from gf_usd.physics.laws.simd3x3 import (
    cofactor,
    combination,
    determinant,
    difference,
    double_dot,
    rotation,
)


@ti.func
def psi(F, q, converged):
    """psi = mu |F - R|^2 + lam/2 (J - 1)^2."""
    R = rotation(F, converged)
    J = determinant(F, cofactor(F))
    D = difference(F, R)
    return q[0] * double_dot(D, D) + 0.5 * q[1] * (J - 1.0) * (J - 1.0)


@ti.func
def pk1(F, q, converged):
    """P = 2 mu (F - R) + lam (J - 1) cof F."""
    R = rotation(F, converged)
    cof = cofactor(F)
    p = q[1] * (determinant(F, cof) - 1.0)
    m = 2.0 * q[0]
    return combination(m, difference(F, R), p, cof)


@ti.func
def powers(q):
    """c1 and c2 of `radial_flow`: F^T P = 2 mu (U^2 - U) + lam (J - 1) J 1."""
    return [-2.0 * q[0], 2.0 * q[0]]


def stored(s, J, q):
    """psi of signed stretches: |F - R|^2 = sum (s_i - 1)^2."""
    return q[0] * ((s - 1.0) ** 2).sum(1) + 0.5 * q[1] * (J - 1.0) ** 2


def moduli(s, J, q):
    """2 mu, and d^2/dJ^2 of lam/2 (J - 1)^2."""
    del s
    return 2.0 * q[0], q[1] * np.ones_like(J)
