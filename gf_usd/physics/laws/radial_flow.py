"""Von Mises flow over the elastic energy of any isotropic law.

tau = P F^T is the Kirchhoff stress of the law at F_e = U diag(s) V^T, sigma = sqrt(3/2) |dev tau|,
and d the deviator of e = ln s.  The material flows where sigma exceeds Y(a) of `von_mises`:

    e(g) = e* - g n,  n = sqrt(3/2) d* / |d*|,   sigma(e(g)) = Y(a + g) + viscosity g / dt,   a += g

The left side is sigma* at g = 0 and vanishes at g = sqrt(2/3) |d*|, where e(g) is spherical: there
is a solution between, which the secant method finds, from the return of Hencky's law on, and
halving where the secant leaves the bracket [Dahlquist and Bjorck 1974, section 6.4].
Only the law's stress is asked for.  Hencky's law has dev tau = 2 mu d, and
this is the radial return of `von_mises`; of other laws the flow along d is the associated one
[Simo and Hughes 1998, box 9.1] to the first order in F_e - 1.  It keeps det F_p = 1, and dissipates
g tau : n, which is no less than 0 wherever a greater stretch has the greater
stress, the inequalities of Baker and Ericksen [Truesdell and Noll 1965, section 51].  Where it has
not, as of the corotated law below half of the length at rest, nothing flows.

What flows is hardly strained by F_e, and then d is the series of `hencky`, F_e(g) = F_e* exp(-g n)
with n at rest, and the stress is that of F^T P, which has the numbers of tau.  Larger strains take
principal stretches.  Where a stretch is below 0.1 or F is inverted nothing flows: the law pushes it
back first.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import (
    cayley,
    deviator_of_series,
    exp,
    exponential,
    gram,
    near,
    size_squared,
    spectral,
    stretches,
)
from gf_usd.physics.laws.neo_hookean import J_EXTENSION
from gf_usd.physics.laws.simd3x3 import choose, cofactor, determinant, log, product, scaled
from gf_usd.physics.laws.von_mises import INSTANT, bearable, hardening

ITERATIONS = 24  # at most: superlinear, and halving at the worst
TINY = 1e-30


@ti.func
def flow_along_strain(pk1: ti.template(), F, q, a, dt, converged):
    """`flow` of the registry, of a law with the stress pk1 and the parameters of `von_mises`."""
    E = F
    g = a[0] * 0.0
    work = g
    y = equivalent(pk1(F, q, converged), F) - bearable(q, a[0])
    if y.max() > 0.0:
        D, C = gram(F)
        Z = cayley(D, C)
        if near(Z, converged) and determinant(F, cofactor(F)).min() > J_EXTENSION:
            X = deviator_of_series(Z)
            size = ti.sqrt(size_squared(X))
            n = scaled(ti.sqrt(1.5) / ti.max(size, TINY), X)
            most = ti.sqrt(2.0 / 3.0) * size
            g, work = growth(pk1, near_stress, q, a[0], F, n, most, y, dt, converged)
            choose(E, g, product(F, exponential(scaled(0.0 - g, n))))
        else:
            s, V = stretches(F)
            e0 = log(ti.max(s[0], J_EXTENSION))
            e1 = log(ti.max(s[1], J_EXTENSION))
            e2 = log(ti.max(s[2], J_EXTENSION))
            mean = (e0 + e1 + e2) / 3.0
            d = [e0 - mean, e1 - mean, e2 - mean]
            size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            n = scaled(ti.sqrt(1.5) / ti.max(size, TINY), d)
            y = ti.select(ti.min(s[0], ti.min(s[1], s[2])) > J_EXTENSION, y, 0.0)
            if y.max() > 0.0:
                most = ti.sqrt(2.0 / 3.0) * size
                g, work = growth(pk1, principal_stress, q, a[0], s, n, most, y, dt, converged)
                choose(E, g, product(F, spectral(shrinking(n, g), V)))
    return E, [a[0] + g], work


@ti.func
def growth(pk1: ti.template(), law: ti.template(), q, a, trial, n, most, y, dt, converged):
    """g of the module in (0, most), and the work; 0 where the excess y [Pa] or that is not above 0.

    law(pk1, trial, n, g, q, converged) : sigma(e(g)) and tau : n [Pa].
    """
    slow = q[6] / ti.max(dt, INSTANT)
    enough = ti.sqrt(converged * ti.sqrt(converged))  # of the stress: some digits above rounding
    rounding = converged * q[0]  # [Pa] of a stress that is worked out from F - 1
    low = y * 0.0
    high = most
    before = low
    r_before = ti.max(y, 0.0)
    g = ti.min(r_before / (3.0 * q[0] + hardening(q, a) + slow), most)  # of Hencky's law
    work = low
    steps, unsolved = 0, 1.0
    while unsolved > 0.0 and steps < ITERATIONS:
        stress, along = law(pk1, trial, n, g, q, converged)
        work = g * along
        r = stress - bearable(q, a + g) - slow * g
        away = ti.select(y > 0.0, ti.max(r, 0.0 - r) - enough * stress - rounding, 0.0)
        unsolved = away.max()
        low = ti.select(r > 0.0, g, low)
        high = ti.select(r > 0.0, high, g)
        fall = r_before - r
        fall = ti.select(fall >= 0.0, ti.max(fall, TINY), ti.min(fall, -TINY))
        step = g + r * (g - before) / fall
        step = ti.select((step > low) & (step < high), step, 0.5 * (low + high))
        before = g
        r_before = r
        g = ti.select(away > 0.0, step, g)
        steps += 1
    return ti.select(work > 0.0, g, 0.0), ti.max(work, 0.0)


@ti.func
def near_stress(pk1: ti.template(), F, n, g, q, converged):
    """sigma and tau : n [Pa] at F exp(-g n), by F^T P; n : six entries of `hencky`."""
    E = product(F, exponential(scaled(0.0 - g, n)))
    P = pk1(E, q, converged)
    a = E[0] * P[0] + E[3] * P[3] + E[6] * P[6]
    b = E[1] * P[1] + E[4] * P[4] + E[7] * P[7]
    c = E[2] * P[2] + E[5] * P[5] + E[8] * P[8]
    x = E[1] * P[2] + E[4] * P[5] + E[7] * P[8]
    y = E[0] * P[2] + E[3] * P[5] + E[6] * P[8]
    z = E[0] * P[1] + E[3] * P[4] + E[6] * P[7]
    normal = equivalent_of([a, b, c])
    along = a * n[0] + b * n[1] + c * n[2] + 2.0 * (x * n[3] + y * n[4] + z * n[5])
    return ti.sqrt(normal * normal + 3.0 * (x * x + y * y + z * z)), along


@ti.func
def principal_stress(pk1: ti.template(), s, n, g, q, converged):
    """sigma and tau : n [Pa] at the stretches s_i exp(-g n_i)."""
    k = shrinking(n, g)
    x, y, z = s[0] * k[0], s[1] * k[1], s[2] * k[2]
    o = x * 0.0
    P = pk1([x, o, o, o, y, o, o, o, z], q, converged)
    tau = [P[0] * x, P[4] * y, P[8] * z]
    return equivalent_of(tau), tau[0] * n[0] + tau[1] * n[1] + tau[2] * n[2]


@ti.func
def shrinking(n, g):
    """exp(-g n_i)."""
    k = 0.0 - g
    return [exp(k * n[0]), exp(k * n[1]), exp(k * n[2])]


@ti.func
def equivalent_of(tau):
    """sqrt(3/2) |dev tau| [Pa] of principal stresses."""
    a = tau[0] - tau[1]
    b = tau[1] - tau[2]
    c = tau[2] - tau[0]
    return ti.sqrt(0.5 * (a * a + b * b + c * c))


@ti.func
def equivalent(P, F):
    """sqrt(3/2) |dev tau| [Pa] of tau = P F^T."""
    T = product(P, [F[0], F[3], F[6], F[1], F[4], F[7], F[2], F[5], F[8]])
    shear = T[1] * T[1] + T[2] * T[2] + T[5] * T[5]
    normal = equivalent_of([T[0], T[4], T[8]])
    return ti.sqrt(normal * normal + 3.0 * shear)
