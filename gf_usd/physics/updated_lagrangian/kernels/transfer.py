"""Transfers of one cell in a substep of the Updated Lagrangian solver: P2G and G2P.

To the grid, with the Kirchhoff stress tau = P F^T and world gradients (GaussianFlesh section 4.4):

    m_i = sum_p w_ip m_p
    p_i = sum_p w_ip m_p (v_p + C_p (x_i - x_p)) - dt sum_p V0_p tau_p grad w_ip
        + dt sum_p (w_ip f_p + M_p grad w_ip)

f_p and M_p are what the floor does to a particle and about it (`kernels.particles`).  Back:

    v_p = sum_i w_ip v_i,   C_p = 4/h^2 sum_i w_ip v_i (x) (x_i - x_p)
    L_p = sum_i v_i (x) grad w_ip
    x_p <- x_p + dt v_p,    F_p <- (I + dt L_p) F_p

A law that flows has an elastic gradient of its own, in the particle's history: it moves as F does,
is returned to what is admissible before the stress is taken of it, and stands in for F wherever
stress is meant.

L is the gradient that the stress is the adjoint of, so that what the stress takes from the motion
is what the strain gains; C stands in for it in Hu et al. 2018, where the force has 4/h^2 w (x_i -
x_p) instead of grad w.  A cell writes to a block of its own, 27 nodes x 4, so cells never race.

Eight particles of one cell at once: who they are, what they hold, where their nodes are.

The last batch of a cell repeats its last particle.  Such a lane has no mass and no volume, and what
it writes back to its particle is what that particle's own lane writes.
"""

import taichi as ti

from gf_usd.physics.laws import stress
from gf_usd.physics.laws.registry import GRADIENT
from gf_usd.physics.laws.simd3x3 import LANES, double_dot, product
from gf_usd.physics.total_lagrangian.kernels.simd import lane_sum
from gf_usd.physics.updated_lagrangian.kernels.particles import vector


@ti.func
def values(body: ti.template(), ids: ti.template(), laws: ti.template()):
    """The values q of eight particles' laws, and which law each has."""
    q = [pick(body.constants, ids, laws.constants, k) for k in ti.static(range(laws.values))]
    return q, pick(body.constants, ids, laws.constants, laws.which)


@ti.func
def current(body: ti.template(), ids: ti.template(), laws: ti.template()):
    """`values` with the moduli as what has happened to the particles has made them."""
    q, which = values(body, ids, laws)
    if ti.static(laws.hardens):
        a = [
            pick(body.history, ids, laws.history, GRADIENT + k)
            for k in ti.static(range(laws.internals))
        ]
        h = stress.hardness(laws, which, q, a)
        q[0] = q[0] * h
        q[1] = q[1] * h
    return q, which


@ti.func
def trial(body: ti.template(), ids: ti.template(), laws: ti.template()):
    """The gradients that the stress is taken of, before what is due to flow has flowed."""
    if ti.static(laws.flows):
        return [pick(body.history, ids, laws.history, k) for k in ti.static(range(GRADIENT))]
    return matrix(body.F, ids)


@ti.func
def admissible(
    body: ti.template(), ids: ti.template(), laws: ti.template(), dt, converged,
    acts: ti.template(),
):  # fmt: skip
    """`trial` after it has flowed.  acts : what flows stays; else it is looked at only."""
    F = trial(body, ids, laws)
    if ti.static(not laws.flows):
        return F
    q, which = values(body, ids, laws)
    a = [
        pick(body.history, ids, laws.history, GRADIENT + k)
        for k in ti.static(range(laws.internals))
    ]
    E, A, loss = stress.flowed(laws, which, F, q, a, dt, converged)
    if ti.static(acts):
        for k in ti.static(range(GRADIENT)):
            put(body.history, ids, laws.history, k, E[k])
        for k in ti.static(range(laws.internals)):
            put(body.history, ids, laws.history, GRADIENT + k, A[k])
        last = laws.history - 1
        lost = pick(body.history, ids, laws.history, last) + pick(body.V0, ids, 1, 0) * loss
        put(body.history, ids, laws.history, last, lost)
    return E


