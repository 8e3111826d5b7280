"""Nodes near mirror planes: see `updated_lagrangian.walls`."""

import taichi as ti

from gf_usd.physics.updated_lagrangian.kernels.particles import node_sum, vector
from gf_usd.physics.updated_lagrangian.kernels.sorting import NODES, find_node

REACH = 4  # [half cells] distance from a plane of nodes whose images may have particles in reach


@ti.func
def reflected(v, d: ti.template(), sticks):
    """Reflection R v at a plane normal to axis d; with no slip -v."""
    w = v
    w[d] = 0.0 - w[d]
    if sticks > 0:
        w = 0.0 - v
    return w


@ti.func
def move_walled_node(
    body: ti.template(), n, g, dt, keep, first: ti.template(), last: ti.template(),
    stuck: ti.template(), mask,
):  # fmt: skip
    """`move_node` with the images of planes; stores the impulse of the planes on the node's
    particles.
    """
    at = vector(body.node_at, 3 * n)
    own = at  # the image inside of the planes
    below = at * 0
    above = at * 0
    for d in ti.static(range(3)):
        if 2 * own[d] < first[d]:
            own[d] = first[d] - own[d]
            below[d] = 1
        elif 2 * own[d] > last[d]:
            own[d] = last[d] - own[d]
            above[d] = 1
    m = g[0] * 0.0
    p = g * 0.0
    for way in range(27):
        image = own
        here = 1
        q = g * 0.0
        for d in ti.static(range(3)):
            turn = way // 3 ** ti.static(2 - d) % 3
            low, high = 2 * own[d] - first[d], last[d] - 2 * own[d]
            if turn == 1:
                image[d] = first[d] - own[d]
                here *= ti.cast(low > 0 and low <= REACH, ti.i32)
            if turn == 2:
                image[d] = last[d] - own[d]
                here *= ti.cast(high > 0 and high <= REACH, ti.i32)
        if here > 0:
            node, _ = find_node(body, image[0], image[1], image[2], mask)
            if node >= 0:
                mass, q = node_sum(body, node, g * 0.0)
                q = q + mass * dt * g
                for d in ti.static(range(3)):
                    turn = way // 3 ** ti.static(2 - d) % 3
                    if turn > 0:
                        q = reflected(q, d, stuck[d] & turn)
                m += mass
                p += q
    v = g * 0.0
    if m > 0.0:
        v = p / m * keep
    for d in ti.static(range(3)):
        on = ti.cast(2 * own[d] == first[d], ti.i32)
        on += 2 * ti.cast(2 * own[d] == last[d], ti.i32)
        if on > 0:
            v[d] = 0.0
        if (on & stuck[d]) > 0:
            v = v * 0.0
    for d in ti.static(range(3)):
        if below[d] + above[d] > 0:
            v = reflected(v, d, stuck[d] & (below[d] + 2 * above[d]))
    mass, q = node_sum(body, n, g * 0.0)
    given = mass * v / keep - (q + mass * dt * g)
    for d in ti.static(range(3)):
        body.node_v[3 * n + d] = v[d]
        body.node_given[3 * n + d] = given[d]


@ti.func
def sum_wall_impulses(body: ti.template(), part, parts):
    """Add the impulses of the planes on one of `parts` parts of the nodes in a substep, in their
    order, to the sum of this part.
    """
    many = (body.grid[NODES] + parts - 1) // parts
    for n in range(many * part, ti.min(many * (part + 1), body.grid[NODES])):
        for d in ti.static(range(3)):
            o = 3 * part + d
            body.wall_impulse[o] = body.wall_impulse[o] + body.node_given[3 * n + d]
