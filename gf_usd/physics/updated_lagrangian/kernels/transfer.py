"""P2G and G2P transfers of one cell in a substep of the Updated Lagrangian solver.

P2G, with the Kirchhoff stress tau = P F^T and world gradients (GaussianFlesh section 4.4):

    m_i = sum_p w_ip m_p
    p_i = sum_p w_ip m_p (v_p + C_p (x_i - x_p)) - dt sum_p V0_p tau_p grad w_ip
        + dt sum_p (w_ip f_p + M_p grad w_ip)

f_p and M_p are the force and moment of contact on a particle (`kernels.particles`). G2P:

    v_p = sum_i w_ip v_i,   C_p = 4/h^2 sum_i w_ip v_i (x) (x_i - x_p)
    L_p = sum_i v_i (x) grad w_ip
    x_p <- x_p + dt v_p,    F_p <- (I + dt L_p) F_p

A law with plastic flow has its own elastic gradient in the particle's history. It is advanced like
F, returned to the yield surface before the stress is computed, and replaces F in the stress.

L is the velocity gradient conjugate to the internal forces, so that the work of the stress equals
the change of strain energy. Hu et al. 2018 use C instead, and forces with 4/h^2 w (x_i - x_p) in
place of grad w. A cell writes to its own block, 27 nodes x 4, so that cells do not race.

Eight particles of one cell are processed at once. The last batch of a cell repeats its last
particle: such a lane has zero mass and volume, and writes the same values as the particle's own
lane.
"""

import taichi as ti
from taichi.lang.matrix import make_matrix

from gf_usd.physics.laws import stress
from gf_usd.physics.laws.registry import GRADIENT
from gf_usd.physics.laws.simd3x3 import LANES, at, double_dot, let, product, put, unrolled
from gf_usd.physics.updated_lagrangian.kernels.particles import vector


@unrolled
def values(body, ids, laws):
    """The parameters q of eight particles' laws, and the index of each law."""
    row = rows(ids, laws.constants)
    q = [pick(body.constants, row, k) for k in range(laws.values)]
    return q, pick(body.constants, row, laws.which)


@ti.func
def current(body: ti.template(), ids: ti.template(), laws: ti.template()):
    """`values` with moduli after hardening by the particles' history."""
    q, which = values(body, ids, laws)
    if ti.static(laws.hardens):
        h = stress.hardness(laws, which, q, internals(body, ids, laws))
        q[0] = q[0] * h
        q[1] = q[1] * h
    return q, which


@unrolled
def trial(body, ids, laws):
    """The elastic gradients before the return mapping."""
    if laws.flows:
        return gradients(body.history, rows(ids, laws.history))
    return gradients(body.F, rows(ids, 9))


@unrolled
def internals(body, ids, laws):
    """The internal variables of eight particles."""
    row = rows(ids, laws.history)
    return [pick(body.history, row, GRADIENT + k) for k in range(laws.internals)]


@unrolled
def keep_flow(body, ids, laws, E, A, loss):
    """Store the result of the return mapping in the particles' history."""
    row = rows(ids, laws.history)
    for k, x in enumerate([*E, *A]):
        write(body.history, row, k, x)
    last = laws.history - 1
    write(body.history, row, last, pick(body.history, row, last) + pick(body.V0, ids, 0) * loss)


@ti.func
def admissible(
    body: ti.template(), ids: ti.template(), laws: ti.template(), dt, converged,
    acts: ti.template(),
):  # fmt: skip
    """`trial` after the return mapping. acts : store the result; otherwise the history is
    unchanged.
    """
    F = trial(body, ids, laws)
    if ti.static(not laws.flows):
        return F
    q, which = values(body, ids, laws)
    E, A, loss = stress.flowed(laws, which, F, q, internals(body, ids, laws), dt, converged)
    if ti.static(acts):
        keep_flow(body, ids, laws, E, A, loss)
    return E


@ti.func
def piola(
    body: ti.template(), ids: ti.template(), F: ti.template(), laws: ti.template(),
    damped: ti.template(), capped: ti.template(), cap, dt, converged,
):  # fmt: skip
    """P of eight particles, with the viscous part, scaled to |P| <= cap where there is a cap."""
    q, which = current(body, ids, laws)
    P = stress.piola(laws, which, F, q, converged)
    if ti.static(damped):
        D = add_viscous(body, ids, P, F)
        pressure, cof = stress.shock(F, D, 1.0, pick(body.viscosity, rows(ids, 2), 1), dt)
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


@unrolled
def add_viscous(body, ids, P, F):
    """Kelvin-Voigt: P += 2 mu tau F sym(F^T dF/dt), in place; returns dF/dt = L F."""
    L = gradients(body.L, rows(ids, 9))
    D = let(product(L, F))
    k = let(0.5 * pick(body.viscosity, rows(ids, 2), 0))
    for a in range(3):
        for c in range(3):
            s = let(k * (F[a] * D[c] + F[3 + a] * D[3 + c] + F[6 + a] * D[6 + c]))
            # s_ac occurs twice in the symmetric part: F (s + s^T)
            for r in range(3):
                put(P[3 * r + c], P[3 * r + c] + F[3 * r + a] * s)
                put(P[3 * r + a], P[3 * r + a] + F[3 * r + c] * s)
    return D


