"""Von Mises flow over the elastic energy of any isotropic law.

tau = P F^T is the Kirchhoff stress of the law at F_e = U diag(s) V^T, sigma = sqrt(3/2) |dev tau|,
and d the deviator of e = ln s.  The material flows where sigma exceeds Y(a) of `von_mises`:

    e(g) = e* - g sqrt(3/2) d* / |d*|,   sigma(e(g)) = Y(a + g) + viscosity g / dt,   a += g

The left side is sigma* at g = 0 and vanishes at g = sqrt(2/3) |d*|, where e(g) is spherical: there
is a solution between, which regula falsi with Illinois' weights finds [Dowell and Jarratt 1971].
Only the law's stress at diagonal gradients is asked for.  Hencky's law has dev tau = 2 mu d, and
this is the radial return of `von_mises`; of other laws the flow along d is the associated one
[Simo and Hughes 1998, box 9.1] to the first order in F_e - 1.  It keeps det F_p = 1, and dissipates
g sqrt(3/2) tau : d* / |d*|, which is no less than 0 wherever a greater stretch has the greater
stress, the inequalities of Baker and Ericksen [Truesdell and Noll 1965, section 51].

Where a stretch is below 0.1 or F is inverted nothing flows: the law pushes it back first.
"""

import taichi as ti

from gf_usd.physics.laws.hencky import exp, spectral, stretches
from gf_usd.physics.laws.neo_hookean import J_EXTENSION
from gf_usd.physics.laws.simd3x3 import choose, log, product
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
        s, V = stretches(F)
        e0 = log(ti.max(s[0], J_EXTENSION))
        e1 = log(ti.max(s[1], J_EXTENSION))
        e2 = log(ti.max(s[2], J_EXTENSION))
        mean = (e0 + e1 + e2) / 3.0
        d = [e0 - mean, e1 - mean, e2 - mean]
        size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        r = ti.sqrt(1.5) / ti.max(size, TINY)
        n = [r * d[0], r * d[1], r * d[2]]
        y = ti.select(ti.min(s[0], ti.min(s[1], s[2])) > J_EXTENSION, y, 0.0)
        if y.max() > 0.0:
            most = ti.sqrt(2.0 / 3.0) * size
            g, work = growth(pk1, q, a[0], s, n, most, y, dt, converged)
            k = 0.0 - g
            choose(E, y, product(F, spectral([exp(k * n[0]), exp(k * n[1]), exp(k * n[2])], V)))
    return E, [a[0] + g], work


@ti.func
def growth(pk1: ti.template(), q, a, s, n, most, y, dt, converged):
    """g of the module in (0, most), 0 where the excess y [Pa] is not above 0, and the work."""
    slow = q[6] / ti.max(dt, INSTANT)
    near = ti.sqrt(converged * ti.sqrt(converged))  # of the stress: some digits above rounding
    low = y * 0.0
    high = most
    at_low = ti.max(y, 0.0)
    at_high = 0.0 - bearable(q, a + most) - slow * most
    last = low  # the end that moved last: 1 the lower, -1 the upper
    g = ti.min(at_low / (3.0 * q[0] + hardening(q, a) + slow), most)  # of Hencky's law
    work = low
    steps, unsolved = 0, 1.0
    while unsolved > 0.0 and steps < ITERATIONS:
        tau = principal(pk1, s, n, g, q, converged)
        work = g * (tau[0] * n[0] + tau[1] * n[1] + tau[2] * n[2])
        stress = equivalent_of(tau)
        r = stress - bearable(q, a + g) - slow * g
        away = ti.select(y > 0.0, ti.max(r, 0.0 - r) - near * stress, 0.0)
        unsolved = away.max()
        up = r > 0.0
        at_high = ti.select(up & (last > 0.0), 0.5 * at_high, at_high)  # Illinois
        at_low = ti.select((r <= 0.0) & (last < 0.0), 0.5 * at_low, at_low)
        last = ti.select(up, 1.0 + low * 0.0, -1.0 + low * 0.0)
        low = ti.select(up, g, low)
        high = ti.select(up, high, g)
        at_low = ti.select(up, r, at_low)
        at_high = ti.select(up, at_high, r)
        step = (low * at_high - high * at_low) / ti.min(at_high - at_low, -TINY)
        g = ti.select(away > 0.0, ti.min(ti.max(step, low), high), g)
        steps += 1
    return g, work


@ti.func
def principal(pk1: ti.template(), s, n, g, q, converged):
    """tau_i = s_i dpsi/ds_i [Pa] at stretches s_i exp(-g n_i)."""
    k = 0.0 - g
    x = s[0] * exp(k * n[0])
    y = s[1] * exp(k * n[1])
    z = s[2] * exp(k * n[2])
    o = x * 0.0
    P = pk1([x, o, o, o, y, o, o, o, z], q, converged)
    return [P[0] * x, P[4] * y, P[8] * z]


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
