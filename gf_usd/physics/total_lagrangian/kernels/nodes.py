"""Update of one node in a substep: sum its cells' blocks in a fixed order, and move.

No atomics, so the result does not depend on the number of threads.  Some nodes follow the free
ones (see `followers`, `holds`): they pass their sums on, and take their motion back.
"""

import taichi as ti

from gf_usd.physics.contact.kernels import contact_force
from gf_usd.physics.laws.simd3x3 import LANE_BITS, LANES
from gf_usd.physics.total_lagrangian.kernels.scalar import number


@ti.func
def block_sum(body: ti.template(), node, plain: ti.template()):
    """Sum of what the node's cells hold for it, in a fixed order; `plain_kernel` has summed it."""
    f = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    if ti.static(plain):
        for a in ti.static(range(3)):
            f[a] = number(body.block, 0, 3, node, a)
    else:
        for e in range(body.node_slot_start[node], body.node_slot_start[node + 1]):
            o = body.node_slot[e] >> LANE_BITS
            lane = body.node_slot[e] & (LANES - 1)
            f += ti.Vector([body.block[o][lane], body.block[o + 1][lane], body.block[o + 2][lane]])
    return f


@ti.func
def follower_share(
    body: ti.template(), follower, free, dt, plain: ti.template(), slides: ti.template()
):
    """Keep what the cells hold for a follower, for the nodes it follows; and what a pin works."""
    f = block_sum(body, free + follower, plain)
    work = body.work[follower]
    for d in ti.static(range(3)):
        work -= dt * f[d] * body.anchor_rate[3 * follower + d]
    body.work[follower] = work
    keep_share(body, free + follower, f, slides)


@ti.func
def keep_share(body: ti.template(), node, f, slides: ti.template()):
    """Keep what a follower hands on, by the factors of its row where pins slide."""
    for d in ti.static(range(3)):
        if ti.static(slides):
            body.share[3 * node + d] = body.slide[3 * node + d] * f[d]
        else:
            body.share[3 * node + d] = f[d]


@ti.func
def node_sum(body: ti.template(), node, plain: ti.template()):
    """What the cells hold for a free node and for those that follow it: (E^T f)_i."""
    return block_sum(body, node, plain) + leader_sum(body, node)


@ti.func
def leader_sum(body: ti.template(), node):
    """sum_l e_li of what the followers kept."""
    f = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    for e in range(body.leader_start[node], body.leader_start[node + 1]):
        o = body.leader_follower[e] * 3
        f += body.leader_weight[e] * ti.Vector(
            [body.share[o], body.share[o + 1], body.share[o + 2]]
        )
    return f


@ti.func
def follow(body: ti.template(), follower, free, drift, slides: ti.template()):
    """u_l = sum_j e_lj u_j + c_l, and v likewise; c moves on by drift at its rate.

    slides : the sum has a factor of each axis.
    """
    a = 3 * follower
    rate = ti.Vector([body.anchor_rate[a], body.anchor_rate[a + 1], body.anchor_rate[a + 2]])
    u = ti.Vector([body.anchor[a], body.anchor[a + 1], body.anchor[a + 2]]) + drift * rate
    v = rate
    for d in ti.static(range(3)):
        body.anchor[a + d] = u[d]
    k = ti.Vector([drift * 0.0 + 1.0, drift * 0.0 + 1.0, drift * 0.0 + 1.0])
    o = 3 * (free + follower)
    if ti.static(slides):
        k = ti.Vector([body.slide[o], body.slide[o + 1], body.slide[o + 2]])
    for e in range(body.follow_start[free + follower], body.follow_start[free + follower + 1]):
        j = body.follow_node[e] * 3
        w = body.follow_weight[e]
        if ti.static(slides):
            u += w * k * ti.Vector([body.u[j], body.u[j + 1], body.u[j + 2]])
            v += w * k * ti.Vector([body.v[j], body.v[j + 1], body.v[j + 2]])
        else:
            u += w * ti.Vector([body.u[j], body.u[j + 1], body.u[j + 2]])
            v += w * ti.Vector([body.v[j], body.v[j + 1], body.v[j + 2]])
    for d in ti.static(range(3)):
        body.u[o + d] = u[d]
        body.v[o + d] = v[d]


