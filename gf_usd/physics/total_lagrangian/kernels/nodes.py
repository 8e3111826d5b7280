"""Update of one node in a substep: sum the blocks of its cells in a fixed order, and integrate.

No atomics are used, so that the result does not depend on the number of threads. Dependent nodes
(`grid.dependent_nodes`, `grid.pins`) pass their forces to the free nodes they depend on, and are
interpolated from their motion.

A goal pulls a node to a position X + G(t) by a spring of k = w^2 and c = 2 zeta w,

    m dv/dt = f - m k (u - G) - m c (v - dG/dt)

integrated by the implicit midpoint rule, which is stable for any k: with u at the middle of the
substep, where forces are evaluated,

    (1 + k dt^2 / 4 + c dt / 2) (v' - v) = dt (f / m - k (u - G) - c (v - dG/dt))

With the mass M~ of `grid.mass`, m is increased by the same factor.

A limit is a restoring acceleration of `grid.goals` against too great a distance, evaluated at the
middle of the substep like the forces: toward G, and along n from B toward the bone.
"""

import taichi as ti

from gf_usd.physics.contact.kernels import contact_force, first_of, row
from gf_usd.physics.grid.goals import (
    AWAY,
    CARRIED,
    GOAL,
    HARD,
    NORMAL,
    PULL,
    RATE,
    SPRING,
    TOWARD,
    WORK,
)
from gf_usd.physics.laws.simd3x3 import LANE_BITS, LANES
from gf_usd.physics.total_lagrangian.kernels.scalar import number
from gf_usd.physics.total_lagrangian.layout import (
    ANCHOR,
    GROUND,
    INVERSE,
    MASS,
    PIN_RATE,
    PIN_WORK,
)
from gf_usd.physics.total_lagrangian.limits import NO_GOALS, SPRINGS

# Entries of a row that a GPU thread loads before it adds the first of them, so that their memory
# latencies overlap.
AHEAD = 8


@ti.func
def block_sum(body: ti.template(), node, options: ti.template()):
    """Sum of the contributions of a node's cells, in a fixed order; in the plain layout, of
    `node_force`.
    """
    f = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    first, behind = body.node_slot_start[node], body.node_slot_start[node + 1]
    if ti.static(options.plain):
        for a in ti.static(range(3)):
            f[a] = number(body.block, 0, 3, node, a)
    elif ti.static(options.cells):
        for turn in range(turns(first, behind)):
            for k in ti.static(range(AHEAD)):
                e, on = entry(first + turn * AHEAD + k, behind)
                f += on * slot(body, e)
    else:
        for e in range(first, behind):
            f += slot(body, e)
    return f


@ti.func
def slot(body: ti.template(), e):
    """The contribution of one cell to a node."""
    o = body.node_slot[e] >> LANE_BITS
    lane = body.node_slot[e] & (LANES - 1)
    return ti.Vector([body.block[o][lane], body.block[o + 1][lane], body.block[o + 2][lane]])


@ti.func
def turns(first, behind):
    """Number of chunks of AHEAD entries; the last one may be incomplete."""
    return (behind - first + AHEAD - 1) // AHEAD


@ti.func
def entry(e, behind):
    """Entry e and the factor 1; the last entry and the factor 0 where e is beyond the range."""
    return ti.min(e, behind - 1), int(e < behind)


@ti.func
def dependent_share(
    body: ti.template(), node, free, dt, alpha, filtering, options: ti.template()
):  # fmt: skip
    """Store the sum of the cells' contributions to a dependent node, for the free nodes it depends
    on; and count the work of a pin.

    filtering : 1: the sum is (B v - m v)_l, and the impulse on the node is alpha times it.
    """
    f = block_sum(body, free + node, options)
    impulse = dt
    if filtering > 0:
        f = momentum_change(body, free + node, f)
        impulse = alpha
    o = ANCHOR * node
    work = body.anchor[o + PIN_WORK]
    for d in ti.static(range(3)):
        work -= impulse * f[d] * body.anchor[o + PIN_RATE + d]
    body.anchor[o + PIN_WORK] = work
    keep_share(body, free + node, f, options.slides)


