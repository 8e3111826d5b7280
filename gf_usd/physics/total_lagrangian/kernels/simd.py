"""Update of eight cells in a substep: stress (eq. 2) and the APIC filter (eq. 1 and 3).

One cell per SIMD lane. A group writes to its own block, 27 nodes x 3 components per cell, so that
groups do not race. A batch holds one particle of each of the eight cells; nodal values are lane
vectors too, loaded once for all batches of the group, and a scatter is a sum within a lane.

Within a cell, the interpolant of a nodal field q is quadratic along each axis. With s = f - 1 in
[-1/2, 1/2) and h = s/2, the quadratic B-splines of the three nodes sum to

    q(s) = a + h (b + c s),   2 dq/ds = b + 2 c s
    a = q1 + c/8,   b = q2 - q0,   c = q0 - 2 q1 + q2

This takes a third fewer operations than the weights, and loses no digits where the q are nearly
equal. Forces are scattered by the transpose: moments about the cell's center, then the transposed
differences.
"""

import taichi as ti

from gf_usd.physics.laws import stress
from gf_usd.physics.laws.registry import GRADIENT
from gf_usd.physics.laws.simd3x3 import (
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
from gf_usd.physics.total_lagrangian.kernels.limits import cap_stress, clip


@ti.func
def strain(body: ti.template(), b, u: ti.template(), s: ti.template(), h: ti.template(), ih,
           options: ti.template()):  # fmt: skip
    """F = F0 + sum_i u_i (x) G_ip of one batch; F0 = I, or that of `shape_correction`; ih = 1/h."""
    F = scaled(0.5 * ih, gradient(u, s, h))
    if ti.static(options.anchored):
        add_anchor(F, body.F0, b)
    else:
        for a in ti.static(range(3)):
            F[4 * a] = F[4 * a] + 1.0
    return F


@unrolled
def add_anchor(F, F0, b):
    """F += F0 of one batch."""
    for a in range(9):
        put(F[a], F[a] + at(F0, 9 * b + a))


@unrolled
def rows(array, first, count):
    """`count` lane vectors, starting at `first`."""
    return [at(array, first + k) for k in range(count)]


@unrolled
def put_rows(array, first, values):
    """Store a list of lane vectors, starting at `first`."""
    for k, value in enumerate(values):
        put(at(array, first + k), value)


@ti.func
def elastic(
    body: ti.template(), b, F: ti.template(), q, laws: ti.template(), dt, converged,
    options: ti.template(), acts: ti.template(),
):  # fmt: skip
    """Replace F of batch b by the elastic gradient F_e, in place; returns F_p^-1.

    acts : store the plastic flow in the history; otherwise the history is unchanged.
    """
    if ti.static(not laws.flows):
        if ti.static(options.clamped):
            clip(body, b, F, acts)
        return F
    o = laws.history * b
    Pi = rows(body.history, o, GRADIENT)
    assign(F, product(F, Pi))
    if ti.static(options.clamped):
        clip(body, b, F, acts)
    a = rows(body.history, o + GRADIENT, laws.internals)
    which = body.constants[laws.constants * b + laws.which]
    E, A, loss = stress.flowed(laws, which, F, q, a, dt, converged)
    moved = stress.compensate(laws, which, Pi, F, E)
    assign(F, E)
    if ti.static(acts):  # noqa: SIM102  (known while the kernel is built; the next is not)
        if moved > 0.0:
            put_rows(body.history, o, Pi)
            put_rows(body.history, o + GRADIENT, A)
            lost = o + laws.history - 1
            body.history[lost] = body.history[lost] + body.V0[b] * loss
    return Pi


@ti.func
def stress_group(
    body: ti.template(), group, laws: ti.template(), damped: ti.template(), dt, ih, converged,
    options: ti.template(),
):  # fmt: skip
    """Nodal forces -V0 P G of the particles of eight cells, to their block."""
    u = moments(body, body.u, group)
    rate = rates(body, group, u, damped)
    out = zeros(u)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle(body, b)
        F = strain(body, b, u, s, h, ih, options)
        q = rows(body.constants, laws.constants * b, laws.values)
        Pi = elastic(body, b, F, q, laws, dt, converged, options, True)
        which = body.constants[laws.constants * b + laws.which]
        P = stress.piola(laws, which, F, q, converged)
        if ti.static(damped):
            # Kelvin-Voigt: P += 2 mu tau F sym(F^T dF/dt), objective.
            D = gradient(rate, s, h)
            if ti.static(laws.flows):
                assign(D, product(D, Pi))
            k = body.viscosity[2 * b] * (0.25 * ih)
            add_viscous(P, k, F, D)
            pressure, cof = stress.shock(F, D, 0.5 * ih, body.viscosity[2 * b + 1], dt)
            add_pressure(P, pressure, cof)
        if ti.static(options.capped):
            cap_stress(body, b, P, True)
        if ti.static(laws.flows):
            assign(P, product(P, transposed(Pi)))
        k = (0.0 - 0.5 * ih) * body.V0[b]
        spread(scaled(k, P), s, h, out)
    each_transposed(out)
    put_block(body.block, group, out)


@unrolled
def zeros(like):
    """As many lane vectors of zeros."""
    zero = let(like[0] * 0.0)
    return [zero] * len(like)


@unrolled
def add_viscous(P, k, F, D):
    """P += k F (e + e^T) with e = F^T D."""
    k = let(k)
    e = [
        let(k * (F[a] * D[c] + F[3 + a] * D[3 + c] + F[6 + a] * D[6 + c]))
        for a in range(3)
        for c in range(3)
    ]
    S = let([e[3 * a + c] + e[3 * c + a] if a < c else 2.0 * e[4 * a] for a, c in UPPER])
    for r in range(0, 9, 3):
        for c, (x, y, z) in enumerate(SYMMETRIC):
            put(P[r + c], P[r + c] + F[r] * S[x] + F[r + 1] * S[y] + F[r + 2] * S[z])


# The entries of a symmetric matrix that are stored, and where those of each of its columns are.
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
SYMMETRIC = ((0, 1, 2), (1, 3, 4), (2, 4, 5))


@unrolled
def add_pressure(P, p, cof):
    """P += p cof F."""
    for a in range(9):
        put(P[a], P[a] + p * cof[a])


@ti.func
def filter_group(body: ti.template(), group):
    """Nodal momenta m (v_p + C_p dX) of the particles of eight cells, to their block (eq. 3, then
    eq. 1).

    v_p = sum w v_i and C_p = 4/h^2 sum w v_i (x) dX; with dX in cells, h cancels.
    """
    gather(body, body.v, group)
    for d in range(3):
        q = component(body.block, group, d)
        differences(q)
        out = zeros(q)
        for b in range(body.group_batch[group], body.group_batch[group + 1]):
            s, h = middle(body, b)
            filter_batch(q, s, h, body.m[b], out)
        differences_transposed(out)
        put_component(body.block, group, d, out)


@unrolled
def filter_batch(q, s, h, m, out):
    """Add the moments of a component of m (v_p + C_p dX) to out (27).

    q : `differences` of that component of the nodal velocities; s, h : of `middle`; m : masses of
    the particles. The sums with dX are an eighth of the e of `affine`, on both sides.
    """
    x, y, z = let([(s[a], h[a], (3.0 - 4.0 * s[a] * s[a]) * s[a]) for a in range(3)])
    value, along_y, along_z = [], [], []
    for i in range(0, 27, 9):
        rows = [affine(q[j : j + 3], *z) for j in range(i, i + 9, 3)]
        v, e = affine([v for v, _ in rows], *y)
        value.append(v)
        along_y.append(e)
        along_z.append(affine([e for _, e in rows], *y)[0])
    v, e = affine(value, *x)
    k = let(4.0 / 64.0 * m)
    value = affine_transposed(m * v, k * e, *x)
    along_y = affine_transposed(k * affine(along_y, *x)[0], None, *x)
    along_z = affine_transposed(k * affine(along_z, *x)[0], None, *x)
    for i in range(3):
        values = affine_transposed(value[i], along_y[i], *y)
        slopes = affine_transposed(along_z[i], None, *y)
        for j in range(3):
            line = affine_transposed(values[j], slopes[j], *z)
            for n, one in enumerate(line, 9 * i + 3 * j):
                put(out[n], out[n] + one)


@unrolled
def affine(line, s, h, t):
    """Of the a, b, c of three nodes on a line: sum w q, which is q(s), and e = 8 sum w q dX.

    e = b + c t with t = 3 s - 4 s^3, by the moments of the B-spline's weights.
    """
    a, b, c = line
    return let(a + h * (b + c * s)), let(b + c * t)


@unrolled
def affine_transposed(v, e, s, h, t):
    """The contributions of v on q(s), and of e where there is one, to a, b and c."""
    v = let(v)
    b = let(h * v)
    if e is None:
        return [v, b, let(s * b)]
    e = let(e)
    return [v, let(b + e), let(s * b + t * e)]


@ti.func
def group_energy(
    body: ti.template(), group, out: ti.template(), laws: ti.template(), ih, converged,
    options: ti.template(),
):  # fmt: skip
    """out[8 group + lane] = sum_p V0 psi(F_p) of a cell, without the return mapping of plastic
    flow.
    """
    q = moments(body, body.u, group)
    total = q[0] * 0.0
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle(body, b)
        F = strain(body, b, q, s, h, ih, options)
        if ti.static(laws.flows):
            assign(F, product(F, rows(body.history, laws.history * b, GRADIENT)))
        if ti.static(options.clamped):
            clip(body, b, F, False)
        values = rows(body.constants, laws.constants * b, laws.values)
        which = body.constants[laws.constants * b + laws.which]
        psi = stress.energy(laws, which, F, values, converged)
        total += body.V0[b] * psi
    for lane in ti.static(range(LANES)):
        out[group * LANES + lane] = total[lane]


@ti.func
def group_von_mises(
    body: ti.template(), group, out: ti.template(), laws: ti.template(), ih, converged,
    options: ti.template(),
):  # fmt: skip
    """out[8 b + lane] = von Mises stress of each particle of eight cells."""
    u = moments(body, body.u, group)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle(body, b)
        F = strain(body, b, u, s, h, ih, options)
        q = rows(body.constants, laws.constants * b, laws.values)
        elastic(body, b, F, q, laws, 0.0 * ih, converged, options, False)
        which = body.constants[laws.constants * b + laws.which]
        P = stress.piola(laws, which, F, q, converged)
        if ti.static(options.capped):
            cap_stress(body, b, P, False)
        value = von_mises(P, F)
        for lane in ti.static(range(LANES)):
            out[b * LANES + lane] = value[lane]


# Component d of node (i, j, k) has index 27 i + 9 j + 3 k + d in a block, and 9 i + 3 j + k within
# its component. LINES has the indices of the three nodes on each line along each axis, as
# constants: index arithmetic in kernels costs time at every start.
STEPS = (9, 3, 1)
LINES = tuple(
    tuple((n, n + step, n + 2 * step) for n in range(27) if n // step % 3 == 0) for step in STEPS
)


@ti.func
def lane_sum(x):
    """The sum of eight lanes, in a fixed order."""
    return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]))


