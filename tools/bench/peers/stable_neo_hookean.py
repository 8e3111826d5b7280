"""The law of newton's VBD, as a row for gf-usd: only so that both can be held to one reference.

    psi = mu/2 (|F|^2 - 3) - mu (J - 1) + (lam + mu)/2 (J - 1)^2
    P = mu F + ((lam + mu) (J - 1) - mu) cof F

Smith, de Goes and Kim (2018), without the term for degenerate elements, as newton 1.8 has it.
"""

import numpy as np
import taichi as ti

from gf_usd.physics.laws.registry import LAWS, Law
from gf_usd.physics.laws.simd3x3 import cofactor, combination, determinant, double_dot


@ti.func
def psi(F, mu, lam, converged):
    e = determinant(F, cofactor(F)) - 1.0
    return 0.5 * mu * (double_dot(F, F) - 3.0) - mu * e + 0.5 * (lam + mu) * e * e


@ti.func
def pk1(F, mu, lam, converged):
    cof = cofactor(F)
    q = (lam + mu) * (determinant(F, cof) - 1.0) - mu
    return combination(mu, F, q, cof)


def bulk(J, mu, lam):
    """d^2 psi / dJ^2."""
    return (lam + mu) * np.ones_like(J)


def stored(s, J, mu, lam):
    """psi of signed stretches (n, 3) and their product J (n,)."""
    e = J - 1.0
    return 0.5 * mu * ((s * s).sum(1) - 3.0) - mu * e + 0.5 * (lam + mu) * e * e


LAWS["stableNeoHookean"] = Law(
    token="stableNeoHookean", psi=psi, pk1=pk1, shear=lambda mu: mu, bulk=bulk, stored=stored,
    source="Smith, de Goes and Kim 2018, eq. 13",
)  # fmt: skip
