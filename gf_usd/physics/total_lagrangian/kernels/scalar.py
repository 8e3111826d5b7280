"""Reference implementation of the substep: one thread per particle, then one per node.

    F_p = I + sum_i u_i (x) G_ip,   T_p = V0_p P(F_p)           one thread per particle
    f_i = -sum_p T_p G_ip                                        one thread per node

The tests compare `kernels.simd` and `kernels.cell` with it. The thread of a node loops over the
particles of its cells in a fixed order, without atomics, so that the result does not depend on the
number of threads.

In the array `block`, component d of a node n is in lane n % 8 of vector 3 (n // 8) + d. The values
of the particles follow: nine of T, or twelve of m v_p and 4 m C_p. The laws are those of the fast
kernels, called with vectors of one lane.
"""

import taichi as ti

from gf_usd.physics.laws import stress
from gf_usd.physics.laws.registry import GRADIENT
from gf_usd.physics.laws.simd3x3 import LANE_BITS, LANES, von_mises
from gf_usd.physics.total_lagrangian.kernels.limits import flag_particle
from gf_usd.physics.total_lagrangian.limits import CAP, CLAMPED, HIGH, LOW, STRESS_CAPPED


@ti.func
def number(field: ti.template(), first, per, p, a):
    """Value a of the `per` values of particle or node p, in a field of lane vectors from `first`
    on.
    """
    return field[first + per * (p >> LANE_BITS) + a][p & (LANES - 1)]


@ti.func
def set_number(field: ti.template(), first, per, p, a, value):
    """Set value a of particle or node p: see `number`."""
    field[first + per * (p >> LANE_BITS) + a][p & (LANES - 1)] = value


@ti.func
def behind(nodes):
    """Index in the block at which the values of the particles begin."""
    return 3 * ((nodes + LANES - 1) >> LANE_BITS)


@ti.func
def splines(body: ti.template(), p):
    """Distances f from the base node, weights w and slopes dw per cell: [axis, node]."""
    f = ti.Vector([number(body.fx, 0, 3, p, a) for a in ti.static(range(3))])
    w = ti.Matrix.zero(float, 3, 3)
    dw = ti.Matrix.zero(float, 3, 3)
    for a in ti.static(range(3)):
        w[a, 0] = 0.5 * (1.5 - f[a]) * (1.5 - f[a])
        w[a, 1] = 0.75 - (f[a] - 1.0) * (f[a] - 1.0)
        w[a, 2] = 0.5 * (f[a] - 0.5) * (f[a] - 0.5)
        dw[a, 0] = f[a] - 1.5
        dw[a, 1] = 2.0 - 2.0 * f[a]
        dw[a, 2] = f[a] - 0.5
    return f, w, dw


@ti.func
def slope(w, dw, i, j, k):
    """h G_ip of node (i, j, k)."""
    return ti.Vector([dw[0, i] * w[1, j] * w[2, k], w[0, i] * dw[1, j] * w[2, k],
                      w[0, i] * w[1, j] * dw[2, k]])  # fmt: skip


@ti.func
def node_vector(body: ti.template(), field: ti.template(), p, n):
    """A nodal vector at node n of the 27 of a particle's cell."""
    o = body.group_nodes[body.group_nodes[p] + n]
    return ti.Vector([field[o], field[o + 1], field[o + 2]])