@ti.func
def middle(body: ti.template(), b):
    """s and h of batch b along the three axes."""
    s0 = body.fx[3 * b] - 1.0
    s1 = body.fx[3 * b + 1] - 1.0
    s2 = body.fx[3 * b + 2] - 1.0
    return [s0, s1, s2], [0.5 * s0, 0.5 * s1, 0.5 * s2]


@ti.func
def gather(body: ti.template(), field: ti.template(), group):
    """A nodal vector field at the 27 nodes of eight cells, to their block, node by node."""
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


@ti.func
def moments(body: ti.template(), field: ti.template(), group):
    """`differences` of a nodal vector field at the 27 nodes of eight cells, 27 x 3 lane vectors.

    A loop over components, as in `filter_group`, would make the kernel smaller, but 100,000
    particles then take 1.04 times as long.
    """
    gather(body, field, group)
    q = block(body.block, group)
    each_difference(q)
    return q


@ti.func
def rates(body: ti.template(), group, u: ti.template(), damped: ti.template()):
    """`moments` of v; u, without a use, where there is no viscosity.

    Not a conditional expression: Taichi builds both of its sides, and then the chosen one again.
    """
    if ti.static(damped):
        return moments(body, body.v, group)
    return u


@unrolled
def each_difference(q):
    """`differences` of each of the three components."""
    for d in range(3):
        differences(q[d::3])


