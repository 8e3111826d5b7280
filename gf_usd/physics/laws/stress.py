"""Evaluation of constitutive laws, shared by the kernels of both solvers.

A kernel passes lane vectors: F, the values q of `registry.particle_laws` and, for a body of several
laws, the number `which` of the law in each lane. Each law is evaluated for its lanes only; in the
Total Lagrangian solver all lanes of a batch have the same law.

A law with plastic flow has an elastic gradient, F = F_e F_p [Simo 1992]: the stress is that of F_e.
Before each evaluation F_e and the internal variables a are returned to an admissible state. The
flow dissipates P(F_e) : (trial F_e - F_e), the work of the final stress. psi(trial F_e) - psi(F_e)
would overestimate it by the quadratic error of an explicit step: for a block thrown far beyond
yield the error of the energy balance is 3.5 % of the dissipation, and 0.05 % with the work
(measured).

Shock viscosity (von Neumann and Richtmyer 1950). An impact faster than the material's wave speed
causes a shock, which the grid cannot resolve: particles behind it are inverted, with any law. A
pressure that acts in compression only,

    q = c2 rho l^2 (d ln J / dt)^2,    rho = rho0 / J,  l = J h,    P -= q cof F

spreads the shock over about a cell h. It is of second order in the strain rate and in h, and so
negligible for small vibrations and slow deformation.
"""

import taichi as ti

from gf_usd.physics.laws.simd3x3 import (
    assign,
    choose,
    cofactor,
    determinant,
    difference,
    double_dot,
    inverse,
    product,
    scaled,
)

SHOCK = 1.5  # c2, the usual value in impact codes (LS-DYNA Theory Manual, bulk viscosity)
SHOCK_GRID = 2.2**2  # (h w / c)^2 of the grid's highest frequency w: `time_step.GRID_FREQUENCY`
LEAST_J = 0.01  # lower bound of J in the density


@ti.func
def lanes_of(which, number: ti.template()):
    """1 in the lanes with the law of this number, otherwise 0."""
    here = (which > number - 0.5) & (which < number + 0.5)
    return ti.select(here, which * 0.0 + 1.0, which * 0.0)


@ti.func
def clipped_matrix(A, low, high):
    """A with its singular values clipped to [low, high], and 1 if any was outside: the stretch
    clamp, of the gradient of one particle from which the stress is computed.  Where J < 0 the
    smallest singular value is negative.
    """
    U, S, V = ti.svd(A)
    outside = 0
    for a in ti.static(range(3)):
        s = ti.min(ti.max(S[a, a], low), high)
        if s != S[a, a]:
            outside = 1
        S[a, a] = s
    B = A
    if outside > 0:
        for a in ti.static(range(3)):
            for c in ti.static(range(3)):
                B[a, c] = (
                    U[a, 0] * S[0, 0] * V[c, 0]
                    + U[a, 1] * S[1, 1] * V[c, 1]
                    + U[a, 2] * S[2, 2] * V[c, 2]
                )
    return B, outside


@ti.func
def energy(laws: ti.template(), which, F, q, converged):
    """psi [J/m^3] of elastic gradients F."""
    if ti.static(not laws.several):
        return laws.first.psi(F, q, converged)
    psi = F[0] * 0.0
    for number, law in ti.static(enumerate(laws.laws)):
        mine = lanes_of(which, number)
        if mine.max() > 0.0:
            psi = ti.select(mine > 0.0, law.psi(F, q, converged), psi)
    return psi


@ti.func
def piola(laws: ti.template(), which, F, q, converged):
    """P = d psi / d F [Pa] of elastic gradients F."""
    if ti.static(not laws.several):
        return laws.first.pk1(F, q, converged)
    P = F
    for number, law in ti.static(enumerate(laws.laws)):
        mine = lanes_of(which, number)
        if mine.max() > 0.0:
            choose(P, mine, law.pk1(F, q, converged))
    return P


@ti.func
def flowed(laws: ti.template(), which, F, q, a, dt, converged):
    """The admissible elastic gradients and internal variables to which trial ones return in dt [s].

    Also the energy density [J/m^3] dissipated in each lane; for associated flow, negative values
    are rounding and set to 0.
    """
    E = F
    A = a
    loss = F[0] * 0.0
    for number, law in ti.static(enumerate(laws.laws)):
        if ti.static(law.spec.flows):
            mine = F[0] * 0.0 + 1.0
            if ti.static(laws.several):
                mine = lanes_of(which, number)
            if mine.max() > 0.0:
                G, b, work = law.flow(F, q, a, dt, converged)
                choose(E, mine, G)
                choose(A, mine, b)
                if ti.static(law.spec.associated):
                    work = ti.max(work, 0.0)
                loss = ti.select(mine > 0.0, work, loss)
    return E, A, loss


@ti.func
def hardness(laws: ti.template(), which, q, a):
    """The factor on mu and lam of each lane by hardening."""
    h = q[0] * 0.0 + 1.0
    for number, law in ti.static(enumerate(laws.laws)):
        if ti.static(law.hardens):
            if ti.static(laws.several):
                h = ti.select(lanes_of(which, number) > 0.0, law.hardness(q, a), h)
            else:
                h = law.hardness(q, a)
    return h


@ti.func
def compensate(laws: ti.template(), which, Pi: ti.template(), F, E):
    """Pi = F_p^-1 <- Pi F^-1 E in the lanes whose trial gradient F was returned to E, in place.

    Where flow preserves volume, det Pi is corrected to 1 by a Newton step: in f32 each update has
    an error of up to 1e-7, of constant sign in a steady flow, which a bulk modulus of 1e5 yield
    stresses turns into a pressure.

    Returns a positive number where any lane had flow.
    """
    D = difference(E, F)
    moved = double_dot(D, D)
    if moved.max() > 0.0:
        new = product(Pi, product(inverse(F), E))
        for number, law in ti.static(enumerate(laws.laws)):
            if ti.static(law.spec.flows and law.spec.isochoric):
                J = determinant(new, cofactor(new))
                k = (4.0 - ti.min(ti.max(J, 0.5), 2.0)) / 3.0
                if ti.static(laws.several):
                    k = ti.select(lanes_of(which, number) > 0.0, k, 1.0)
                assign(new, scaled(k, new))
        choose(Pi, moved, new)
    return moved.max()


@ti.func
def shock(F, D, scale, k, dt):
    """-q [Pa] and cof F of the shock viscosity: P += -q cof F.

    scale D : dF/dt [1/s]; k : c2 rho0 h^2 [Pa s^2]. In compression, w = dJ/dt < 0, the pressure
    slows the grid's stiffest mode by dw/dt = n w^2, n = SHOCK_GRID c2 |cof F|^2 / J. It is bounded
    such that a step at most stops the compression, dt n w^2 <= -w, so that it does not limit the
    step.
    """
    cof = cofactor(F)
    r = 1.0 / ti.max(determinant(F, cof), LEAST_J)
    w = ti.min(scale * double_dot(cof, D), 0.0)
    n = (SHOCK_GRID * SHOCK) * r * double_dot(cof, cof)
    return k * r * w * w / ti.min(n * dt * w, -1.0), cof