@ti.func
def field_gradient(body: ti.template(), field: ti.template(), p, ih):
    """sum_i q_i (x) G_ip of a nodal vector field."""
    _, w, dw = splines(body, p)
    D = ti.Matrix.zero(float, 3, 3)
    for n in range(27):
        q = node_vector(body, field, p, n)
        D += q.outer_product(slope(w, dw, n // 9, n // 3 % 3, n % 3))
    return ih * D


@ti.func
def particle_strain(body: ti.template(), p, ih, options: ti.template()):
    """F = F0 + sum_i u_i (x) G_ip."""
    F = field_gradient(body, body.u, p, ih)
    for a in ti.static(range(3)):
        if ti.static(options.anchored):
            for c in ti.static(range(3)):
                F[a, c] += number(body.F0, 0, 9, p, 3 * a + c)
        else:
            F[a, a] += 1.0
    return F


@ti.func
def listed(F):
    """A matrix as the laws take it: nine vectors of one lane."""
    return [ti.Vector([F[a, c]]) for a in ti.static(range(3)) for c in ti.static(range(3))]


@ti.func
def matrix(A):
    """Nine vectors of one lane as a matrix."""
    return ti.Matrix([[A[3 * a + c][0] for c in ti.static(range(3))] for a in ti.static(range(3))])


@ti.func
def lane(field: ti.template(), per: ti.template(), p, first: ti.template(), count: ti.template()):
    """`count` of the `per` values of particle p, from `first` on, each a vector of one lane."""
    return [ti.Vector([number(field, 0, per, p, first + k)]) for k in ti.static(range(count))]


@ti.func
def constants(body: ti.template(), p, laws: ti.template()):
    """The parameters q of the particle's law and its index, each a vector of one lane."""
    q = lane(body.constants, laws.constants, p, 0, laws.values)
    return q, ti.Vector([number(body.constants, 0, laws.constants, p, laws.which)])


@ti.func
def clip_matrix(body: ti.template(), p, F):
    """F with its singular values clipped."""
    clipped, outside = stress.clipped_matrix(F, body.numbers[LOW], body.numbers[HIGH])
    if outside > 0:
        flag_particle(body, p, CLAMPED)
    return clipped


@ti.func
def elastic(
    body: ti.template(), p, F, laws: ti.template(), dt, converged, options: ti.template(),
    acts: ti.template(),
):  # fmt: skip
    """The elastic gradient F_e, from which the stress is computed, and F_p^-1.

    acts : store the plastic flow in the history; otherwise the history is unchanged.
    """
    if ti.static(not laws.flows):
        E = F
        if ti.static(options.clamped):
            E = clip_matrix(body, p, F)
        return E, E
    Pi = lane(body.history, laws.history, p, 0, GRADIENT)
    trial = F @ matrix(Pi)
    if ti.static(options.clamped):
        trial = clip_matrix(body, p, trial)
    a = lane(body.history, laws.history, p, GRADIENT, laws.internals)
    q, which = constants(body, p, laws)
    E, A, loss = stress.flowed(laws, which, listed(trial), q, a, dt, converged)
    stress.compensate(laws, which, Pi, listed(trial), E)
    if ti.static(acts):
        last = laws.history - 1
        lost = number(body.history, 0, laws.history, p, last)
        lost += number(body.V0, 0, 1, p, 0) * loss[0]
        set_number(body.history, 0, laws.history, p, last, lost)
        for k in ti.static(range(GRADIENT)):
            set_number(body.history, 0, laws.history, p, k, Pi[k][0])
        for k in ti.static(range(laws.internals)):
            set_number(body.history, 0, laws.history, p, GRADIENT + k, A[k][0])
    return matrix(E), matrix(Pi)


@ti.func
def particle_pk1(body: ti.template(), p, F, laws: ti.template(), converged):
    """P(F) as a matrix."""
    q, which = constants(body, p, laws)
    return matrix(stress.piola(laws, which, listed(F), q, converged))


@ti.func
def cap_matrix(body: ti.template(), p, P):
    """P scaled down to |P| <= numbers[CAP]."""
    size = ti.sqrt((P * P).sum())
    cap = body.numbers[CAP]
    if size > cap:
        flag_particle(body, p, STRESS_CAPPED)
    return ti.min(cap / ti.max(size, 1e-30), 1.0) * P


@ti.func
def particle_stress(
    body: ti.template(), p, nodes, laws: ti.template(), damped: ti.template(), dt, ih, converged,
    options: ti.template(),
):  # fmt: skip
    """T_p = V0 P(F_p), with 2 mu tau F sym(F^T dF/dt) of Kelvin-Voigt damping and the shock
    viscosity.
    """
    F, Pi = elastic(
        body, p, particle_strain(body, p, ih, options), laws, dt, converged, options, True
    )
    P = particle_pk1(body, p, F, laws, converged)
    if ti.static(damped):
        D = field_gradient(body, body.v, p, ih)
        if ti.static(laws.flows):
            D = D @ Pi
        E = F.transpose() @ D
        P += (0.5 * number(body.viscosity, 0, 2, p, 0)) * (F @ (E + E.transpose()))
        k = ti.Vector([number(body.viscosity, 0, 2, p, 1)])
        pressure, cof = stress.shock(listed(F), listed(D), 1.0, k, dt)
        P += pressure[0] * matrix(cof)
    if ti.static(options.capped):
        P = cap_matrix(body, p, P)
    if ti.static(laws.flows):
        P = P @ Pi.transpose()
    V0 = number(body.V0, 0, 1, p, 0)
    for a in ti.static(range(3)):
        for c in ti.static(range(3)):
            set_number(body.block, behind(nodes), 9, p, 3 * a + c, V0 * P[a, c])


@ti.func
def node_force(body: ti.template(), node, nodes, ih):
    """f_i = -sum_p T_p G_ip."""
    f = ti.Vector.zero(float, 3)
    for e in range(body.node_slot_start[node], body.node_slot_start[node + 1]):
        cell = body.node_slot[e] // 27
        n = body.node_slot[e] % 27
        for p in range(body.group_batch[cell], body.group_batch[cell + 1]):
            _, w, dw = splines(body, p)
            g = slope(w, dw, n // 9, n // 3 % 3, n % 3)
            for a in ti.static(range(3)):
                for c in ti.static(range(3)):
                    f[a] -= number(body.block, behind(nodes), 9, p, 3 * a + c) * g[c]
    for a in ti.static(range(3)):
        set_number(body.block, 0, 3, node, a, ih * f[a])


@ti.func
def particle_velocity(body: ti.template(), p, nodes):
    """m v_p and 4 m C_p (eq. 3), lengths in cells: the h of C and of dX cancel."""
    f, w, _ = splines(body, p)
    v = ti.Vector.zero(float, 3)
    C = ti.Matrix.zero(float, 3, 3)
    for n in range(27):
        i, j, k = n // 9, n // 3 % 3, n % 3
        q = (w[0, i] * w[1, j] * w[2, k]) * node_vector(body, body.v, p, n)
        v += q
        C += q.outer_product(ti.Vector([float(i) - f[0], float(j) - f[1], float(k) - f[2]]))
    m = number(body.m, 0, 1, p, 0)
    for a in ti.static(range(3)):
        set_number(body.block, behind(nodes), 12, p, a, m * v[a])
        for c in ti.static(range(3)):
            set_number(body.block, behind(nodes), 12, p, 3 + 3 * a + c, 4.0 * m * C[a, c])


@ti.func
def node_momentum(body: ti.template(), node, nodes):
    """sum_p w_ip m (v_p + C_p (X_i - X_p)) (eq. 1)."""
    s = ti.Vector.zero(float, 3)
    for e in range(body.node_slot_start[node], body.node_slot_start[node + 1]):
        cell = body.node_slot[e] // 27
        n = body.node_slot[e] % 27
        i, j, k = n // 9, n // 3 % 3, n % 3
        for p in range(body.group_batch[cell], body.group_batch[cell + 1]):
            f, w, _ = splines(body, p)
            d = ti.Vector([float(i) - f[0], float(j) - f[1], float(k) - f[2]])
            for a in ti.static(range(3)):
                t = number(body.block, behind(nodes), 12, p, a)
                for c in ti.static(range(3)):
                    t += number(body.block, behind(nodes), 12, p, 3 + 3 * a + c) * d[c]
                s[a] += w[0, i] * w[1, j] * w[2, k] * t
    for a in ti.static(range(3)):
        set_number(body.block, 0, 3, node, a, s[a])


@ti.func
def particle_energy(
    body: ti.template(), p, laws: ti.template(), ih, converged, options: ti.template()
):
    """V0 psi(F), without the return mapping of plastic flow."""
    F = particle_strain(body, p, ih, options)
    if ti.static(laws.flows):
        F = F @ matrix(lane(body.history, laws.history, p, 0, GRADIENT))
    if ti.static(options.clamped):
        F = clip_matrix(body, p, F)
    q, which = constants(body, p, laws)
    psi = stress.energy(laws, which, listed(F), q, converged)
    return number(body.V0, 0, 1, p, 0) * psi[0]


@ti.func
def particle_von_mises(
    body: ti.template(), p, laws: ti.template(), ih, converged, options: ti.template()
):
    """Von Mises stress of the Cauchy stress P F^T / J, without viscosity."""
    trial = particle_strain(body, p, ih, options)
    F, _ = elastic(body, p, trial, laws, 0.0 * ih, converged, options, False)
    P = particle_pk1(body, p, F, laws, converged)
    if ti.static(options.capped):
        P = cap_matrix(body, p, P)
    return von_mises(listed(P), listed(F))[0]