@unrolled
def each_transposed(q):
    """`differences_transposed` of each of the three components."""
    for d in range(3):
        differences_transposed(q[d::3])


@unrolled
def component(array, group, d):
    """The 27 lane vectors of component d of a group's block."""
    o = let(81 * group + d)
    return let([at(array, o + 3 * n) for n in range(27)])


@unrolled
def put_component(array, group, d, q):
    """27 lane vectors q as component d of a group's block."""
    o = let(81 * group + d)
    for n in range(27):
        put(at(array, o + 3 * n), q[n])


@unrolled
def block(array, group):
    """The 27 x 3 lane vectors of a group's block."""
    o = let(81 * group)
    return [at(array, o + n) for n in range(81)]


@unrolled
def put_block(array, group, q):
    """Store 27 x 3 lane vectors q to a group's block."""
    o = let(81 * group)
    for n in range(81):
        put(at(array, o + n), q[n])


@unrolled
def evaluate(a, b, c, s, h):
    """q(s) and 2 dq/ds."""
    t = let(c * s)
    e = let(b + t)
    return let(a + h * e), let(e + t)


@unrolled
def differences(q):
    """Replace the 27 values q of a component by a, b, c along each axis, in place."""
    for lines in LINES:
        for i, j, k in lines:
            b = let(q[k] - q[i])
            c = let((q[k] - q[j]) - (q[j] - q[i]))
            put(q[i], q[j] + 0.125 * c)
            put(q[j], b)
            put(q[k], c)