@ti.func
def drift_node(body: ti.template(), node, drift):
    """u += drift v."""
    for a in range(3 * node, 3 * node + 3):
        body.u[a] = body.u[a] + drift * body.v[a]


@ti.func
def force(body: ti.template(), node, contact, plain: ti.template()):
    """The force of the cells and of contact on a free node."""
    f = node_sum(body, node, plain)
    if contact > 0:
        f += contact_force(body, node)
    return f


@ti.func
def keep_raw(body: ti.template(), node, f):
    """Keep f / m of a node, for its neighbors and itself: see `inverse`."""
    for d in ti.static(range(3)):
        body.share[3 * node + d] = f[d] * body.inverse_mass[node]


@ti.func
def inverse(body: ti.template(), node, slides: ti.template()):
    """(M~^-1 f)_i = r_i + (k_i r_i + sum_j k_ij (r_i - r_j)) / m_i of the r = f / m that were kept.

    Differences: the force in a spring is equal and opposite at its ends, to the last bit.
    slides : springs have a strength along each axis.
    """
    o = node * 3
    r = ti.Vector([body.share[o], body.share[o + 1], body.share[o + 2]])
    s = body.node_mass[2 * node + 1] * r
    if ti.static(slides):
        s = ti.Vector([body.slide[o], body.slide[o + 1], body.slide[o + 2]]) * r
    for e in range(body.follow_start[node], body.follow_start[node + 1]):
        o = body.follow_node[e] * 3
        way = r - ti.Vector([body.share[o], body.share[o + 1], body.share[o + 2]])
        if ti.static(slides):
            a = 3 * e
            k = ti.Vector([body.springs[a], body.springs[a + 1], body.springs[a + 2]])
            s += k * way
        else:
            s += body.follow_weight[e] * way
    return r + s * body.inverse_mass[node]


@ti.func
def move_node(
    body: ti.template(), node, contact, g, dt, drift, keep, plain: ti.template(),
    coupled: ti.template(), slides: ti.template(),
):  # fmt: skip
    """v += dt (M~^-1 f + g + b), u += drift v; the forces are kept already where coupled."""
    a = g
    if ti.static(coupled):
        a += inverse(body, node, slides)
    else:
        a += force(body, node, contact, plain) * body.inverse_mass[node]
    for d in ti.static(range(3)):
        a[d] += body.acceleration[3 * node + d]
        v = (body.v[3 * node + d] + dt * a[d]) * keep
        body.v[3 * node + d] = v
        body.u[3 * node + d] = body.u[3 * node + d] + drift * v


@ti.func
def follower_loss(body: ti.template(), follower, free, plain: ti.template(), slides: ti.template()):
    """Keep (B v - m v)_l of a follower, for the nodes it follows."""
    keep_share(body, free + follower, momentum_change(body, free + follower, plain), slides)


@ti.func
def momentum_change(body: ti.template(), node, plain: ti.template()):
    """(B v - m v)_i: what a transfer to particles and back does to a node's momentum."""
    p = block_sum(body, node, plain)
    for d in ti.static(range(3)):
        p[d] -= body.node_mass[2 * node] * body.v[3 * node + d]
    return p


@ti.func
def filter_momentum(body: ti.template(), node, plain: ti.template()):
    """B v - m v of a free node, with the followers' shares: E^T (B - M) E v."""
    return momentum_change(body, node, plain) + leader_sum(body, node)


@ti.func
def filter_node(
    body: ti.template(), node, alpha, plain: ti.template(), coupled: ti.template(),
    slides: ti.template(),
):  # fmt: skip
    """v += alpha M~^-1 E^T (B - M) E v; what M~^-1 acts on is kept already where coupled.

    B and M agree on sum m v and sum X x m v, and E carries both, so the momenta of M~ are kept to
    rounding; B <= M in the sense of forms, so no motion can grow while alpha M~^-1 M <= 1.
    """
    a = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    if ti.static(coupled):
        a = inverse(body, node, slides)
    else:
        a = filter_momentum(body, node, plain) * body.inverse_mass[node]
    for d in ti.static(range(3)):
        body.v[3 * node + d] = body.v[3 * node + d] + alpha * a[d]
