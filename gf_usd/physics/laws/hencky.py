"""Hencky's elastic law in principal stretches, the elastic part of laws with plastic flow.

    psi = mu sum e_i^2 + lam/2 (sum e_i)^2,   e_i = ln s_i,   F = U diag(s) V^T
    P = U diag((2 mu e_i + lam sum e) / s_i) V^T

[Hencky 1928; Simo and Hughes 1998, section 9.3]. The logarithm is continued below s = 0.1 as in
`neo_hookean`, so that both are defined for every F; where det F < 0 the smallest stretch is
negative. A return mapping in e is that of small strains (box 9.1 there).

In most flowing particles the elastic strain is small, and no principal stretches are computed. With
E = 1/2 ln C the stress is P = F^-T (2 mu E + lam tr(E) 1), and for c C = 1 + A near 1, with any
number c,

    1/2 ln (c C) = Z + Z^3/3 + Z^5/5 + ...,   Z = A (2 + A)^-1

has the deviator of E; tr E = ln J. The truncation error of three terms is 2 |Z|^7 / 7, which `NEAR`
bounds by rounding. Return mappings use the same two formulas: see `return_strain`.
"""

import numpy as np
import taichi as ti

from gf_usd.physics.laws.neo_hookean import J_EXTENSION, log_extended, log_extended_slope
from gf_usd.physics.laws.simd3x3 import (
    assign,
    choose,
    cofactor,
    determinant,
    let,
    log,
    product,
    put,
    scaled,
    unrolled,
)

SWEEPS = 6  # of the Jacobi eigenvalue iteration, which converges quadratically
SMALL = 1e-6  # lower bound of a stretch as a divisor
NEAR = 1.0e-2, 6e-5  # |Z|^2 up to which the series is exact to 1e-7, and to 1e-15
LEAST_J = J_EXTENSION**3  # least det F for the series: nearly equal stretches above 0.1


@unrolled
def turn(D, C, V, p, q, r):
    """Jacobi rotation in the plane of p and q; C[r] is the entry at p and q."""
    d = let(D[q] - D[p])
    size = let(ti.sqrt(d * d + 4.0 * C[r] * C[r]) + ti.select(d >= 0.0, d, 0.0 - d) + 1e-30)
    t = let(ti.select(d >= 0.0, 2.0 * C[r], -2.0 * C[r]) / size)
    c = let(1.0 / ti.sqrt(1.0 + t * t))
    s = let(t * c)
    put(D[p], D[p] - t * C[r])
    put(D[q], D[q] + t * C[r])
    put(C[r], C[r] * 0.0)
    rp = let(C[q])
    put(C[q], c * rp - s * C[p])
    put(C[p], s * rp + c * C[p])
    for a in range(0, 9, 3):
        v = let(V[a + p])
        put(V[a + p], c * v - s * V[a + q])
        put(V[a + q], s * v + c * V[a + q])


@unrolled
def gram(F):
    """Diagonal and off-diagonal entries of F^T F; entry r is that of the plane of the other two
    axes.
    """

    def dot(p, q):
        return F[p] * F[q] + F[3 + p] * F[3 + q] + F[6 + p] * F[6 + q]

    return [dot(0, 0), dot(1, 1), dot(2, 2)], [dot(1, 2), dot(0, 2), dot(0, 1)]


@ti.func
def stretches(F):
    """Signed stretches s and their directions V at rest, F^T F = V diag(s^2) V^T."""
    zero = F[0] * 0.0
    one = zero + 1.0
    V = [one, zero, zero, zero, one, zero, zero, zero, one]
    D, C = gram(F)
    for _ in range(SWEEPS):
        turn(D, C, V, 0, 1, 2)
        turn(D, C, V, 0, 2, 1)
        turn(D, C, V, 1, 2, 0)
    J = determinant(F, cofactor(F))
    first = (D[0] <= D[1]) & (D[0] <= D[2])
    second = (D[1] < D[0]) & (D[1] <= D[2])
    third = (D[2] < D[0]) & (D[2] < D[1])
    s0 = ti.sqrt(ti.max(D[0], 0.0))
    s1 = ti.sqrt(ti.max(D[1], 0.0))
    s2 = ti.sqrt(ti.max(D[2], 0.0))
    s0 = ti.select((J < 0.0) & first, 0.0 - s0, s0)
    s1 = ti.select((J < 0.0) & second, 0.0 - s1, s1)
    s2 = ti.select((J < 0.0) & third, 0.0 - s2, s2)
    return [s0, s1, s2], V


@unrolled
def spectral(d, V):
    """V diag(d) V^T."""
    left = let([V[3 * a + i] * d[i] for a in range(3) for i in range(3)])
    return let(product(left, [V[3 * b + a] for a in range(3) for b in range(3)]))


@ti.func
def over(p, s):
    """p / s, bounded for small s."""
    return p / ti.select(s >= 0.0, ti.max(s, SMALL), ti.min(s, -SMALL))