@ti.func
def keep_share(body: ti.template(), node, f, slides: ti.template()):
    """Store a dependent node's contribution, with the factors per axis where pins slide."""
    for d in ti.static(range(3)):
        if ti.static(slides):
            body.share[3 * node + d] = body.slide[3 * node + d] * f[d]
        else:
            body.share[3 * node + d] = f[d]


@ti.func
def node_sum(body: ti.template(), node, filtering, options: ti.template()):
    """Sum of the cells' contributions to a free node and to its dependent nodes: (E^T f)_i.

    filtering : 1: E^T (B - M) E v, from the stored values of the dependent nodes.
    """
    f = block_sum(body, node, options)
    if filtering > 0:
        f = momentum_change(body, node, f)
    return f + sum_of_dependent_nodes(body, node, options)


@ti.func
def momentum_change(body: ti.template(), node, p):
    """(B v - m v)_i from p = (B v)_i: the change by a transfer to particles and back."""
    v = ti.Vector([body.v[3 * node], body.v[3 * node + 1], body.v[3 * node + 2]])
    return p - body.node_mass[MASS * node] * v


@ti.func
def sum_of_dependent_nodes(body: ti.template(), node, options: ti.template()):
    """sum_l e_li of the stored contributions of the dependent nodes."""
    f = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    first, behind = body.leader_start[node], body.leader_start[node + 1]
    if ti.static(options.cells):
        for turn in range(turns(first, behind)):
            for k in ti.static(range(AHEAD)):
                e, on = entry(first + turn * AHEAD + k, behind)
                f += (on * body.leader_weight[e]) * row(
                    body.share, first_of(body.leader_dependent[e])
                )
    else:
        for e in range(first, behind):
            f += body.leader_weight[e] * row(body.share, first_of(body.leader_dependent[e]))
    return f


@ti.func
def follow(
    body: ti.template(), node, free, drift, whole: ti.template(), options: ti.template()
):  # fmt: skip
    """u_l = sum_j e_lj u_j + c_l, and v likewise; c advances by drift at its rate.

    Where pins slide, the sum has a factor per axis.

    whole : u is summed; otherwise the free nodes have drifted since then, and u_l += drift v_l is
    the same. The nodes of rigid regions turn as they drift: there it is summed always.
    """
    a = ANCHOR * node
    rate = ti.Vector([body.anchor[a + 3], body.anchor[a + 4], body.anchor[a + 5]])
    u = ti.Vector([body.anchor[a], body.anchor[a + 1], body.anchor[a + 2]]) + drift * rate
    v = rate
    for d in ti.static(range(3)):
        body.anchor[a + d] = u[d]
    k = ti.Vector([drift * 0.0 + 1.0, drift * 0.0 + 1.0, drift * 0.0 + 1.0])
    o = 3 * (free + node)
    if ti.static(options.slides):
        k = ti.Vector([body.slide[o], body.slide[o + 1], body.slide[o + 2]])
    first, behind = body.follow_start[free + node], body.follow_start[free + node + 1]
    if ti.static(options.cells):
        for turn in range(turns(first, behind)):
            for m in ti.static(range(AHEAD)):
                e, on = entry(first + turn * AHEAD + m, behind)
                j, w = first_of(body.follow_node[e]), on * body.follow_weight[e]
                v += scaled_row(w, k, body.v, j, options)
                if ti.static(whole or options.rigid > 0):
                    u += scaled_row(w, k, body.u, j, options)
    else:
        for e in range(first, behind):
            j, w = first_of(body.follow_node[e]), body.follow_weight[e]
            v += scaled_row(w, k, body.v, j, options)
            if ti.static(whole or options.rigid > 0):
                u += scaled_row(w, k, body.u, j, options)
    if ti.static(not (whole or options.rigid > 0)):
        u = row(body.u, o) + drift * v
    for d in ti.static(range(3)):
        body.u[o + d] = u[d]
        body.v[o + d] = v[d]


@ti.func
def scaled_row(w, k, field: ti.template(), j, options: ti.template()):
    """w k u of the node whose components begin at j; k applies where pins slide."""
    out = w * row(field, j)
    if ti.static(options.slides):
        out = w * k * row(field, j)
    return out


