"""Update of one cell in a substep by one thread: for GPUs.

Arrays and arithmetic are those of eight cells at once (`kernels.simd`): cell z is lane z % 8 of
group z // 8, and a value of a particle is a vector of that one lane. Neighboring threads therefore
read adjacent numbers, no atomics are used, and each cell has the same sums as on the CPU, in the
same order.
"""

import taichi as ti

from gf_usd.physics.laws import stress
from gf_usd.physics.laws.registry import GRADIENT
from gf_usd.physics.laws.simd3x3 import (
    LANE_BITS,
    LANES,
    assign,
    at,
    let,
    product,
    put,
    scaled,
    transposed,
    unrolled,
    von_mises,
)
from gf_usd.physics.total_lagrangian.kernels.scalar import cap_matrix, clip_matrix, listed, matrix
from gf_usd.physics.total_lagrangian.kernels.simd import (
    add_pressure,
    add_viscous,
    each_difference,
    each_transposed,
    filter_batch,
    gradient,
    spread,
    zeros,
)


@unrolled
def each_filtered(q, s, h, m, out):
    """`filter_batch` of each of three components."""
    for d in range(3):
        filter_batch(q[d::3], s, h, m, out[d::3])


@unrolled
def lane_rows(array, first, lane, count):
    """`count` numbers of a lane from vector `first` on, each a vector of one lane."""
    return let([ti.Vector([at(at(array, first + k), lane)]) for k in range(count)])


@unrolled
def put_lane_rows(array, first, lane, values):
    """A list of vectors of one lane from vector `first` on."""
    for k, value in enumerate(values):
        put(at(at(array, first + k), lane), at(value, 0))


@unrolled
def nodal(array, nodes, first):
    """A nodal vector field at the 27 nodes of a cell: 27 x 3 vectors of one lane, node by node.

    first : index of the first node of the cell; the nodes of the cells of a group are interleaved.
    """
    out = []
    for n in range(27):
        o = let(at(nodes, first + LANES * n))
        out += [ti.Vector([at(array, o + d)]) for d in range(3)]
    return let(out)


@ti.func
def gather_cell(body: ti.template(), field: ti.template(), group, lane):
    """A nodal vector field at the nodes of a cell; see `nodal`."""
    return nodal(field, body.group_nodes, 27 * LANES * group + lane)


@ti.func
def middle_cell(body: ti.template(), b, lane):
    """s and h of the particle in a lane of batch b: see `simd.middle`."""
    f = lane_rows(body.fx, 3 * b, lane, 3)
    s0, s1, s2 = f[0] - 1.0, f[1] - 1.0, f[2] - 1.0
    return [s0, s1, s2], [0.5 * s0, 0.5 * s1, 0.5 * s2]


@ti.func
def strain_cell(
    body: ti.template(), b, lane, u: ti.template(), s: ti.template(), h: ti.template(), ih,
    options: ti.template(),
):  # fmt: skip
    """F = F0 + sum_i u_i (x) G_ip of a particle."""
    F = scaled(0.5 * ih, gradient(u, s, h))
    if ti.static(options.anchored):
        F0 = lane_rows(body.F0, 9 * b, lane, 9)
        for a in ti.static(range(9)):
            F[a] = F[a] + F0[a]
    else:
        for a in ti.static(range(3)):
            F[4 * a] = F[4 * a] + 1.0
    return F


@ti.func
def clip_cell(body: ti.template(), b, lane, F: ti.template()):
    """Clip the singular values of F, in place."""
    assign(F, listed(clip_matrix(body, LANES * b + lane, matrix(F))))


@ti.func
def elastic_cell(
    body: ti.template(), b, lane, F: ti.template(), q, laws: ti.template(), dt, converged,
    options: ti.template(), acts: ti.template(),
):  # fmt: skip
    """Replace F by the elastic gradient F_e, in place; returns F_p^-1: see `simd.elastic`."""
    if ti.static(not laws.flows):
        if ti.static(options.clamped):
            clip_cell(body, b, lane, F)
        return F
    o = laws.history * b
    Pi = lane_rows(body.history, o, lane, GRADIENT)
    assign(F, product(F, Pi))
    if ti.static(options.clamped):
        clip_cell(body, b, lane, F)
    a = lane_rows(body.history, o + GRADIENT, lane, laws.internals)
    which = law_of(body, b, lane, laws)
    E, A, loss = stress.flowed(laws, which, F, q, a, dt, converged)
    moved = stress.compensate(laws, which, Pi, F, E)
    assign(F, E)
    if ti.static(acts):  # noqa: SIM102  (known while the kernel is built; the next is not)
        if moved > 0.0:
            put_lane_rows(body.history, o, lane, Pi)
            put_lane_rows(body.history, o + GRADIENT, lane, A)
            lost = o + laws.history - 1
            body.history[lost][lane] = body.history[lost][lane] + body.V0[b][lane] * loss[0]
    return Pi


