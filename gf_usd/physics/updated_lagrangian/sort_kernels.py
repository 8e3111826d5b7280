"""Particles sorted by the cell they are in, anew in every substep of the Updated Lagrangian solver.

The grid is a dense box of nodes, fitted to the body: `box` holds its lowest cell (0..2), its
highest (3..5), its nodes (6), its cells that hold particles (7) and a fault (8).  A fault stops
everything: no cell and no node is left to work on, and nothing is written beyond the arrays.

The order within a cell is that of the particles, whatever the threads do, so that sums come out
the same to the bit.
"""

import taichi as ti

FAR = 1e6  # [cells] from the origin: beyond, and where a position is no number, there is no cell
NOT_A_PLACE = 1  # faults
OVERFLOW = 2


@ti.func
def clear_box(body: ti.template()):
    """An empty box."""
    for d in ti.static(range(3)):
        body.box[d] = 1 << 30
        body.box[3 + d] = -(1 << 30)


@ti.func
def lowest_cell(body: ti.template(), p, d: ti.template(), ih, phase):
    """Index along one axis of the first node that particle p touches."""
    return ti.cast(ti.floor(body.x[3 * p + d] * ih - phase[d] - 0.5), ti.i32)


@ti.func
def widen_box(body: ti.template(), p, ih, phase):
    """Take particle p's cell into the box."""
    for d in ti.static(range(3)):
        # Written so that a position that is no number fails too.
        if ti.abs(body.x[3 * p + d] * ih - phase[d]) < FAR:
            b = lowest_cell(body, p, d, ih, phase)
            if b < body.box[d]:
                ti.atomic_min(body.box[d], b)
            if b > body.box[3 + d]:
                ti.atomic_max(body.box[3 + d], b)
        else:
            body.box[8] = NOT_A_PLACE


@ti.func
def extent(body: ti.template(), d: ti.template()):
    """Nodes of the box along an axis: two more than cells."""
    return body.box[3 + d] - body.box[d] + 3


@ti.func
def close_box(body: ti.template(), capacity):
    """Count the nodes of the box, or find that there are more than `capacity`."""
    nodes = ti.cast(0, ti.i64)
    if body.box[8] == 0:
        nodes = ti.cast(extent(body, 0), ti.i64) * extent(body, 1) * extent(body, 2)
        if nodes > capacity:
            body.box[8] = OVERFLOW
            nodes = 0
    body.box[6] = ti.cast(nodes, ti.i32)
    body.box[7] = 0


@ti.func
def count_particle(body: ti.template(), p, ih, phase):
    """Number particle p among those of its cell, in the order of arrival."""
    if body.box[8] == 0:
        i = lowest_cell(body, p, 0, ih, phase) - body.box[0]
        j = lowest_cell(body, p, 1, ih, phase) - body.box[1]
        k = lowest_cell(body, p, 2, ih, phase) - body.box[2]
        key = (i * extent(body, 1) + j) * extent(body, 2) + k
        body.key[p] = key
        body.rank[p] = ti.atomic_add(body.slot[key], 1)


@ti.func
def number_cells(body: ti.template(), capacity):
    """Turn the counts in `slot` into numbers of the cells that hold particles, -1 for the others.

    One thread does it: the box has about as many nodes as the body has quarters of a particle.
    """
    cells = 0
    total = 0
    for key in range(body.box[6]):
        count = body.slot[key]
        body.slot[key] = -1
        if count > 0:
            if cells < capacity:
                body.slot[key] = cells
                body.cell_key[cells] = key
                body.cell_start[cells] = total
            cells += 1
            total += count
    if cells > capacity:
        body.box[8] = OVERFLOW
        body.box[6] = 0
        cells = 0
    body.cell_start[cells] = total
    body.box[7] = cells


@ti.func
def place_particle(body: ti.template(), p):
    """Put particle p into the list of its cell."""
    if body.box[8] == 0:
        body.order[body.cell_start[body.slot[body.key[p]]] + body.rank[p]] = p


@ti.func
def sort_cell(body: ti.template(), cell):
    """Insertion sort of a cell's list, which threads have filled in any order."""
    first = body.cell_start[cell]
    for at in range(first + 1, body.cell_start[cell + 1]):
        p = body.order[at]
        to = at
        while to > first and body.order[ti.max(to - 1, first)] > p:
            body.order[to] = body.order[to - 1]
            to -= 1
        body.order[to] = p