@ti.func
def drift_node(body: ti.template(), node, drift):
    """u += drift v."""
    for a in range(3 * node, 3 * node + 3):
        body.u[a] = body.u[a] + drift * body.v[a]


@ti.func
def force(body: ti.template(), node, contact, dt, filtering, options: ti.template()):
    """Sum of internal, contact and goal forces on a free node; filtering : see `node_sum`."""
    f = node_sum(body, node, filtering, options)
    if filtering == 0:
        if ti.static(options.goals > NO_GOALS):
            f += goal_force(body, node)
        if ti.static(options.goals > SPRINGS):
            f += limit_pull(body, node) / body.node_mass[MASS * node + INVERSE]
        if contact > 0:
            f += contact_force(body, node, dt)
    return f


@ti.func
def drift_goal(body: ti.template(), node, drift, goals: ti.template()):
    """G += drift dG/dt, and B and n of the limits likewise."""
    for a in range(GOAL * node, GOAL * node + 3):
        body.goal[a] = body.goal[a] + drift * body.goal[a + RATE]
        if ti.static(goals > SPRINGS):
            for o in ti.static((CARRIED, NORMAL)):
                body.goal[a + o] = body.goal[a + o] + drift * body.goal[a + o + 3]


@ti.func
def goal_spring(body: ti.template(), node):
    """k and c of the spring from a node to its goal."""
    o = GOAL * node + SPRING
    return body.goal[o], body.goal[o + 1]


@ti.func
def goal_force(body: ti.template(), node):
    """-m (k (u - G) + c (v - dG/dt)), the force of the spring from a node to its goal G."""
    f = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    k, c = goal_spring(body, node)
    for d in ti.static(range(3)):
        a, o = 3 * node + d, GOAL * node + d
        f[d] = -(k * (body.u[a] - body.goal[o]) + c * (body.v[a] - body.goal[o + RATE]))
    return f / body.node_mass[MASS * node + INVERSE]


@ti.func
def goal_share(body: ti.template(), node, dt, filtering, goals: ti.template()):
    """1 / (1 + k dt^2 / 4 + c dt / 2): the factor of the implicit spring on an acceleration.

    filtering : 1: the factor is 1, since the filter does not involve the spring.
    """
    share = dt * 0.0 + 1.0
    if ti.static(goals > NO_GOALS):  # noqa: SIM102  (known while the kernel is built; the next is not)
        if filtering == 0:
            k, c = goal_spring(body, node)
            share = 1.0 / (1.0 + 0.25 * dt * dt * k + 0.5 * dt * c)
    return share


@ti.func
def limit_pull(body: ti.template(), node):
    """[m/s^2] acceleration of a node by the limits: see `grid.goals`."""
    o = GOAL * node
    u = row(body.u, 3 * node)
    y = u - row(body.goal, o)
    way = y.norm()
    out = 0.0 * y
    pull = limit_acceleration(way, body.goal[o + AWAY], body.goal[o + HARD])
    if pull > 0.0:
        out = (0.0 - pull / way) * y
    n = row(body.goal, o + NORMAL).normalized()
    inward = n.dot(row(body.goal, o + CARRIED) - u)
    out += limit_acceleration(inward, body.goal[o + TOWARD], body.goal[o + HARD]) * n
    return out


@ti.func
def limit_acceleration(way, slack, hardest):
    """A s^2 / (1 - s) of s = (way - slack) / slack, continued linearly from where its slope reaches
    `hardest`; 0 where there is no slack.
    """
    out = 0.0 * way
    if slack > 0.0 and way > slack:
        s = way / slack - 1.0
        left = 1.0 / ti.sqrt(1.0 + hardest * slack / PULL)  # 1 - s*
        soft = ti.min(s, 1.0 - left)
        out = PULL * soft * soft / (1.0 - soft) + hardest * slack * (s - soft)
    return out


