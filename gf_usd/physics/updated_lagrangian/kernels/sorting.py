"""Sorting of the particles by cell, in every substep of the Updated Lagrangian solver.

The grid is sparse: only cells that contain particles, and their nodes, exist. A hash table
(`node_of`) maps the indices of a node to its number; tables map a cell to its 27 nodes
(`cell_nodes`) and a node to its cells (`node_cells`). A cell is numbered when a particle first
enters it and kept until too many cells are empty; then all are discarded and numbered again.
Particles seldom change cells, so that few hash lookups occur.

`grid` contains the number of nodes (0), of cells (1) and of cells with particles (2), a flag that a
particle has no cell yet (3), a fault code (4), the number of hash entries to be cleared (5), and
the number of particles in the cells that have a range of the list (6).
After a fault there are no cells and nodes, so that nothing is computed and no array is exceeded.

The numbering of cells and nodes does not affect the result: a node sums over its cells in the order
of their positions, and the particles of a cell are sorted by index, so that the sums are
bit-identical for any number of threads.
"""

import taichi as ti

FAR = 1e6  # [cells] distance from the origin at which a position is a fault, as is one not finite
NODES, CELLS, FILLED, MISSING, FAULT, CLEARED, PLACED = range(7)  # of `grid`
NOT_A_PLACE = 1  # faults
OVERFLOW = 2
FEW = 64  # empty cells allowed in addition to half the number of the others


@ti.func
def begin_substep(body: ti.template(), node_capacity):
    """Discard all cells where too many are empty; also for the first substep."""
    cells, filled = body.grid[CELLS], body.grid[FILLED]
    body.grid[CLEARED] = 0
    if body.grid[FAULT] == 0 and (cells == 0 or cells > filled + filled // 2 + FEW):
        body.grid[NODES] = 0
        body.grid[CELLS] = 0
        body.grid[CLEARED] = 2 * node_capacity
    body.grid[MISSING] = 0


@ti.func
def lowest_cell(body: ti.template(), p, d: ti.template(), ih, phase):
    """Index along one axis of the first node in the support of particle p."""
    return ti.cast(ti.floor(body.x[3 * p + d] * ih - phase[d] - 0.5), ti.i32)


@ti.func
def find_node(body: ti.template(), i, j, k, mask):
    """Number of the node with these indices, -1 where there is none; and its position in the hash
    table.
    """
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
    """Number a cell and its nodes; -1 where the arrays are full."""
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
    """Count particle p in its cell, in the order of arrival.

    alone : there is one thread only, which may create the cell; otherwise a missing cell sets a
    flag.
    """
    if body.grid[FAULT] == 0:
        inside = 0
        for d in ti.static(range(3)):
            # The comparison is also false for a position that is not finite.
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
    """Start of each cell's range of particles, from the counts. Runs on one thread."""
    filled = 0
    total = 0
    for cell in range(body.grid[CELLS]):
        count = body.cell_count[cell]
        body.cell_start[cell] = total
        total += count
        filled += ti.min(count, 1)
    body.grid[FILLED] = filled


@ti.func
def begin_ranges(body: ti.template()):
    """Before `claim_range` of every cell."""
    body.grid[FILLED] = 0
    body.grid[PLACED] = 0


@ti.func
def claim_range(body: ti.template(), cell):
    """Start of a cell's range of particles, for many threads: the ranges of cells are in arbitrary
    order, on which the result does not depend.
    """
    count = body.cell_count[cell]
    if count > 0:
        body.cell_start[cell] = ti.atomic_add(body.grid[PLACED], count)
        ti.atomic_add(body.grid[FILLED], 1)


@ti.func
def place_particle(body: ti.template(), p):
    """Store particle p in the list of its cell."""
    if body.grid[FAULT] == 0:
        body.order[body.cell_start[body.key[p]] + body.rank[p]] = p


@ti.func
def sort_cell(body: ti.template(), cell):
    """Insertion sort of a cell's list, which threads have filled in arbitrary order."""
    first = body.cell_start[cell]
    for at in range(first + 1, first + body.cell_count[cell]):
        p = body.order[at]
        to = at
        while to > first and body.order[ti.max(to - 1, first)] > p:
            body.order[to] = body.order[to - 1]
            to -= 1
        body.order[to] = p
