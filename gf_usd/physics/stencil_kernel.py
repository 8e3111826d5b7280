"""Splines, gathers and deposits of one cell's particles, eight at a time.

A cell's particles share its 27 nodes, so a node's value is loaded once for eight of them, and sums
over the 27 are factorised by axis.
"""

import taichi as ti

from gf_usd.physics.lanes import LANES


@ti.func
def load(A: ti.template(), o):
    return ti.Vector([A[o], A[o + 1], A[o + 2], A[o + 3], A[o + 4], A[o + 5], A[o + 6], A[o + 7]])


@ti.func
def lane_sum(x):
    return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]))


@ti.func
def spline(f):
    """w and dw (per cell) of the three nodes along one axis; f in [0.5, 1.5)."""
    a = 1.5 - f
    b = f - 1.0
    c = f - 0.5
    return [0.5 * a * a, 0.75 - b * b, 0.5 * c * c], [f - 1.5, -2.0 * b, c]


@ti.func
def gradient(body: ti.template(), field: ti.template(), cell, w: ti.template(), dw: ti.template()):
    """sum_i q_i (x) dw_i, per cell spacing, of a nodal vector field q: nine lane vectors."""
    zero = w[0][0] * 0.0
    out = [zero, zero, zero, zero, zero, zero, zero, zero, zero]
    for d in ti.static(range(3)):
        g0 = zero
        g1 = zero
        g2 = zero
        for i in ti.static(range(3)):
            t = zero
            tj = zero
            tk = zero
            for j in ti.static(range(3)):
                o = cell * 27 + 9 * i + 3 * j
                q0 = field[body.cell_nodes[o] * 3 + d]
                q1 = field[body.cell_nodes[o + 1] * 3 + d]
                q2 = field[body.cell_nodes[o + 2] * 3 + d]
                s = w[2][0] * q0 + w[2][1] * q1 + w[2][2] * q2
                sk = dw[2][0] * q0 + dw[2][1] * q1 + dw[2][2] * q2
                t += w[1][j] * s
                tj += dw[1][j] * s
                tk += w[1][j] * sk
            g0 += dw[0][i] * t
            g1 += w[0][i] * tj
            g2 += w[0][i] * tk
        out[3 * d] = g0
        out[3 * d + 1] = g1
        out[3 * d + 2] = g2
    return out


@ti.func
def deposit(body: ti.template(), o, x, first):
    """Add the sum of the lanes to a cell's own block (cleared by its first batch)."""
    s = lane_sum(x)
    if first == 0:
        s += body.block[o]
    body.block[o] = s


@ti.func
def strain(
    body: ti.template(), cell, b, w: ti.template(), dw: ti.template(), ih, options: ti.template()
):
    """F = F0 + sum_i u_i (x) G_ip of one batch; F0 = I, or what `reanchor` left; ih = 1/h."""
    F = gradient(body, body.u, cell, w, dw)
    for a in ti.static(range(9)):
        F[a] = F[a] * ih
    if ti.static(options.anchored):
        for a in ti.static(range(9)):
            F[a] = F[a] + load(body.F0, (9 * b + a) * LANES)
    else:
        for a in ti.static(range(3)):
            F[4 * a] = F[4 * a] + 1.0
    return F


@ti.func
def deformation(body: ti.template(), cell, b, ih, options: ti.template()):
    """F of one batch, as `strain`."""
    w0, d0 = spline(load(body.fx, b * 24))
    w1, d1 = spline(load(body.fx, b * 24 + 8))
    w2, d2 = spline(load(body.fx, b * 24 + 16))
    return strain(body, cell, b, [w0, w1, w2], [d0, d1, d2], ih, options)