@ti.func
def piola(
    body: ti.template(), ids: ti.template(), F: ti.template(), laws: ti.template(),
    damped: ti.template(), capped: ti.template(), cap, dt, converged,
):  # fmt: skip
    """P of eight particles, with the viscous part, cut to |P| <= cap where that is asked for."""
    q, which = current(body, ids, laws)
    P = stress.piola(laws, which, F, q, converged)
    if ti.static(damped):
        # Kelvin-Voigt: P += 2 mu tau F sym(F^T dF/dt), dF/dt = L F.
        L = matrix(body.L, ids)
        D = product(L, F)
        k = pick(body.viscosity, ids, 2, 0)
        for a in ti.static(range(3)):
            for c in ti.static(range(3)):
                s = 0.5 * k * (F[a] * D[c] + F[3 + a] * D[3 + c] + F[6 + a] * D[6 + c])
                # s_ac enters sym twice: F (s + s^T).
                for r in ti.static(range(3)):
                    P[3 * r + c] = P[3 * r + c] + F[3 * r + a] * s
                    P[3 * r + a] = P[3 * r + a] + F[3 * r + c] * s
        pressure, cof = stress.shock(F, D, 1.0, pick(body.viscosity, ids, 2, 1), dt)
        for a in ti.static(range(9)):
            P[a] = P[a] + pressure * cof[a]
    if ti.static(capped):
        size = ti.sqrt(double_dot(P, P))
        cut = ti.min(cap / ti.max(size, 1e-30), 1.0)
        for a in ti.static(range(9)):
            P[a] = P[a] * cut
        for lane in ti.static(range(8)):
            if size[lane] > cap:
                body.stress_capped[ids[lane]] = 1
    return P


@ti.func
def scatter_cell(
    body: ti.template(), cell, laws: ti.template(), damped: ti.template(), capped: ti.template(),
    cap, contact, dt, ih, phase, converged,
):  # fmt: skip
    """Mass and momentum of one cell's particles into the cell's block."""
    corner = cell_corner(body, cell)
    for b in range(batches(body, cell)):
        i0, i1, i2, i3, i4, i5, i6, i7 = members(body, cell, b)
        ids = [i0, i1, i2, i3, i4, i5, i6, i7]
        w0, z0, d0 = stencil(body, ids, 0, corner, ih, phase)
        w1, z1, d1 = stencil(body, ids, 1, corner, ih, phase)
        w2, z2, d2 = stencil(body, ids, 2, corner, ih, phase)
        m = live(body, cell, b, pick(body.m, ids, 1, 0))
        volume = live(body, cell, b, pick(body.V0, ids, 1, 0))
        F = admissible(body, ids, laws, dt, converged, True)
        P = piola(body, ids, F, laws, damped, capped, cap, dt, converged)
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                for k in ti.static(range(3)):
                    o = cell * 108 + (9 * i + 3 * j + k) * 4
                    deposit(body, o, m * (w0[i] * w1[j] * w2[k]), b)
        s = (0.0 - dt * ih) * volume
        r = m / ih
        for d in ti.static(range(3)):
            p = m * pick(body.v, ids, 3, d)
            A0 = r * pick(body.C, ids, 9, 3 * d)
            A1 = r * pick(body.C, ids, 9, 3 * d + 1)
            A2 = r * pick(body.C, ids, 9, 3 * d + 2)
            T0 = s * (P[3 * d] * F[0] + P[3 * d + 1] * F[1] + P[3 * d + 2] * F[2])
            T1 = s * (P[3 * d] * F[3] + P[3 * d + 1] * F[4] + P[3 * d + 2] * F[5])
            T2 = s * (P[3 * d] * F[6] + P[3 * d + 1] * F[7] + P[3 * d + 2] * F[8])
            if contact > 0:
                p += dt * live(body, cell, b, pick(body.push, ids, 12, d))
                T0 += dt * ih * live(body, cell, b, pick(body.push, ids, 12, 3 + 3 * d))
                T1 += dt * ih * live(body, cell, b, pick(body.push, ids, 12, 4 + 3 * d))
                T2 += dt * ih * live(body, cell, b, pick(body.push, ids, 12, 5 + 3 * d))
            for i in ti.static(range(3)):
                a = w0[i] * p + z0[i] * A0 + d0[i] * T0
                a1 = w0[i] * A1
                t1 = w0[i] * T1
                a2 = w0[i] * A2
                t2 = w0[i] * T2
                for j in ti.static(range(3)):
                    e = w1[j] * a + z1[j] * a1 + d1[j] * t1
                    e2 = w1[j] * a2
                    f2 = w1[j] * t2
                    for k in ti.static(range(3)):
                        o = cell * 108 + (9 * i + 3 * j + k) * 4 + 1 + d
                        deposit(body, o, w2[k] * e + z2[k] * e2 + d2[k] * f2, b)


