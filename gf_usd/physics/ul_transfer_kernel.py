"""What one cell does in a substep of the Updated Lagrangian solver: to the grid, and back.

To the grid, with the Kirchhoff stress tau = P F^T and world gradients (GaussianFlesh section 4.4):

    m_i = sum_p w_ip m_p
    p_i = sum_p w_ip m_p (v_p + C_p (x_i - x_p)) - dt sum_p V0_p tau_p grad w_ip
        + dt sum_p (w_ip f_p + M_p grad w_ip)

f_p and M_p are what the floor does to a particle and about it (`ul_particle_kernel`).  Back:

    v_p = sum_i w_ip v_i,   C_p = 4/h^2 sum_i w_ip v_i (x) (x_i - x_p)
    L_p = sum_i v_i (x) grad w_ip
    x_p <- x_p + dt v_p,    F_p <- (I + dt L_p) F_p

L is the gradient that the stress is the adjoint of, so that what the stress takes from the motion
is what the strain gains; C stands in for it in Hu et al. 2018, where the force has 4/h^2 w (x_i -
x_p) in place of grad w.  A cell writes to a block of its own, 27 nodes x 4, so cells never race.
"""

import taichi as ti

from gf_usd.physics.lanes import double_dot
from gf_usd.physics.stencil_kernel import lane_sum
from gf_usd.physics.ul_lanes_kernel import (
    batches,
    cell_corner,
    live,
    matrix,
    members,
    pick,
    product,
    put,
    stencil,
)


@ti.func
def piola(
    body: ti.template(), ids: ti.template(), F: ti.template(), law: ti.template(),
    damped: ti.template(), capped: ti.template(), cap, converged,
):  # fmt: skip
    """P of eight particles, with the viscous part, cut to |P| <= cap where that is asked for."""
    P = law.pk1(F, pick(body.mu, ids, 1, 0), pick(body.lam, ids, 1, 0), converged)
    if ti.static(damped):
        # Kelvin-Voigt: P += 2 mu tau F sym(F^T dF/dt), dF/dt = L F.
        L = matrix(body.L, ids)
        D = product(L, F)
        k = pick(body.viscosity, ids, 1, 0)
        for a in ti.static(range(3)):
            for c in ti.static(range(3)):
                s = 0.5 * k * (F[a] * D[c] + F[3 + a] * D[3 + c] + F[6 + a] * D[6 + c])
                # s_ac enters sym twice: F (s + s^T).
                for r in ti.static(range(3)):
                    P[3 * r + c] = P[3 * r + c] + F[3 * r + a] * s
                    P[3 * r + a] = P[3 * r + a] + F[3 * r + c] * s
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
    body: ti.template(), cell, law: ti.template(), damped: ti.template(), capped: ti.template(),
    cap, contact, dt, ih, phase, converged,
):  # fmt: skip
    """Mass and momentum of one cell's particles into the cell's block."""
    corner, _key = cell_corner(body, cell)
    for b in range(batches(body, cell)):
        i0, i1, i2, i3, i4, i5, i6, i7 = members(body, cell, b)
        ids = [i0, i1, i2, i3, i4, i5, i6, i7]
        w0, z0, d0 = stencil(body, ids, 0, corner, ih, phase)
        w1, z1, d1 = stencil(body, ids, 1, corner, ih, phase)
        w2, z2, d2 = stencil(body, ids, 2, corner, ih, phase)
        m = live(body, cell, b, pick(body.m, ids, 1, 0))
        volume = live(body, cell, b, pick(body.V0, ids, 1, 0))
        F = matrix(body.F, ids)
        P = piola(body, ids, F, law, damped, capped, cap, converged)
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
def gather_cell(body: ti.template(), cell, drift, ih, phase):
    """Motion of the nodes back to one cell's particles, which move by `drift` seconds."""
    corner, key = cell_corner(body, cell)
    ny = body.box[4] - body.box[1] + 3
    nz = body.box[5] - body.box[2] + 3
    for b in range(batches(body, cell)):
        i0, i1, i2, i3, i4, i5, i6, i7 = members(body, cell, b)
        ids = [i0, i1, i2, i3, i4, i5, i6, i7]
        w0, z0, d0 = stencil(body, ids, 0, corner, ih, phase)
        w1, z1, d1 = stencil(body, ids, 1, corner, ih, phase)
        w2, z2, d2 = stencil(body, ids, 2, corner, ih, phase)
        F = matrix(body.F, ids)
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
                    o = (key + (i * ny + j) * nz) * 3 + d
                    q0 = body.node_v[o]
                    q1 = body.node_v[o + 3]
                    q2 = body.node_v[o + 6]
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
            put(body.x, ids, 3, d, x + drift * v)
