"""Constitutive laws: one registry row each.

A law is an energy density psi(F) [J/m^3 of rest volume] and its gradient, the first Piola-Kirchhoff
stress P = d psi / d F [Pa].  Both are defined for every F, inverted ones included, and are written
on lanes (see `lanes`): F and P are lists of nine lane vectors, mu and lam lane vectors [Pa].
The tests run over the registry, so that a new row is held to gradient, objectivity and rest state
the moment it stands here.  A body of several laws is simulated with `MIXED`, which is none of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import taichi as ti

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials import Material
from gf_usd.physics.laws.simd3x3 import (
    chosen,
    cofactor,
    combination,
    determinant,
    difference,
    double_dot,
    log,
    rotation,
)

J_EXTENSION = 0.1  # below this J the logarithm is continued by its second-order Taylor polynomial


@dataclass(frozen=True, kw_only=True)
class Law:
    """One constitutive law."""

    token: str  # the value of gaussianFlesh:law
    psi: Callable  # (F, mu, lam, converged) -> energy density
    pk1: Callable  # (F, mu, lam, converged) -> P
    shear: Callable  # (mu) -> d^2 psi / dF^2 along the planes that keep J [Pa], in numpy
    bulk: Callable  # (J, mu, lam) -> d^2 psi / dJ^2 [Pa], in numpy
    stored: Callable  # (s, J, mu, lam) -> psi, in numpy; s (N, 3) signed stretches, their product J
    source: str


@ti.func
def corotated_psi(F, mu, lam, converged):
    """psi = mu |F - R|^2 + lam/2 (J - 1)^2."""
    R = rotation(F, converged)
    J = determinant(F, cofactor(F))
    D = difference(F, R)
    return mu * double_dot(D, D) + 0.5 * lam * (J - 1.0) * (J - 1.0)


@ti.func
def corotated_pk1(F, mu, lam, converged):
    """P = 2 mu (F - R) + lam (J - 1) cof F."""
    R = rotation(F, converged)
    cof = cofactor(F)
    p = lam * (determinant(F, cof) - 1.0)
    m = 2.0 * mu
    return combination(m, difference(F, R), p, cof)


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
def neo_hookean_psi(F, mu, lam, converged):
    """psi = mu/2 (|F|^2 - 3) - mu g(J) + lam/2 g(J)^2, g = ln J extended."""
    g = log_extended(determinant(F, cofactor(F)))
    return 0.5 * mu * (double_dot(F, F) - 3.0) - mu * g + 0.5 * lam * g * g


@ti.func
def neo_hookean_pk1(F, mu, lam, converged):
    """P = mu F + (lam g - mu) g' cof F; for J >= J0 this is mu (F - F^-T) + lam ln J F^-T."""
    cof = cofactor(F)
    J = determinant(F, cof)
    q = (lam * log_extended(J) - mu) * log_extended_slope(J)
    return combination(mu, F, q, cof)


def corotated_stored(s, J, mu, lam):
    """psi of signed stretches: |F - R|^2 = sum (s_i - 1)^2."""
    return mu * ((s - 1.0) ** 2).sum(1) + 0.5 * lam * (J - 1.0) ** 2


def neo_hookean_stored(s, J, mu, lam):
    """psi of stretches: |F|^2 = sum s_i^2."""
    t = (np.minimum(J, J_EXTENSION) - J_EXTENSION) / J_EXTENSION
    g = np.log(np.maximum(J, J_EXTENSION)) + t - 0.5 * t * t
    return 0.5 * mu * ((s * s).sum(1) - 3.0) - mu * g + 0.5 * lam * g * g


def corotated_bulk(J, mu, lam):
    """d^2/dJ^2 of lam/2 (J - 1)^2."""
    return lam * np.ones_like(J)


def neo_hookean_bulk(J, mu, lam):
    """d^2/dJ^2 of lam/2 g^2 - mu g: lam g'^2 + (lam g - mu) g''."""
    t = (np.minimum(J, J_EXTENSION) - J_EXTENSION) / J_EXTENSION
    g = np.log(np.maximum(J, J_EXTENSION)) + t - 0.5 * t * t
    slope = np.where(J >= J_EXTENSION, 1.0 / np.maximum(J, J_EXTENSION), (1.0 - t) / J_EXTENSION)
    curvature = -1.0 / np.maximum(J, J_EXTENSION) ** 2
    return lam * slope**2 + (lam * g - mu) * curvature


@ti.func
def mixed_psi(F, mu, lam, converged):
    """Corotated where mu > 0, Neo-Hookean of -mu where mu < 0."""
    shear = ti.max(mu, 0.0 - mu)
    one = corotated_psi(F, shear, lam, converged)
    return ti.select(mu > 0.0, one, neo_hookean_psi(F, shear, lam, converged))


@ti.func
def mixed_pk1(F, mu, lam, converged):
    """P of `mixed_psi`."""
    shear = ti.max(mu, 0.0 - mu)
    P = corotated_pk1(F, shear, lam, converged)
    other = neo_hookean_pk1(F, shear, lam, converged)
    return chosen(mu > 0.0, P, other)


LAWS: dict[str, Law] = {
    law.token: law
    for law in (
        Law(
            token="corotated",
            psi=corotated_psi,
            pk1=corotated_pk1,
            shear=lambda mu: 2.0 * mu,
            bulk=corotated_bulk,
            stored=corotated_stored,
            source="GaussianFlesh eq. 5; Stomakhin et al. 2012 (fixed corotated)",
        ),
        Law(
            token="neoHookean",
            psi=neo_hookean_psi,
            pk1=neo_hookean_pk1,
            shear=lambda mu: mu,
            bulk=neo_hookean_bulk,
            stored=neo_hookean_stored,
            source="Bonet and Wood 2008, eq. 6.28",
        ),
    )
}

# Which law a particle has stands in the sign of its mu, so that the kernels need no more arrays.
MIXED = Law(
    token="mixed",
    psi=mixed_psi,
    pk1=mixed_pk1,
    shear=lambda mu: np.where(mu > 0.0, 2.0 * mu, -mu),
    bulk=lambda J, mu, lam: np.where(
        mu > 0.0, corotated_bulk(J, mu, lam), neo_hookean_bulk(J, np.abs(mu), lam)
    ),
    stored=lambda s, J, mu, lam: np.where(
        mu > 0.0, corotated_stored(s, J, mu, lam), neo_hookean_stored(s, J, np.abs(mu), lam)
    ),
    source="each particle's own",
)


def law_of(materials: Sequence[Material]) -> Law:
    """The law that simulates all of these materials; ValueError where none does."""
    tokens = {material.law for material in materials}
    if len(tokens) == 1:
        return LAWS[tokens.pop()]
    if tokens != {"corotated", "neoHookean"}:
        raise ValueError(f"no law simulates {', '.join(sorted(tokens))} together")
    return MIXED


def moduli(law: Law, materials: Sequence[Material], material: Ints, mu: Floats) -> Floats:
    """mu (N,) [Pa] as the kernels of `law` want it; material : (N,) into materials."""
    if law is not MIXED:
        return mu
    neo = np.array([one.law == "neoHookean" for one in materials])
    return np.where(neo[material], -mu, mu)
