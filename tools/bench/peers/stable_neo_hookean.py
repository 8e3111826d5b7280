"""The law of newton's VBD as a law of gf-usd, so that both can be compared with one reference.

    psi = mu/2 (|F|^2 - 3) - mu (J - 1) + (lam + mu)/2 (J - 1)^2
    P = mu F + ((lam + mu) (J - 1) - mu) cof F

Smith, de Goes and Kim (2018), without the term for degenerate elements, as newton 1.8 has it.
"""

import numpy as np
import taichi as ti

from gf_usd.core.materials.laws import LAWS, LawSpec
from gf_usd.physics.laws.simd3x3 import cofactor, combination, determinant, double_dot


@ti.func
def psi(F, q, converged):
    mu = q[0]
    e = determinant(F, cofactor(F)) - 1.0
    return 0.5 * mu * (double_dot(F, F) - 3.0) - mu * e + 0.5 * (q[1] + mu) * e * e


@ti.func
def pk1(F, q, converged):
    cof = cofactor(F)
    p = (q[1] + q[0]) * (determinant(F, cof) - 1.0) - q[0]
    return combination(q[0], F, p, cof)


def stored(s, J, q):
    """psi of signed stretches (n, 3) and their product J (n,)."""
    e = J - 1.0
    return 0.5 * q[0] * ((s * s).sum(1) - 3.0) - q[0] * e + 0.5 * (q[1] + q[0]) * e * e


def moduli(s, J, q):
    """mu, and d^2 psi / dJ^2."""
    del s
    return q[0], (q[1] + q[0]) * np.ones_like(J)


LAWS["stableNeoHookean"] = LawSpec(
    token="stableNeoHookean", code=__name__, source="Smith, de Goes and Kim 2018, eq. 13"
)
