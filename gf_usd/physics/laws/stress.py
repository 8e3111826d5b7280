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
"""

import taichi as ti

from gf_usd.physics.laws.simd3x3 import (
    choose,
    difference,
    double_dot,
    inverse,
    product,
)


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

    And the energy density [J/m^3] that each lane lost; its rounding, below 0, counts as nothing.
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
                loss = ti.select(mine > 0.0, ti.max(work, 0.0), loss)
    return E, A, loss


@ti.func
def compensate(Pi: ti.template(), F, E):
    """Pi = F_p^-1 <- Pi F^-1 E in the lanes whose trial gradient F flowed to E, in place.

    Returns a number above 0 where any did.
    """
    D = difference(E, F)
    moved = double_dot(D, D)
    if moved.max() > 0.0:
        choose(Pi, moved, product(Pi, product(inverse(F), E)))
    return moved.max()
