"""Eight particles of one cell at once: who they are, what they hold, where their nodes are.

The last batch of a cell repeats its last particle.  Such a lane has no mass and no volume, and what
it writes back to its particle is what that particle's own lane writes.
"""

import taichi as ti

from gf_usd.physics.lanes import LANES


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
def product(A, B):
    """A B of matrices in lanes."""
    c0 = A[0] * B[0] + A[1] * B[3] + A[2] * B[6]
    c1 = A[0] * B[1] + A[1] * B[4] + A[2] * B[7]
    c2 = A[0] * B[2] + A[1] * B[5] + A[2] * B[8]
    c3 = A[3] * B[0] + A[4] * B[3] + A[5] * B[6]
    c4 = A[3] * B[1] + A[4] * B[4] + A[5] * B[7]
    c5 = A[3] * B[2] + A[4] * B[5] + A[5] * B[8]
    c6 = A[6] * B[0] + A[7] * B[3] + A[8] * B[6]
    c7 = A[6] * B[1] + A[7] * B[4] + A[8] * B[7]
    c8 = A[6] * B[2] + A[7] * B[5] + A[8] * B[8]
    return [c0, c1, c2, c3, c4, c5, c6, c7, c8]


@ti.func
def cell_corner(body: ti.template(), cell):
    """The cell's first node, counted from the corner of the box: (3,) and its number."""
    ny = body.box[4] - body.box[1] + 3
    nz = body.box[5] - body.box[2] + 3
    key = body.cell_key[cell]
    return ti.Vector([key // (ny * nz), key // nz % ny, key % nz]), key


@ti.func
def stencil(body: ti.template(), ids: ti.template(), d: ti.template(), corner, ih, phase):
    """Along one axis w, w times the distance to the node and dw, of three nodes, in cells."""
    f = pick(body.x, ids, 3, d) * ih - (phase[d] + (corner[d] + body.box[d]))
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