@unrolled
def differences_transposed(q):
    """The transpose of `differences`: from moments to nodal values, in place."""
    for lines in LINES:
        for i, j, k in lines:
            a = let(q[i])
            b = let(q[j])
            c = let(q[k] + 0.125 * a)
            put(q[i], c - b)
            put(q[j], a - 2.0 * c)
            put(q[k], c + b)


@unrolled
def gradient(q, s, h):
    """2 dq/ds, nine lane vectors row by row, of the field with `differences` q."""
    out = []
    for d in range(3):
        value, along_j, along_k = [], [], []
        for i in range(3):
            o = 27 * i + d
            q0, r0 = evaluate(q[o], q[o + 3], q[o + 6], s[2], h[2])
            q1, r1 = evaluate(q[o + 9], q[o + 12], q[o + 15], s[2], h[2])
            q2, r2 = evaluate(q[o + 18], q[o + 21], q[o + 24], s[2], h[2])
            x, y = evaluate(q0, q1, q2, s[1], h[1])
            z, _ = evaluate(r0, r1, r2, s[1], h[1])
            value.append(x)
            along_j.append(y)
            along_k.append(z)
        _, x = evaluate(*value, s[0], h[0])
        y, _ = evaluate(*along_j, s[0], h[0])
        z, _ = evaluate(*along_k, s[0], h[0])
        out += [x, y, z]
    return out


@unrolled
def spread(T, s, h, q):
    """The transpose of `gradient`: add the contribution of nine lane vectors T on 2 dq/ds to q.

    x on q(s) and y on 2 dq/ds contribute x to a, h x + y to b and s (h x + 2 y) to c.
    """
    for d in range(3):
        x = let([T[3 * d], T[3 * d], 2.0 * s[0] * T[3 * d]])  # no contribution to a
        y = let([T[3 * d + 1], h[0] * T[3 * d + 1], s[0] * h[0] * T[3 * d + 1]])
        z = let([T[3 * d + 2], h[0] * T[3 * d + 2], s[0] * h[0] * T[3 * d + 2]])
        for i in range(3):
            b = let(h[1] * x[i] + y[i]) if i > 0 else y[i]
            values = [x[i], b, let(s[1] * (b + y[i]))]
            b = let(h[1] * z[i])
            slopes = [z[i], b, let(s[1] * b)]
            for j in range(3):
                o = 27 * i + 9 * j + d
                b = slopes[j]
                if i > 0 or j > 0:
                    put(q[o], q[o] + values[j])
                    b = let(b + h[2] * values[j])
                put(q[o + 3], q[o + 3] + b)
                put(q[o + 6], q[o + 6] + s[2] * (b + slopes[j]))
