"""Motion of a rigid region in a substep: see `grid.rigid`.

One item per region, which sums over the nodes of the region in a fixed order.
"""

import taichi as ti

from gf_usd.physics.contact.kernels import contact_force, row
from gf_usd.physics.grid.rigid import ARM, NODE, RHO, ROW, D, J, L, M, Q, V
from gf_usd.physics.total_lagrangian.kernels.nodes import ANCHOR, block_sum, momentum_change


@ti.func
def turned(q, r):
    """r rotated by a unit quaternion q (w, x, y, z)."""
    axis = ti.Vector([q[1], q[2], q[3]])
    t = 2.0 * axis.cross(r)
    return r + q[0] * t + axis.cross(t)


@ti.func
def quaternion(body: ti.template(), o):
    """The rotation of the region whose values begin at o."""
    a = o + Q
    return ti.Vector([body.rigid[a], body.rigid[a + 1], body.rigid[a + 2], body.rigid[a + 3]])


@ti.func
def local(body: ti.template(), o, q):
    """The components of the angular momentum along the principal axes."""
    return turned(ti.Vector([q[0], 0.0 - q[1], 0.0 - q[2], 0.0 - q[3]]), row(body.rigid, o + L))


@ti.func
def drift_region(body: ti.template(), k, time):
    """Free motion for a time: rotations about the principal axes 0, 1, 2, 1, 0 in turn."""
    o = ROW * k
    for a in ti.static(range(3)):
        body.rigid[o + D + a] = body.rigid[o + D + a] + time * body.rigid[o + V + a]
    q = quaternion(body, o)
    m = local(body, o, q)
    for step in ti.static((0, 1, 2, 3, 4)):
        a = ti.static((0, 1, 2, 1, 0)[step])
        part = ti.static((0.5, 0.5, 1.0, 0.5, 0.5)[step])
        angle = part * time * m[a] / body.rigid[o + J + a]
        c, s = ti.cos(angle), ti.sin(angle)
        b = ti.static((a + 1) % 3)
        d = ti.static((a + 2) % 3)
        mb = c * m[b] + s * m[d]
        md = c * m[d] - s * m[b]
        m[b] = mb
        m[d] = md
        h = 0.5 * angle
        ch, sh = ti.cos(h), ti.sin(h)
        # q times the rotation about axis a
        w = ch * q[0] - sh * q[1 + a]
        qa = ch * q[1 + a] + sh * q[0]
        qb = ch * q[1 + b] + sh * q[1 + d]
        qd = ch * q[1 + d] - sh * q[1 + b]
        q[0] = w
        q[1 + a] = qa
        q[1 + b] = qb
        q[1 + d] = qd
    q = q / q.norm()
    for a in ti.static(range(4)):
        body.rigid[o + Q + a] = q[a]


@ti.func
def nodes_of(body: ti.template(), k):
    """The range of a region's nodes."""
    return body.rigid_nodes[k], body.rigid_nodes[k + 1]


@ti.func
def pose_region(body: ti.template(), k, drift, regions: ti.template()):
    """Set the constants of the region's nodes, such that a drift at their rate ends at their
    position.
    """
    o = ROW * k
    q = quaternion(body, o)
    m = local(body, o, q)
    for a in ti.static(range(3)):
        m[a] = m[a] / body.rigid[o + J + a]
    omega = turned(q, m)
    first, behind = nodes_of(body, k)
    for e in range(first, behind):
        n = ROW * regions + NODE * e
        arm = turned(q, row(body.rigid, n + RHO))
        rate = row(body.rigid, o + V) + omega.cross(arm)
        c = row(body.rigid, o + D) + (arm - row(body.rigid, n + ARM)) - drift * rate
        node = ANCHOR * body.rigid_nodes[regions + 1 + e]
        for a in ti.static(range(3)):
            body.anchor[node + a] = c[a]
            body.anchor[node + 3 + a] = rate[a]


@ti.func
def open_region(body: ti.template(), k, drift, regions: ti.template()):
    """The initial half drift of a frame."""
    drift_region(body, k, drift)
    pose_region(body, k, drift, regions)


@ti.func
def filter_region(body: ti.template(), k, free, alpha, options: ti.template()):
    """Change the momenta by alpha times the change of a transfer to particles and back (APIC
    filter).
    """
    o = ROW * k
    q = quaternion(body, o)
    F = 0.0 * row(body.rigid, o + V)
    T = F
    first, behind = nodes_of(body, k)
    for e in range(first, behind):
        node = free + body.rigid_nodes[options.rigid + 1 + e]
        p = momentum_change(body, node, block_sum(body, node, options))
        F += p
        T += turned(q, row(body.rigid, ROW * options.rigid + NODE * e + RHO)).cross(p)
    for a in ti.static(range(3)):
        body.rigid[o + V + a] = body.rigid[o + V + a] + alpha * F[a] / body.rigid[o + M]
        body.rigid[o + L + a] = body.rigid[o + L + a] + alpha * T[a]
    pose_region(body, k, 0.0 * alpha, options.rigid)


@ti.func
def move_region(
    body: ti.template(), k, free, contact, g, dt, drift, keep, options: ti.template()
):  # fmt: skip
    """V += dt (F / M + g) and L += dt T, with F and T the sums of nodal forces and moments; then
    drift.
    """
    o = ROW * k
    q = quaternion(body, o)
    F = 0.0 * g
    T = 0.0 * g
    first, behind = nodes_of(body, k)
    for e in range(first, behind):
        node = free + body.rigid_nodes[options.rigid + 1 + e]
        f = block_sum(body, node, options)
        if contact > 0:
            f += contact_force(body, node, dt)
        F += f
        T += turned(q, row(body.rigid, ROW * options.rigid + NODE * e + RHO)).cross(f)
    for a in ti.static(range(3)):
        v = body.rigid[o + V + a] + dt * (F[a] / body.rigid[o + M] + g[a])
        body.rigid[o + V + a] = keep * v
        body.rigid[o + L + a] = keep * (body.rigid[o + L + a] + dt * T[a])
    drift_region(body, k, drift)
    pose_region(body, k, drift, options.rigid)