@ti.func
def scatter_cell(
    body: ti.template(), cell, laws: ti.template(), damped: ti.template(), capped: ti.template(),
    cap, contact, dt, ih, phase, converged,
):  # fmt: skip
    """P2G: mass and momentum of one cell's particles, to the cell's block."""
    corner = cell_corner(body, cell)
    for b in range(batches(body, cell)):
        ids = members(body, cell, b)
        axes = stencils(body, ids, corner, ih, phase)
        alive = not_filler(body, cell, b)
        m = live(alive, pick(body.m, ids, 0))
        volume = live(alive, pick(body.V0, ids, 0))
        F = admissible(body, ids, laws, dt, converged, True)
        P = piola(body, ids, F, laws, damped, capped, cap, dt, converged)
        moments = particle_moments(body, ids, m, (0.0 - dt * ih) * volume, ih, P, F)
        if contact > 0:
            add_contact_forces(body, ids, alive, dt, ih, moments)
        deposit(body, cell, b, m, moments, axes)


@unrolled
def particle_moments(body, ids, m, s, ih, P, F):
    """Along each axis the momentum m v, its slope m C / ih and -dt ih V0 tau, in cells: 3 x 7."""
    row, affine = rows(ids, 3), rows(ids, 9)
    r = let(m / ih)
    out = []
    for d in range(3):
        out += [m * pick(body.v, row, d)]
        out += [r * pick(body.C, affine, 3 * d + k) for k in range(3)]
        out += [s * (P[3 * d] * F[k] + P[3 * d + 1] * F[k + 1] + P[3 * d + 2] * F[k + 2])
                for k in (0, 3, 6)]  # fmt: skip
    return out


@unrolled
def add_contact_forces(body, ids, alive, dt, ih, moments):
    """Add the contact forces on the particles to the result of `particle_moments`."""
    row = rows(ids, 12)
    for d in range(3):
        o = 7 * d
        put(moments[o], moments[o] + dt * live(alive, pick(body.push, row, d)))
        for k in range(3):
            moment = live(alive, pick(body.push, row, 3 + 3 * d + k))
            put(moments[o + 4 + k], moments[o + 4 + k] + dt * ih * moment)


@unrolled
def deposit(body, cell, batch, m, moments, axes):
    """Add the sums over lanes to a cell's block; the first batch overwrites it."""
    (w0, z0, d0), (w1, z1, d1), (w2, z2, d2) = axes
    o, more = let(cell * 108), let(batch > 0)

    def add(n, x):
        x, place = let(x), at(body.block, o + n)
        put(place, lane_sum(x) + ti.select(more, place, 0.0))

    for i in range(3):
        for j in range(3):
            for k in range(3):
                add((9 * i + 3 * j + k) * 4, m * (w0[i] * w1[j] * w2[k]))
    for d in range(3):
        p, A0, A1, A2, T0, T1, T2 = moments[7 * d : 7 * d + 7]
        for i in range(3):
            a = let(w0[i] * p + z0[i] * A0 + d0[i] * T0)
            a1, t1, a2, t2 = (let(w0[i] * x) for x in (A1, T1, A2, T2))
            for j in range(3):
                e = let(w1[j] * a + z1[j] * a1 + d1[j] * t1)
                e2, f2 = let(w1[j] * a2), let(w1[j] * t2)
                for k in range(3):
                    n = (9 * i + 3 * j + k) * 4 + 1 + d
                    add(n, w2[k] * e + z2[k] * e2 + d2[k] * f2)


@unrolled
def lane_sum(x):
    """Sum of eight lanes, pairwise."""
    a = [at(x, lane) for lane in range(LANES)]
    return ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))


@ti.func
def gather_cell(body: ti.template(), cell, laws: ti.template(), drift, ih, phase):
    """G2P of one cell's particles, which advance by `drift` seconds."""
    corner = cell_corner(body, cell)
    for b in range(batches(body, cell)):
        ids = members(body, cell, b)
        axes = stencils(body, ids, corner, ih, phase)
        move(body, cell, ids, laws, drift, ih, axes)