@ti.func
def exp(x):
    """e^x, lane by lane."""
    return ti.Vector([ti.exp(x[lane]) for lane in ti.static(range(x.n))])


@ti.func
def strains(F):
    """Deviator d_i and trace of e, the directions V, and the least stretch.

    Where that is not above J_EXTENSION, e is not the logarithm, and return mappings do not apply.
    """
    s, V = stretches(F)
    e0 = log_extended(s[0])
    e1 = log_extended(s[1])
    e2 = log_extended(s[2])
    trace = e0 + e1 + e2
    mean = trace / 3.0
    least = ti.min(s[0], ti.min(s[1], s[2]))
    return [e0 - mean, e1 - mean, e2 - mean], trace, V, least


@unrolled
def commuting(A, B):
    """A B of commuting symmetric matrices: the diagonal, then the entries at 12, 02 and 01."""
    a, b, c, d, e, f = A
    u, v, w, x, y, z = B
    return let(
        [
            a * u + e * y + f * z, b * v + d * x + f * z, c * w + d * x + e * y,
            f * y + b * x + d * w, a * y + f * x + e * w, a * z + f * v + e * x,
        ]
    )  # fmt: skip


@unrolled
def cayley(D, C):
    """Z = A (2 + A)^-1 of a symmetric matrix 1 + A, scaled to the trace 3."""
    k = let(3.0 / ti.max(D[0] + D[1] + D[2], 1e-30))
    a, b, c = let([k * D[i] + 1.0 for i in range(3)])
    d, e, f = let([k * C[i] for i in range(3)])
    cof = let([b * c - d * d, a * c - e * e, a * b - f * f, e * f - a * d, d * f - b * e,
               d * e - c * f])  # fmt: skip
    r = let(2.0 / (a * cof[0] + f * cof[5] + e * cof[4]))
    return let([1.0 - r * cof[i] for i in range(3)] + [0.0 - r * cof[i] for i in range(3, 6)])


@unrolled
def size_squared(Z):
    """Z : Z."""
    return let(
        Z[0] * Z[0] + Z[1] * Z[1] + Z[2] * Z[2]
        + 2.0 * (Z[3] * Z[3] + Z[4] * Z[4] + Z[5] * Z[5])
    )  # fmt: skip


@unrolled
def deviator_of_series(Z):
    """Deviator of Z + Z^3/3 + Z^5/5."""
    W = commuting(Z, Z)
    V = commuting(W, W)
    Y = [1.0 + W[i] / 3.0 + 0.2 * V[i] for i in range(3)]
    L = commuting(Z, let(Y + [W[i] / 3.0 + 0.2 * V[i] for i in range(3, 6)]))
    mean = let((L[0] + L[1] + L[2]) / 3.0)
    return let([L[0] - mean, L[1] - mean, L[2] - mean, L[3], L[4], L[5]])


@unrolled
def exponential(X):
    """1 + X + X^2/2 + X^3/6 + X^4/24 of a symmetric X, as nine entries."""
    S = commuting(X, X)
    T = commuting(S, let([0.5 + X[i] / 6.0 + S[i] / 24.0 for i in range(3)]
                         + [X[i] / 6.0 + S[i] / 24.0 for i in range(3, 6)]))  # fmt: skip
    a, b, c = (1.0 + X[i] + T[i] for i in range(3))
    d, e, f = let([X[i] + T[i] for i in range(3, 6)])
    return let([a, f, e, f, b, d, e, d, c])


@ti.func
def near(Z, converged):
    """Whether the series is accurate in every lane."""
    most = NEAR[1]
    if converged > 1e-10:
        most = NEAR[0]
    return size_squared(Z).max() < most


@unrolled
def bulk_modulus(q):
    """K = lam + 2 mu / 3 [Pa]; q of kernels or of NumPy."""
    return q[1] + q[0] * (2.0 / 3.0)


@ti.func
def return_strain(
    F, q, a, dt, converged, trial: ti.template(), mapped: ti.template()
):  # fmt: skip
    """`flow` of the registry for a law that scales dev e and shifts tr e,

        dev e = (1 + k) dev e*,   tr e = tr e* + 3 m

    trial(q, a, dt, square, trace) : a number > 0 in lanes that flow, and values for `mapped`, of
    the internal variable a, square = |dev e*|^2 and trace = tr e*.
    mapped(q, a, acts, square, trace, values) : k, m, the internal variable and the work [J/m^3];
    acts : > 0 in lanes that flow.

    Where a stretch of F is below J_EXTENSION or F is inverted no flow occurs.
    """
    D, C = gram(F)
    Z = cayley(D, C)
    E = F
    internal = a[0]
    work = a[0] * 0.0
    J = determinant(F, cofactor(F))
    if near(Z, converged) and J.min() > LEAST_J:
        X = deviator_of_series(Z)
        square = size_squared(X)
        trace = log(J)
        acts, values = trial(q, a[0], dt, square, trace)
        if acts.max() > 0.0:
            k, m, internal, work = mapped(q, a[0], acts, square, trace, values)
            assign(X, scaled(k, X))
            choose(E, acts, scaled(exp(m), product(F, exponential(X))))
    else:
        d, trace, V, least = strains(F)
        square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        acts, values = trial(q, a[0], dt, square, trace)
        acts = ti.select(least > J_EXTENSION, acts, 0.0)
        if acts.max() > 0.0:
            k, m, internal, work = mapped(q, a[0], acts, square, trace, values)
            back = [exp(k * d[0] + m), exp(k * d[1] + m), exp(k * d[2] + m)]
            choose(E, acts, product(F, spectral(back, V)))
    return E, [internal], work