@ti.func
def deposit(body: ti.template(), o, x, batch):
    """Add the sum of the lanes to a cell's own block (cleared by its first batch)."""
    s = lane_sum(x)
    if batch > 0:
        s += body.block[o]
    body.block[o] = s


@ti.func
def gather_cell(body: ti.template(), cell, laws: ti.template(), drift, ih, phase):
    """Motion of the nodes back to one cell's particles, which move by `drift` seconds."""
    corner = cell_corner(body, cell)
    for b in range(batches(body, cell)):
        i0, i1, i2, i3, i4, i5, i6, i7 = members(body, cell, b)
        ids = [i0, i1, i2, i3, i4, i5, i6, i7]
        w0, z0, d0 = stencil(body, ids, 0, corner, ih, phase)
        w1, z1, d1 = stencil(body, ids, 1, corner, ih, phase)
        w2, z2, d2 = stencil(body, ids, 2, corner, ih, phase)
        F = matrix(body.F, ids)
        E = trial(body, ids, laws)
        zero = F[0] * 0.0
        for d in ti.static(range(3)):
            v = zero
            c0 = zero
            c1 = zero
            c2 = zero
            l0 = zero
            l1 = zero
            l2 = zero
            for i in ti.static(range(3)):
                t = zero
                tz1 = zero
                td1 = zero
                tz2 = zero
                td2 = zero
                for j in ti.static(range(3)):
                    o = 27 * cell + 9 * i + 3 * j
                    q0 = body.node_v[3 * body.cell_nodes[o] + d]
                    q1 = body.node_v[3 * body.cell_nodes[o + 1] + d]
                    q2 = body.node_v[3 * body.cell_nodes[o + 2] + d]
                    s = w2[0] * q0 + w2[1] * q1 + w2[2] * q2
                    t += w1[j] * s
                    tz1 += z1[j] * s
                    td1 += d1[j] * s
                    tz2 += w1[j] * (z2[0] * q0 + z2[1] * q1 + z2[2] * q2)
                    td2 += w1[j] * (d2[0] * q0 + d2[1] * q1 + d2[2] * q2)
                v += w0[i] * t
                c0 += z0[i] * t
                c1 += w0[i] * tz1
                c2 += w0[i] * tz2
                l0 += d0[i] * t
                l1 += w0[i] * td1
                l2 += w0[i] * td2
            x = pick(body.x, ids, 3, d)
            put(body.v, ids, 3, d, v)
            # With distances in cells one h of 4/h^2 cancels.
            put(body.C, ids, 9, 3 * d, 4.0 * ih * c0)
            put(body.C, ids, 9, 3 * d + 1, 4.0 * ih * c1)
            put(body.C, ids, 9, 3 * d + 2, 4.0 * ih * c2)
            l0 = ih * l0
            l1 = ih * l1
            l2 = ih * l2
            put(body.L, ids, 9, 3 * d, l0)
            put(body.L, ids, 9, 3 * d + 1, l1)
            put(body.L, ids, 9, 3 * d + 2, l2)
            for a in ti.static(range(3)):
                f = F[3 * d + a] + drift * (l0 * F[a] + l1 * F[3 + a] + l2 * F[6 + a])
                put(body.F, ids, 9, 3 * d + a, f)
                if ti.static(laws.flows):
                    e = E[3 * d + a] + drift * (l0 * E[a] + l1 * E[3 + a] + l2 * E[6 + a])
                    put(body.history, ids, laws.history, 3 * d + a, e)
            put(body.x, ids, 3, d, x + drift * v)


