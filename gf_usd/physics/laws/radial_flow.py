"""Von Mises plasticity with the elastic energy of an isotropic law other than Hencky's.

tau = P F^T is the Kirchhoff stress of the law at F_e = R U = V diag(s) W^T, sigma = sqrt(3/2) |dev
tau|, and d the deviator of e = ln s. Plastic flow occurs where sigma exceeds Y(a) of `von_mises`:

    e(g) = e* - g n,  n = sqrt(3/2) d* / |d*|,   sigma(e(g)) = Y(a + g) + viscosity g / dt,   a += g

The left side is sigma* at g = 0 and zero at g = sqrt(2/3) |d*|, where e(g) is spherical, so that a
solution lies between. It is found by the secant method, starting at the return of Hencky's law,
with bisection where the secant leaves the bracket [Dahlquist and Bjorck 1974, section 6.4]. For
Hencky's law dev tau = 2 mu d, and this is the radial return of `von_mises`; for other laws flow
along d is the associated flow [Simo and Hughes 1998, box 9.1] to first order in F_e - 1. It
preserves det F_p = 1 and dissipates g tau : n, which is nonnegative wherever a greater principal
stretch has the greater stress, the Baker-Ericksen inequalities [Truesdell and Noll 1965, section
51]. Where they are violated, as for the corotated law below half of the rest length, no flow
occurs.

The stress of an isotropic law is R^T tau R = c1 U + c2 U^2 + c0 1 [Truesdell and Noll 1965, section
47]. A law defines c1 and c2 by its function `powers`; they may depend on q and J, which flow
preserves.

In most flowing particles the elastic strain is small, and no principal stretches are computed: d is
the series X of `hencky`, U = j exp(X) with j = J^(1/3), and by the Cayley-Hamilton theorem, X^3 = h
X + w 1 with h = |X|^2 / 2 and w = det X,

    dev exp(k X) = A(k) X + B(k) dev X^2,   X : dev X^2 = 3 w,   |dev X^2|^2 = 2/3 h^2

so that sigma(g), with k = 1 - g / (sqrt(2/3) |X|), is a function of three scalars. Larger strains
use principal stretches. Where a stretch is below 0.1 or F is inverted no flow occurs, until the
elastic forces have restored the particle.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import (
    LEAST_J,
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
from gf_usd.physics.laws.simd3x3 import (
    choose,
    cofactor,
    determinant,
    let,
    log,
    product,
    scaled,
    unrolled,
)
from gf_usd.physics.laws.von_mises import INSTANT, bearable, hardening

ITERATIONS = 24  # at most: superlinear convergence, or bisection in the worst case
TINY = 1e-30
MARGIN = 1.25  # of |dev exp(k X)| <= k |X| exp(k |X|) at k = 2 and the largest |X| of the series


@ti.func
def flow_along_strain(powers: ti.template(), F, q, a, dt, converged):
    """`flow` of the registry, for a law with these powers and the parameters of `von_mises`."""
    E = F
    g = a[0] * 0.0
    work = g
    c = powers(q)
    Y = bearable(q, a[0])
    D, C = gram(F)
    Z = cayley(D, C)
    if near(Z, converged):
        if (bound(c, D, Z) - Y).max() > 0.0:
            X = deviator_of_series(Z)
            half, w, j = invariants(X, D)
            size = ti.sqrt(2.0 * half)
            stress, _ = near_stress(c, [half, w, j], [size], g)
            y = ti.select(determinant(F, cofactor(F)) > LEAST_J, stress - Y, 0.0)
            if y.max() > 0.0:
                most = ti.sqrt(2.0 / 3.0) * size
                g, work = growth(near_stress, c, q, a[0], [half, w, j], [size], most, y, dt,
                                 converged)  # fmt: skip
                k = 0.0 - ti.sqrt(1.5) * g / ti.max(size, TINY)
                choose(E, g, product(F, exponential(scaled(k, X))))
    else:
        s, V = stretches(F)
        e0 = log(ti.max(s[0], J_EXTENSION))
        e1 = log(ti.max(s[1], J_EXTENSION))
        e2 = log(ti.max(s[2], J_EXTENSION))
        mean = (e0 + e1 + e2) / 3.0
        d = [e0 - mean, e1 - mean, e2 - mean]
        size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        n = scaled(ti.sqrt(1.5) / ti.max(size, TINY), d)
        stress, _ = principal_stress(c, s, n, g)
        y = ti.select(ti.min(s[0], ti.min(s[1], s[2])) > J_EXTENSION, stress - Y, 0.0)
        if y.max() > 0.0:
            most = ti.sqrt(2.0 / 3.0) * size
            g, work = growth(principal_stress, c, q, a[0], s, n, most, y, dt, converged)
            choose(E, g, product(F, spectral(shrinking(n, g), V)))
    return E, [a[0] + g], work


@ti.func
def growth(law: ti.template(), c, q, a, trial, n, most, y, dt, converged):
    """g of the module in (0, most), and the work; 0 where the excess y [Pa] or g is not positive.

    law(c, trial, n, g) : sigma(e(g)) and tau : n [Pa].
    """
    slow = q[6] / ti.max(dt, INSTANT)
    enough = ti.sqrt(
        converged * ti.sqrt(converged)
    )  # relative tolerance of the stress, above rounding
    low = y * 0.0
    high = most
    before = low
    r_before = ti.max(y, 0.0)
    g = ti.min(r_before / (3.0 * q[0] + hardening(q, a) + slow), most)  # of Hencky's law
    work = low
    steps, unsolved = 0, 1.0
    while unsolved > 0.0 and steps < ITERATIONS:
        stress, along = law(c, trial, n, g)
        work = g * along
        r = stress - bearable(q, a + g) - slow * g
        away = ti.select(y > 0.0, ti.max(r, 0.0 - r) - enough * stress - converged * y, 0.0)
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


@unrolled
def bound(c, D, Z):
    """An upper bound of sigma [Pa]: |X| <= |Z| (1 + |Z|^2), j^2 <= tr C / 3."""
    jj = let((D[0] + D[1] + D[2]) / 3.0)
    along = 2.0 * ti.max(c[1], 0.0 - c[1]) * jj + ti.max(c[0], 0.0 - c[0]) * ti.sqrt(jj)
    return ti.sqrt(1.5 * size_squared(Z)) * MARGIN * along


@unrolled
def invariants(X, D):
    """h and w of X, and j = sqrt(tr C / tr exp(2 X))."""
    a, b, c, d, e, f = X
    h = let(0.5 * size_squared(X))
    w = let(a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e))
    trace = 3.0 + 4.0 * (h + w + (h * h + h * w) / 3.0) + (2.0 * h * h * h + 3.0 * w * w) / 11.25
    return [h, w, let(ti.sqrt((D[0] + D[1] + D[2]) / trace))]


@unrolled
def exponents(k, h, w):
    """A(k) and B(k), to the sixth order in X."""
    t = let(k * k)
    A = k * (1.0 + t * (h / 6.0 + k * w / 24.0 + t * (h * h / 120.0 + k * h * w / 360.0)))
    B = t * (0.5 + t * (h / 24.0 + k * w / 120.0 + t * h * h / 720.0))
    return [let(A), let(B)]


@ti.func
def near_stress(c, trial, n, g):
    """sigma and tau : n [Pa] at U = j exp(k X); trial : h, w and j of X, n : its size."""
    h, w, j = trial[0], trial[1], trial[2]
    size = ti.max(n[0], TINY)
    k = 1.0 - ti.sqrt(1.5) * g / size
    A1, B1 = exponents(k, h, w)
    A2, B2 = exponents(2.0 * k, h, w)
    p = j * (c[0] * A1 + c[1] * j * A2)  # dev tau = p X + r dev X^2
    r = j * (c[0] * B1 + c[1] * j * B2)
    squared = 2.0 * h * p * p + 6.0 * w * p * r + (2.0 / 3.0) * h * h * r * r
    along = ti.sqrt(1.5) * (2.0 * h * p + 3.0 * w * r) / size
    return ti.sqrt(1.5 * ti.max(squared, 0.0)), along


@ti.func
def principal_stress(c, s, n, g):
    """sigma and tau : n [Pa] at the stretches s_i exp(-g n_i)."""
    k = shrinking(n, g)
    x, y, z = s[0] * k[0], s[1] * k[1], s[2] * k[2]
    tau = [x * (c[0] + c[1] * x), y * (c[0] + c[1] * y), z * (c[0] + c[1] * z)]
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