@ti.func
def psi(F, q, converged):
    """psi = mu sum e_i^2 + lam/2 (sum e_i)^2."""
    s, _ = stretches(F)
    e0 = log_extended(s[0])
    e1 = log_extended(s[1])
    e2 = log_extended(s[2])
    trace = e0 + e1 + e2
    return q[0] * (e0 * e0 + e1 * e1 + e2 * e2) + 0.5 * q[1] * trace * trace


@ti.func
def pk1(F, q, converged):
    """P = F^-T (2 mu E + lam tr(E) 1), by the series or by principal stretches."""
    cof = cofactor(F)
    J = determinant(F, cof)
    D, C = gram(F)
    Z = cayley(D, C)
    P = F
    if near(Z, converged) and J.min() > J_EXTENSION:
        small_pk1(P, q, cof, J, deviator_of_series(Z), log(J))
    else:
        assign(P, spectral_pk1(F, q))
    return P


@unrolled
def small_pk1(P, q, cof, J, d, trace):
    """P = cof(F) / J (2 mu d + (lam + 2 mu / 3) tr(E) 1), in place; d the deviator of E."""
    r = let(1.0 / J)
    m = let(2.0 * q[0] * r)
    pressure = let(bulk_modulus(q) * trace * r)
    a, b, c = let([m * d[i] + pressure for i in range(3)])
    x, y, z = let([m * d[i] for i in range(3, 6)])
    assign(P, product(cof, [a, z, y, z, b, x, y, x, c]))


@ti.func
def spectral_pk1(F, q):
    """P = F V diag(p_i / s_i) V^T, p_i = (2 mu e_i + lam sum e) de_i/ds_i."""
    s, V = stretches(F)
    e0 = log_extended(s[0])
    e1 = log_extended(s[1])
    e2 = log_extended(s[2])
    m = 2.0 * q[0]
    pressure = q[1] * (e0 + e1 + e2)
    p0 = over((m * e0 + pressure) * log_extended_slope(s[0]), s[0])
    p1 = over((m * e1 + pressure) * log_extended_slope(s[1]), s[1])
    p2 = over((m * e2 + pressure) * log_extended_slope(s[2]), s[2])
    return product(F, spectral([p0, p1, p2], V))


def logarithms(s):
    """e (N, 3) of signed stretches."""
    t = (np.minimum(s, J_EXTENSION) - J_EXTENSION) / J_EXTENSION
    return np.log(np.maximum(s, J_EXTENSION)) + t - 0.5 * t * t


def stored(s, J, q):
    """psi of signed stretches."""
    del J
    e = logarithms(s)
    return q[0] * (e * e).sum(1) + 0.5 * q[1] * e.sum(1) ** 2


def moduli(s, J, q):
    """Bounds of the stiffness for plane waves, from the second derivatives in s.

    With g = ln s, a wave along n and N has a_ij = n_i N_j in the axes of s, where sum |a_ii| and
    sum a_ij^2 are at most 1. So (sum a_ii g_i')^2 lam <= lam g'^2 of the least stretch, and the
    rest is at most the greater of 2 mu (g'^2 + g g'') + lam tr(e) g'' there and of the largest
    tension over its stretch, (2 mu e_i + lam tr(e)) / s_i^2.
    """
    del J
    mu, lam = q[0], q[1]
    e, least = logarithms(s), np.maximum(s[:, 0], J_EXTENSION)
    t = np.minimum(s[:, 0] - J_EXTENSION, 0.0) / J_EXTENSION
    trace, slope, curvature = e.sum(1), (1.0 - t) / least, -1.0 / least**2
    pressed = 2.0 * mu * (slope**2 + e[:, 0] * curvature) + lam * trace * curvature
    pulled = (2.0 * mu[:, None] * e + (lam * trace)[:, None]) / np.maximum(s, J_EXTENSION) ** 2
    across = np.maximum(s[:, 1], SMALL) * np.maximum(s[:, 2], SMALL)
    shear = np.maximum(np.maximum(pressed, pulled.max(1)), 0.0) + lam * (slope**2 - 1.0 / least**2)
    return shear, lam / (least * across) ** 2