@ti.func
def batches(body: ti.template(), cell):
    """How many batches of eight the cell's particles make."""
    return (body.cell_start[cell + 1] - body.cell_start[cell] + LANES - 1) // LANES


@ti.func
def members(body: ti.template(), cell, b):
    """The eight particles of batch b of a cell."""
    first = body.cell_start[cell] + LANES * b
    last = body.cell_start[cell + 1] - 1
    i0 = body.order[first]
    i1 = body.order[ti.min(first + 1, last)]
    i2 = body.order[ti.min(first + 2, last)]
    i3 = body.order[ti.min(first + 3, last)]
    i4 = body.order[ti.min(first + 4, last)]
    i5 = body.order[ti.min(first + 5, last)]
    i6 = body.order[ti.min(first + 6, last)]
    i7 = body.order[ti.min(first + 7, last)]
    return i0, i1, i2, i3, i4, i5, i6, i7


@ti.func
def in_order(b, n):
    """The eight particles of batch b of all n, as they are numbered."""
    o = b * LANES
    last = n - 1
    return [
        o, ti.min(o + 1, last), ti.min(o + 2, last), ti.min(o + 3, last), ti.min(o + 4, last),
        ti.min(o + 5, last), ti.min(o + 6, last), ti.min(o + 7, last),
    ]  # fmt: skip


@ti.func
def live(body: ti.template(), cell, b, x):
    """x in the lanes that are no repetition, 0 in the others."""
    left = x[0] * 0.0 + (body.cell_start[cell + 1] - body.cell_start[cell] - LANES * b)
    lane = ti.Vector([0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5])
    return ti.select(lane < left, x, x * 0.0)


@ti.func
def pick(A: ti.template(), ids: ti.template(), stride: ti.template(), a: ti.template()):
    """Entry a of rows of `stride` of eight particles."""
    return ti.Vector(
        [
            A[ids[0] * stride + a], A[ids[1] * stride + a], A[ids[2] * stride + a],
            A[ids[3] * stride + a], A[ids[4] * stride + a], A[ids[5] * stride + a],
            A[ids[6] * stride + a], A[ids[7] * stride + a],
        ]
    )  # fmt: skip


@ti.func
def put(A: ti.template(), ids: ti.template(), stride: ti.template(), a: ti.template(), x):
    """Write entry a of rows of `stride` of eight particles."""
    for lane in ti.static(range(LANES)):
        A[ids[lane] * stride + a] = x[lane]


@ti.func
def matrix(A: ti.template(), ids: ti.template()):
    """Nine lane vectors of eight particles' matrices."""
    a0 = pick(A, ids, 9, 0)
    a1 = pick(A, ids, 9, 1)
    a2 = pick(A, ids, 9, 2)
    a3 = pick(A, ids, 9, 3)
    a4 = pick(A, ids, 9, 4)
    a5 = pick(A, ids, 9, 5)
    a6 = pick(A, ids, 9, 6)
    a7 = pick(A, ids, 9, 7)
    a8 = pick(A, ids, 9, 8)
    return [a0, a1, a2, a3, a4, a5, a6, a7, a8]


@ti.func
def cell_corner(body: ti.template(), cell):
    """Indices (3,) of the cell's first node."""
    return vector(body.cell_at, 3 * cell)


@ti.func
def stencil(body: ti.template(), ids: ti.template(), d: ti.template(), corner, ih, phase):
    """Along one axis w, w times the distance to the node and dw, of three nodes, in cells."""
    f = pick(body.x, ids, 3, d) * ih - (phase[d] + corner[d])
    a = 1.5 - f
    b = f - 1.0
    c = f - 0.5
    w0 = 0.5 * a * a
    w1 = 0.75 - b * b
    w2 = 0.5 * c * c
    z0 = (0.0 - f) * w0
    z1 = (1.0 - f) * w1
    z2 = (2.0 - f) * w2
    d0 = 0.0 - a
    d1 = (0.0 - 2.0) * b
    return [w0, w1, w2], [z0, z1, z2], [d0, d1, c]