@ti.func
def law_of(body: ti.template(), b, lane, laws: ti.template()):
    """Index of the particle's law, in one lane."""
    return ti.Vector([body.constants[laws.constants * b + laws.which][lane]])


@ti.func
def stress_cell(
    body: ti.template(), z, laws: ti.template(), damped: ti.template(), dt, ih, converged,
    options: ti.template(),
):  # fmt: skip
    """Nodal forces -V0 P G of the particles of cell z, to the cell's part of the block; see
    `simd.stress_group`.
    """
    group, lane = z >> LANE_BITS, z & (LANES - 1)
    u = gather_cell(body, body.u, group, lane)
    each_difference(u)
    rate = rates_of_cell(body, group, lane, u, damped)
    out = zeros(u)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle_cell(body, b, lane)
        F = strain_cell(body, b, lane, u, s, h, ih, options)
        q = lane_rows(body.constants, laws.constants * b, lane, laws.values)
        Pi = elastic_cell(body, b, lane, F, q, laws, dt, converged, options, True)
        P = stress.piola(laws, law_of(body, b, lane, laws), F, q, converged)
        if ti.static(damped):
            D = gradient(rate, s, h)
            if ti.static(laws.flows):
                assign(D, product(D, Pi))
            viscosity = lane_rows(body.viscosity, 2 * b, lane, 2)
            add_viscous(P, viscosity[0] * (0.25 * ih), F, D)
            pressure, cof = stress.shock(F, D, 0.5 * ih, viscosity[1], dt)
            add_pressure(P, pressure, cof)
        if ti.static(options.capped):
            assign(P, listed(cap_matrix(body, LANES * b + lane, matrix(P))))
        if ti.static(laws.flows):
            assign(P, product(P, transposed(Pi)))
        k = (0.0 - 0.5 * ih) * ti.Vector([body.V0[b][lane]])
        spread(scaled(k, P), s, h, out)
    each_transposed(out)
    put_lane_rows(body.block, 81 * group, lane, out)


@ti.func
def rates_of_cell(body: ti.template(), group, lane, u: ti.template(), damped: ti.template()):
    """See `simd.rates`."""
    if ti.static(damped):
        rate = gather_cell(body, body.v, group, lane)
        each_difference(rate)
        return rate
    return u


@ti.func
def filter_cell(body: ti.template(), z):
    """Nodal momenta m (v_p + C_p dX) of the particles of cell z, to the cell's part of the block
    (eq. 3, then eq. 1).
    """
    group, lane = z >> LANE_BITS, z & (LANES - 1)
    q = gather_cell(body, body.v, group, lane)
    each_difference(q)
    out = zeros(q)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle_cell(body, b, lane)
        each_filtered(q, s, h, ti.Vector([body.m[b][lane]]), out)
    each_transposed(out)
    put_lane_rows(body.block, 81 * group, lane, out)


@ti.func
def cell_energy(body: ti.template(), z, laws: ti.template(), ih, converged, options: ti.template()):
    """sum_p V0 psi(F_p) of cell z, without the return mapping of plastic flow."""
    group, lane = z >> LANE_BITS, z & (LANES - 1)
    u = gather_cell(body, body.u, group, lane)
    each_difference(u)
    total = u[0] * 0.0
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle_cell(body, b, lane)
        F = strain_cell(body, b, lane, u, s, h, ih, options)
        if ti.static(laws.flows):
            assign(F, product(F, lane_rows(body.history, laws.history * b, lane, GRADIENT)))
        if ti.static(options.clamped):
            clip_cell(body, b, lane, F)
        q = lane_rows(body.constants, laws.constants * b, lane, laws.values)
        psi = stress.energy(laws, law_of(body, b, lane, laws), F, q, converged)
        total += ti.Vector([body.V0[b][lane]]) * psi
    return total[0]


@ti.func
def cell_von_mises(
    body: ti.template(), z, out: ti.template(), laws: ti.template(), ih, converged,
    options: ti.template(),
):  # fmt: skip
    """out[8 b + lane] = von Mises stress of each particle of cell z."""
    group, lane = z >> LANE_BITS, z & (LANES - 1)
    u = gather_cell(body, body.u, group, lane)
    each_difference(u)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle_cell(body, b, lane)
        F = strain_cell(body, b, lane, u, s, h, ih, options)
        q = lane_rows(body.constants, laws.constants * b, lane, laws.values)
        elastic_cell(body, b, lane, F, q, laws, 0.0 * ih, converged, options, False)
        P = stress.piola(laws, law_of(body, b, lane, laws), F, q, converged)
        if ti.static(options.capped):
            assign(P, listed(cap_matrix(body, LANES * b + lane, matrix(P))))
        out[b * LANES + lane] = von_mises(P, F)[0]
