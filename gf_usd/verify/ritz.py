"""Vibrations of a free three-dimensional elastic bar by the Ritz method, to six digits.

Displacements are products of Legendre polynomials; the stationary values of strain energy over
kinetic energy are the squared frequencies (Visscher, Migliori, Bell and Reinert 1991, "On the
normal modes of free vibration of inhomogeneous and anisotropic elastic objects").  Polynomials of
high degree do not lock.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import eigh

from gf_usd.core.arrays import Floats, Ints

DEGREES = (14, 7, 6)  # along, in the direction of bending, across: 1e-6 of the frequency
# bending along y, symmetric about the middle: parity of u_x, u_y, u_z in x, y, z (1: odd)
ODD = ((1, 1, 0), (0, 0, 0), (0, 1, 1))


def bending_frequency(nu: float, slenderness: float) -> float:
    """Lowest w L sqrt(rho / E) of a free square bar of length L and thickness L / slenderness."""
    lam, mu = nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 0.5 / (1.0 + nu)
    half = (0.5, 0.5 / slenderness, 0.5 / slenderness)
    tables = [_integrals(n, size) for n, size in zip(DEGREES, half)]
    terms = [
        np.array(list(itertools.product(*(range(odd, n + 1, 2) for odd, n in zip(row, DEGREES)))))
        for row in ODD
    ]
    first = np.cumsum([0, *(len(polynomials) for polynomials in terms)])
    K, M = np.zeros((first[-1],) * 2), np.zeros((first[-1],) * 2)
    for c, d in itertools.product(range(3), repeat=2):
        rows_and_columns = np.s_[first[c] : first[c + 1], first[d] : first[d + 1]]
        K[rows_and_columns] = lam * _product(tables, terms[c], c, terms[d], d)
        K[rows_and_columns] += mu * _product(tables, terms[c], d, terms[d], c)
        if c == d:
            K[rows_and_columns] += mu * sum(
                _product(tables, terms[c], a, terms[c], a) for a in range(3)
            )
            M[rows_and_columns] = _product(tables, terms[c], None, terms[c], None)
    values = eigh(K, M, eigvals_only=True, subset_by_index=[0, 3])
    rigid = 1e-6  # above the eigenvalues of rigid motion, 0 to rounding; vibrations are of order 1
    return float(np.sqrt(values[values > rigid][0]))


def _integrals(degree: int, half: float) -> tuple[Floats, Floats, Floats]:
    """int p_i p_j, int p_i' p_j and int p_i' p_j' over -half .. half, each (degree + 1,) * 2."""
    x, weight = legendre.leggauss(degree + 1)
    polynomials = np.eye(degree + 1)
    p = np.array([legendre.legval(x, row) for row in polynomials])
    slope = np.array([legendre.legval(x, legendre.legder(row)) for row in polynomials]) / half
    w = weight * half
    return (p * w) @ p.T, (slope * w) @ p.T, (slope * w) @ slope.T


def _product(
    tables: list[tuple[Floats, Floats, Floats]], i: Ints, a: int | None, j: Ints, b: int | None
) -> Floats:
    """int d_a f_i d_b f_j (n, m) over the bar; None: no derivative."""
    out = np.ones((len(i), len(j)))
    for axis, (no_derivative, left_derivative, both_derivatives) in enumerate(tables):
        if a == axis and b == axis:
            table = both_derivatives
        elif a == axis:
            table = left_derivative
        else:
            table = left_derivative.T if b == axis else no_derivative
        out *= table[np.ix_(i[:, axis], j[:, axis])]
    return out