@ti.func
def goal_work(body: ti.template(), node, before, dt, goals: ti.template()):
    """Add the work of a goal's spring in a substep, f . v dt at the midpoint.

    before : v before the substep.
    """
    k, c = goal_spring(body, node)
    pull = ti.Vector([dt * 0.0, dt * 0.0, dt * 0.0])
    if ti.static(goals > SPRINGS):
        pull = limit_pull(body, node)
    work = body.goal[GOAL * node + WORK]
    for d in ti.static(range(3)):
        a, o = 3 * node + d, GOAL * node + d
        change = body.v[a] - before[d]
        y = body.u[a] - body.goal[o] + 0.25 * dt * change
        middle = before[d] + 0.5 * change
        drawn = pull[d] - (k * y + c * (middle - body.goal[o + RATE]))
        work += dt * middle * drawn / body.node_mass[MASS * node + INVERSE]
    body.goal[GOAL * node + WORK] = work


@ti.func
def store_acceleration(body: ti.template(), node, f, share):
    """Store share f / m of a node, for itself and its neighbors: see `inverse`."""
    for d in ti.static(range(3)):
        body.share[3 * node + d] = share * f[d] * body.node_mass[MASS * node + INVERSE]


@ti.func
def inverse(body: ti.template(), node, share, options: ti.template()):
    """(M~^-1 f)_i = r_i + (k_i r_i + sum_j k_ij (r_i - r_j)) / m_i from the stored r = f / m.

    In terms of differences, so that the force in a spring is exactly equal and opposite at its
    ends.

    share : of 1 / m, as in `store_acceleration`. Sliding pins: springs have a strength per axis.
    """
    o = node * 3
    r = row(body.share, o)
    s = body.node_mass[MASS * node + GROUND] * r
    if ti.static(options.slides):
        s = row(body.slide, o) * r
    first, behind = body.follow_start[node], body.follow_start[node + 1]
    if ti.static(options.cells):
        for turn in range(turns(first, behind)):
            for m in ti.static(range(AHEAD)):
                e, on = entry(first + turn * AHEAD + m, behind)
                s += on * spring(body, r, e, options)
    else:
        for e in range(first, behind):
            s += spring(body, r, e, options)
    return r + share * s * body.node_mass[MASS * node + INVERSE]


@ti.func
def spring(body: ti.template(), r, e, options: ti.template()):
    """k_ij (r_i - r_j) of one entry."""
    way = r - row(body.share, first_of(body.follow_node[e]))
    out = body.follow_weight[e] * way
    if ti.static(options.slides):
        out = row(body.springs, 3 * e) * way
    return out


@ti.func
def move_node(
    body: ti.template(), node, contact, g, dt, drift, keep, alpha, filtering,
    options: ti.template(),
):  # fmt: skip
    """v += dt (M~^-1 f + g + b), u += drift v; where the mass is coupled, the forces are already
    stored.

    filtering : 1: v += alpha M~^-1 E^T (B - M) E v instead. B and M agree on sum m v and sum X x m
    v, and E preserves both, so that the momenta of M~ are conserved to rounding. Since B <= M as
    quadratic forms, no motion can grow while alpha M~^-1 M <= 1.
    """
    share = goal_share(body, node, dt, filtering, options.goals)
    before = ti.Vector([body.v[3 * node], body.v[3 * node + 1], body.v[3 * node + 2]])
    r = before * 0.0
    if ti.static(options.coupled):
        r = inverse(body, node, share, options)
    else:
        r = (
            force(body, node, contact, dt, filtering, options)
            * body.node_mass[MASS * node + INVERSE]
            * share
        )
    if filtering > 0:
        for d in ti.static(range(3)):
            body.v[3 * node + d] = body.v[3 * node + d] + alpha * r[d]
    else:
        a = share * g + r
        for d in ti.static(range(3)):
            a[d] += share * body.acceleration[3 * node + d]
            body.v[3 * node + d] = body.v[3 * node + d] + dt * a[d]
        if ti.static(options.goals > NO_GOALS):
            goal_work(body, node, before, dt, options.goals)
            drift_goal(body, node, drift, options.goals)
        for d in ti.static(range(3)):
            v = body.v[3 * node + d] * keep
            body.v[3 * node + d] = v
            body.u[3 * node + d] = body.u[3 * node + d] + drift * v