@unrolled
def move(body, cell, ids, laws, drift, ih, axes):
    """v, C and L of eight particles from their nodes; advance x, F and the elastic gradient."""
    row, square, flowing = rows(ids, 3), rows(ids, 9), rows(ids, laws.history)
    F = gradients(body.F, square)
    E = gradients(body.history, flowing) if laws.flows else F
    ih, drift = every(ih), every(drift)
    ih4 = let(4.0 * ih)  # with distances in cells, one h of 4/h^2 cancels
    first = let(27 * cell)
    nodes = let([3 * at(body.cell_nodes, first + n) for n in range(27)])
    for d in range(3):
        v, C, L = interpolated([every(at(body.node_v, n + d)) for n in nodes], axes)
        write(body.v, row, d, v)
        for k in range(3):
            write(body.C, square, 3 * d + k, ih4 * C[k])
            put(L[k], ih * L[k])
            write(body.L, square, 3 * d + k, L[k])
        for a in range(3):
            write(body.F, square, 3 * d + a, F[3 * d + a] + drift * along(L, F, a))
            if laws.flows:
                write(body.history, flowing, 3 * d + a, E[3 * d + a] + drift * along(L, E, a))
        write(body.x, row, d, pick(body.x, row, d) + drift * v)


@unrolled
def along(L, F, a):
    """A row of L times column a of F."""
    return L[0] * F[a] + L[1] * F[3 + a] + L[2] * F[6 + a]


@unrolled
def interpolated(q, axes):
    """v, and rows of C h^2 / 4 and L in cells, from 27 nodal values q."""
    (w0, z0, d0), (w1, z1, d1), (w2, z2, d2) = axes
    sums = [[] for _ in range(7)]
    for i in range(3):
        lines = []
        for j in range(3):
            x = let(q[9 * i + 3 * j : 9 * i + 3 * j + 3])
            lines.append([let(dot(w2, x)), let(dot(z2, x)), let(dot(d2, x))])
        s, z, f = zip(*lines)
        t = let(dot(w1, s))
        terms = (w0, t), (z0, t), (w0, dot(z1, s)), (w0, dot(w1, z)), (d0, t), (w0, dot(d1, s))
        for sum_, (w, x) in zip(sums, (*terms, (w0, dot(w1, f)))):
            sum_.append(let(w[i] * x))
    v, c0, c1, c2, l0, l1, l2 = let([a + b + c for a, b, c in sums])
    return v, [c0, c1, c2], [l0, l1, l2]


@unrolled
def dot(a, b):
    """Sum of three products."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@ti.func
def batches(body: ti.template(), cell):
    """Number of batches of eight of the cell's particles."""
    return (body.cell_count[cell] + LANES - 1) // LANES


@unrolled
def members(body, cell, b):
    """The eight particles of batch b of a cell."""
    start = let(at(body.cell_start, cell))
    first = let(start + LANES * b)
    last = let(start + at(body.cell_count, cell) - 1)
    return [at(body.order, ti.min(first + lane, last)) for lane in range(LANES)]


@unrolled
def in_order(b, n):
    """The eight particles of batch b of all n, by index."""
    o, last = let(b * LANES), let(n - 1)
    return [ti.min(o + lane, last) for lane in range(LANES)]


@unrolled
def not_filler(body, cell, b):
    """Which lanes of batch b of a cell are no fillers."""
    left = let(at(body.cell_count, cell) - LANES * b)
    return lanes([0.5 + lane for lane in range(LANES)]) < every(left)


@unrolled
def live(alive, x):
    """x in the lanes that are no fillers, 0 in the others."""
    return ti.select(alive, x, 0.0)


@unrolled
def every(x):
    """The same value in each lane."""
    return lanes([let(x)] * LANES)


@unrolled
def rows(ids, stride):
    """Offsets of the rows of `stride` values of eight particles."""
    return ids if stride == 1 else let([i * stride for i in ids])


@unrolled
def pick(A, row, a):
    """Entry a of the rows of eight particles."""
    return lanes([at(A, o + a) for o in row])


@unrolled
def lanes(numbers):
    """A lane vector of these values, as a variable."""
    return let(make_matrix(numbers))  # of a ti.Vector `let` only makes another expression


@unrolled
def write(A, row, a, x):
    """Store x to entry a of the rows of eight particles."""
    x = let(x)
    for lane, o in enumerate(row):
        put(at(A, o + a), at(x, lane))


@unrolled
def gradients(A, row):
    """Nine lane vectors of eight particles' matrices."""
    return [pick(A, row, k) for k in range(9)]


@ti.func
def cell_corner(body: ti.template(), cell):
    """Indices (3,) of the cell's first node."""
    return vector(body.cell_at, 3 * cell)


@unrolled
def stencils(body, ids, corner, ih, phase):
    """Along each axis w, w times the distance to the node, and dw, of three nodes, in cells."""
    row = rows(ids, 3)
    out = []
    for d in range(3):
        f = let(pick(body.x, row, d) * ih - (at(phase, d) + at(corner, d)))
        a, b, c = let(1.5 - f), let(f - 1.0), let(f - 0.5)
        w = let([0.5 * a * a, 0.75 - b * b, 0.5 * c * c])
        z = let([(0.0 - f) * w[0], (1.0 - f) * w[1], (2.0 - f) * w[2]])
        out.append([w, z, let([0.0 - a, -2.0 * b, c])])
    return out
