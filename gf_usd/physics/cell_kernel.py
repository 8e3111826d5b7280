"""What one cell does in a substep: stress (eq. 2) and the APIC filter (eq. 1 and 3).

A cell writes to a block of its own, 27 nodes x 3, so cells never race.
"""

import taichi as ti

from gf_usd.physics.lanes import LANES
from gf_usd.physics.option_kernel import clip, cut
from gf_usd.physics.stencil_kernel import deposit, gradient, load, spline, strain


@ti.func
def stress_cell(
    body: ti.template(), cell, law: ti.template(), damped: ti.template(), ih, converged,
    options: ti.template(),
):  # fmt: skip
    """-V0 P G of one cell's particles into the cell's block."""
    for b in range(body.cell_batch[cell], body.cell_batch[cell + 1]):
        first = ti.cast(b == body.cell_batch[cell], ti.i32)
        w0, d0 = spline(load(body.fx, b * 24))
        w1, d1 = spline(load(body.fx, b * 24 + 8))
        w2, d2 = spline(load(body.fx, b * 24 + 16))
        w = [w0, w1, w2]
        dw = [d0, d1, d2]
        F = strain(body, cell, b, w, dw, ih, options)
        if ti.static(options.clamped):
            clip(body, b, F, True)
        V0 = load(body.V0, b * LANES)
        P = law.pk1(F, load(body.mu, b * LANES), load(body.lam, b * LANES), converged)
        if ti.static(damped):
            # Kelvin-Voigt: P += 2 mu tau F sym(F^T dF/dt), objective.
            D = gradient(body, body.v, cell, w, dw)
            k = load(body.viscosity, b * LANES) * ih
            for a in ti.static(range(3)):
                for c in ti.static(range(3)):
                    s = 0.5 * k * (F[a] * D[c] + F[3 + a] * D[3 + c] + F[6 + a] * D[6 + c])
                    # s_ac enters sym twice: F (s + s^T).
                    for r in ti.static(range(3)):
                        P[3 * r + c] = P[3 * r + c] + F[3 * r + a] * s
                        P[3 * r + a] = P[3 * r + a] + F[3 * r + c] * s
        if ti.static(options.capped):
            cut(body, b, P, True)
        k = (0.0 - ih) * V0
        for d in ti.static(range(3)):
            T0 = k * P[3 * d]
            T1 = k * P[3 * d + 1]
            T2 = k * P[3 * d + 2]
            for i in ti.static(range(3)):
                a = dw[0][i] * T0
                bb = w[0][i] * T1
                c = w[0][i] * T2
                for j in ti.static(range(3)):
                    e = w[1][j] * a + dw[1][j] * bb
                    f = w[1][j] * c
                    for m in ti.static(range(3)):
                        deposit(
                            body,
                            cell * 81 + (9 * i + 3 * j + m) * 3 + d,
                            w[2][m] * e + dw[2][m] * f,
                            first,
                        )


@ti.func
def filter_cell(body: ti.template(), cell):
    """m (v_p + C_p dX) of one cell's particles into the cell's block: eq. 3 then eq. 1.

    v_p = sum w v_i and C_p = 4/h^2 sum w v_i (x) dX; with dX in cells the h cancels.
    """
    for b in range(body.cell_batch[cell], body.cell_batch[cell + 1]):
        first = ti.cast(b == body.cell_batch[cell], ti.i32)
        f0 = load(body.fx, b * 24)
        f1 = load(body.fx, b * 24 + 8)
        f2 = load(body.fx, b * 24 + 16)
        w0, _0 = spline(f0)
        w1, _1 = spline(f1)
        w2, _2 = spline(f2)
        m = load(body.m, b * LANES)
        zero = m * 0.0
        for d in ti.static(range(3)):
            v = zero
            c0 = zero
            c1 = zero
            c2 = zero
            for i in ti.static(range(3)):
                t = zero
                tj = zero
                tk = zero
                for j in ti.static(range(3)):
                    o = cell * 27 + 9 * i + 3 * j
                    q0 = w2[0] * body.v[body.cell_nodes[o] * 3 + d]
                    q1 = w2[1] * body.v[body.cell_nodes[o + 1] * 3 + d]
                    q2 = w2[2] * body.v[body.cell_nodes[o + 2] * 3 + d]
                    s = w1[j] * (q0 + q1 + q2)
                    t += s
                    tj += (float(j) - f1) * s
                    tk += w1[j] * ((1.0 - f2) * q1 + (2.0 - f2) * q2 - f2 * q0)
                v += w0[i] * t
                c0 += w0[i] * (float(i) - f0) * t
                c1 += w0[i] * tj
                c2 += w0[i] * tk
            for i in ti.static(range(3)):
                a = m * w0[i] * (v + 4.0 * (float(i) - f0) * c0)
                e = 4.0 * m * w0[i]
                for j in ti.static(range(3)):
                    p = w1[j] * (a + e * (float(j) - f1) * c1)
                    q = w1[j] * e * c2
                    for k in ti.static(range(3)):
                        deposit(
                            body,
                            cell * 81 + (9 * i + 3 * j + k) * 3 + d,
                            w2[k] * (p + (float(k) - f2) * q),
                            first,
                        )
