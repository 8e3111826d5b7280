"""Evaluation of constitutive laws, shared by the kernels of every solver.

A kernel hands over lane vectors, wherever it keeps them: F, the values q of
`registry.particle_laws` and, of a body of several laws, `which` of them a lane has.  A law is
evaluated where a lane has it; the Total Lagrangian solver sorts its particles so that all lanes of
a batch have the same.

A law that flows has an elastic gradient of its own, F = F_e F_p [Simo 1992]: the stress is that of
F_e, and before each evaluation F_e and the internal variables a return to what is admissible.  The
flow dissipates P(F_e) : (trial F_e - F_e), the work of the stress that remains.  psi(trial F_e) -
psi(F_e) is more by the half of C dF^2 that an explicit step overshoots: with it a block thrown far
beyond yield seemed to gain 3.5 % of what it dissipated, with the work 0.05 % (measured).

Shock viscosity (von Neumann and Richtmyer 1950).  A body that lands faster than its own waves run
is compressed by a shock, which a grid cannot resolve: behind it single particles are crushed until
they turn inside out, whatever the law.  A pressure that acts in compression only,

    q = c2 rho l^2 (d ln J / dt)^2,    rho = rho0 / J,  l = J h,    P -= q cof F

spreads the shock over about a cell h.  It is of second order in the rate of strain and
in h: small vibrations and slow deformation do not feel it.
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

SHOCK = 1.5  # c2, the usual value in codes of impact (LS-DYNA Theory Manual, bulk viscosity)
SHOCK_GRID = 2.2**2  # (h w / c)^2 of the grid's highest frequency w: `time_step.GRID_FREQUENCY`
LEAST_J = 0.01  # what is flatter, or inside out, has the density of this


@ti.func
def lanes_of(which, number: ti.template()):
    """1 in the lanes whose law has this number, else 0."""
    here = (which > number - 0.5) & (which < number + 0.5)
    return ti.select(here, which * 0.0 + 1.0, which * 0.0)


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
    """The admissible elastic gradients and internal variables that trial ones return to in dt [s].

    And the energy density [J/m^3] that each lane lost; of associated flow its rounding, below 0,
    counts as nothing.
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
    """By how much mu and lam of each lane are multiplied, for what has happened to it."""
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
    """Pi = F_p^-1 <- Pi F^-1 E in the lanes whose trial gradient F flowed to E, in place.

    Where flow keeps the volume, det Pi is put back to 1 by Newton's iteration: in f32 each update
    leaves it off by up to 1e-7, of one sign along a steady flow, and a bulk modulus of 1e5 yield
    stresses makes a pressure of that.
    Returns a number above 0 where any did.
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

    scale D : dF/dt [1/s]; k : c2 rho0 h^2 [Pa s^2].  In compression, w = dJ/dt < 0, the pressure
    slows the grid's stiffest mode by dw/dt = n w^2, n = SHOCK_GRID c2 |cof F|^2 / J.  In a step it
    does no more than end the compression, dt n w^2 <= -w, so it limits no step.
    """
    cof = cofactor(F)
    r = 1.0 / ti.max(determinant(F, cof), LEAST_J)
    w = ti.min(scale * double_dot(cof, D), 0.0)
    n = (SHOCK_GRID * SHOCK) * r * double_dot(cof, cof)
    return k * r * w * w / ti.min(n * dt * w, -1.0), cof
