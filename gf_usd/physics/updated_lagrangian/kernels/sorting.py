"""Particles sorted by the cell they are in, anew in every substep of the Updated Lagrangian solver.

The grid holds the cells that particles are in and their nodes, wherever these are: a hash table
(`node_of`) leads from the indices of a node to its number, the table of a cell to its 27 nodes
(`cell_nodes`), that of a node to the cells that have it (`node_cells`).  A cell is numbered when a
particle first enters it and stays until many are empty, when all are forgotten and numbered anew.
Particles seldom change cells, so that few look into the hash table.

`grid` holds how many nodes (0), cells (1) and cells with particles (2) there are, whether a
particle of this substep has no cell yet (3), a fault (4), and how many places of the hash table are
to be cleared (5).  A fault stops everything: no cell
and no node is left to work on, and nothing is written beyond the arrays.

How cells and nodes are numbered decides no result: a node sums its cells in the order of where they
lie, and the order within a cell is that of the particles, whatever the threads do, so that sums
come out the same to the bit.
"""

import taichi as ti

FAR = 1e6  # [cells] from the origin: beyond, and where a position is no number, there is no cell
NODES, CELLS, FILLED, MISSING, FAULT, CLEARED = range(6)  # of `grid`
NOT_A_PLACE = 1  # faults
OVERFLOW = 2
FEW = 64  # empty cells beyond half of those that are not: more are forgotten


@ti.func
def begin_substep(body: ti.template(), node_capacity):
    """Forget all cells where many are empty, or where none is known yet."""
    cells, filled = body.grid[CELLS], body.grid[FILLED]
    body.grid[CLEARED] = 0
    if body.grid[FAULT] == 0 and (cells == 0 or cells > filled + filled // 2 + FEW):
        body.grid[NODES] = 0
        body.grid[CELLS] = 0
        body.grid[CLEARED] = 2 * node_capacity
    body.grid[MISSING] = 0


@ti.func
def lowest_cell(body: ti.template(), p, d: ti.template(), ih, phase):
    """Index along one axis of the first node that particle p touches."""
    return ti.cast(ti.floor(body.x[3 * p + d] * ih - phase[d] - 0.5), ti.i32)


@ti.func
def find_node(body: ti.template(), i, j, k, mask):
    """Number of the node at these indices, -1 where there is none; and its place in the table."""
    h = (i * 73856093 ^ j * 19349663 ^ k * 83492791) & mask
    n = body.node_of[h]
    o = 3 * ti.max(n, 0)
    while n >= 0 and (body.node_at[o] != i or body.node_at[o + 1] != j or body.node_at[o + 2] != k):
        h = (h + 1) & mask
        n = body.node_of[h]
        o = 3 * ti.max(n, 0)
    return n, h


@ti.func
def find_cell(body: ti.template(), i, j, k, mask):
    """Number of the cell whose first node has these indices, -1 where there is none."""
    n, _ = find_node(body, i, j, k, mask)
    cell = n
    if n >= 0:
        cell = body.node_cells[27 * n]
    return cell


@ti.func
def make_cell(body: ti.template(), i, j, k, node_capacity, cell_capacity):
    """Number a cell and its nodes; -1 where there is no room."""
    cell = body.grid[CELLS]
    if cell >= cell_capacity or body.grid[NODES] > node_capacity - 27:
        body.grid[FAULT] = OVERFLOW
        body.grid[CELLS] = 0
        body.grid[NODES] = 0
        cell = -1
    else:
        body.grid[CELLS] = cell + 1
        body.cell_at[3 * cell] = i
        body.cell_at[3 * cell + 1] = j
        body.cell_at[3 * cell + 2] = k
        body.cell_count[cell] = 0
        for s in range(27):
            a, b, c = i + s // 9, j + s // 3 % 3, k + s % 3
            n, h = find_node(body, a, b, c, 2 * node_capacity - 1)
            if n < 0:
                n = body.grid[NODES]
                body.grid[NODES] = n + 1
                body.node_of[h] = n
                body.node_at[3 * n] = a
                body.node_at[3 * n + 1] = b
                body.node_at[3 * n + 2] = c
                for t in range(27):
                    body.node_cells[27 * n + t] = -1
            body.node_cells[27 * n + s] = cell
            body.cell_nodes[27 * cell + s] = n
    return cell


@ti.func
def count_particle(
    body: ti.template(), p, ih, phase, node_capacity, cell_capacity, alone: ti.template()
):
    """Number particle p among those of its cell, in the order of arrival.

    alone : no other thread runs, so that a cell may be made; else one that lacks is noted.
    """
    if body.grid[FAULT] == 0:
        inside = 0
        for d in ti.static(range(3)):
            # Written so that a position that is no number fails too.
            if ti.abs(body.x[3 * p + d] * ih - phase[d]) < FAR:
                inside += 1
        if inside < 3:
            body.grid[FAULT] = NOT_A_PLACE
            body.grid[CELLS] = 0
            body.grid[NODES] = 0
        else:
            i = lowest_cell(body, p, 0, ih, phase)
            j = lowest_cell(body, p, 1, ih, phase)
            k = lowest_cell(body, p, 2, ih, phase)
            cell = body.key[p]
            known = 0
            if cell >= 0 and cell < body.grid[CELLS]:
                o = 3 * cell
                known = ti.cast(
                    body.cell_at[o] == i and body.cell_at[o + 1] == j and body.cell_at[o + 2] == k,
                    ti.i32,
                )
            if known == 0:
                cell = find_cell(body, i, j, k, 2 * node_capacity - 1)
                if ti.static(alone):  # noqa: SIM102  (one is of the compiler)
                    if cell < 0:
                        cell = make_cell(body, i, j, k, node_capacity, cell_capacity)
                body.key[p] = cell
            if cell < 0:
                body.grid[MISSING] = 1
            elif ti.static(alone):
                body.rank[p] = body.cell_count[cell]
                body.cell_count[cell] += 1
            else:
                body.rank[p] = ti.atomic_add(body.cell_count[cell], 1)


@ti.func
def number_particles(body: ti.template()):
    """Where each cell's particles begin, by the counts.  One thread does it."""
    filled = 0
    total = 0
    for cell in range(body.grid[CELLS]):
        count = body.cell_count[cell]
        body.cell_start[cell] = total
        total += count
        filled += ti.min(count, 1)
    body.cell_start[body.grid[CELLS]] = total
    body.grid[FILLED] = filled


@ti.func
def place_particle(body: ti.template(), p):
    """Put particle p into the list of its cell."""
    if body.grid[FAULT] == 0:
        body.order[body.cell_start[body.key[p]] + body.rank[p]] = p


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
