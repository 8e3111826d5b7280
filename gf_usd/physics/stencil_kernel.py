"""Splines, gathers and deposits of eight cells at once, one in each lane.

A batch holds a particle of each of a group's eight cells.  So what the cells know of their nodes is
lane vectors too, fetched once for all batches of the group, a deposit is a sum in its own lane, and
sums over the 27 nodes are factorised by axis.  A group's block is 27 x 3 lane vectors: first what
is gathered, in the end what is deposited.
"""

import taichi as ti

from gf_usd.physics.lanes import LANES


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
def splines(body: ti.template(), b):
    """w and dw of batch b along the three axes."""
    w0, d0 = spline(body.fx[3 * b])
    w1, d1 = spline(body.fx[3 * b + 1])
    w2, d2 = spline(body.fx[3 * b + 2])
    return [w0, w1, w2], [d0, d1, d2]


@ti.func
def gather(body: ti.template(), field: ti.template(), group):
    """A nodal vector field at the 27 nodes of eight cells: 27 x 3 lane vectors, node by node."""
    for n in range(27 * group, 27 * group + 27):
        o = n * LANES
        i0 = body.group_nodes[o]
        i1 = body.group_nodes[o + 1]
        i2 = body.group_nodes[o + 2]
        i3 = body.group_nodes[o + 3]
        i4 = body.group_nodes[o + 4]
        i5 = body.group_nodes[o + 5]
        i6 = body.group_nodes[o + 6]
        i7 = body.group_nodes[o + 7]
        for d in ti.static(range(3)):
            body.block[3 * n + d] = ti.Vector(
                [field[i0 + d], field[i1 + d], field[i2 + d], field[i3 + d],
                 field[i4 + d], field[i5 + d], field[i6 + d], field[i7 + d]]
            )  # fmt: skip
    return block(body, group)


@ti.func
def block(body: ti.template(), group):
    """The 27 x 3 lane vectors of a group's block."""
    return [body.block[81 * group + n] for n in ti.static(range(81))]


@ti.func
def gradient(q: ti.template(), w: ti.template(), dw: ti.template()):
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
                o = ti.static(3 * (9 * i + 3 * j) + d)
                q0 = q[o]
                q1 = q[o + 3]
                q2 = q[o + 6]
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
