"""Contact forces on surface samples within a substep: of the floor, other bodies and obstacles.

Floor. A sample of mass m_s at depth d > 0, with velocity v_n along the floor's normal n:

    f_n = max(0, k (d + e^3 / a^2) - c v_n),   e = max(0, d - d0)                (see `floor`)
    c = -2 sqrt(k m_s) ln r / sqrt(pi^2 + ln^2 r)                                (section 3.4)
    xi' = v_t,   |k_t xi| <= mu f_n              tangential spring: stick or slip
    f_t = -(k_t xi + c v_t),   |f_t| <= mu f_n   (Cundall and Strack 1979; Coulomb)

Vectors beyond a bound are scaled to it. The slip is the reduction of xi, and f_t . v_t is at least
the power stored and dissipated by the spring, since projection onto a ball is monotone: friction
never adds energy. Without the spring (k_t = 0, as in the paper) c is m_s / (2 dt), the limit of
stability, and such a sample creeps; it is counted where it creeps although mu f_n is larger.

A sample at height h above the floor cannot reach it before it has fallen by h. With w a bound of
the falling speed (`active`), it is skipped while h - b - n dt w > 0 after n substeps, with a margin
b of one spacing. Its force would be 0, so that results are unchanged. A node likewise skips its sum
while all its samples are skipped.

Bodies and obstacles. A sample s has at most one plane, chosen by `pairs` between substeps. Points
of obstacles in front of bodies are samples, too, that no node moves (`obstacles.edge_points`). The
plane belongs to an obstacle (point q, velocity v_q), or to a body and is then carried by three of
its samples (`planes.support_triangles`), with which it rotates at omega,

    q = sum_k w_k x_k + o,    v_q = sum_k w_k v_k + omega x (x_s - sum_k w_k x_k)

With the plane's outward normal n, at depth d = (q - x_s) . n > 0,

    f_n = max(0, k d (1 + (d / a)^2) - c (v_s - v_q) . n)
    f_t as on the floor, k_t = k, xi rotates with n
    f_s += f,    f_k += -w_k f + alpha x r_k,    J alpha = -(x_s - sum_k w_k x_k) x f

which conserves momentum and angular momentum of the bodies to rounding. A sample sums its reactions
in the order of a list, without atomics: the result does not depend on the number of threads.
"""

import taichi as ti

from gf_usd.physics.contact import floor
from gf_usd.physics.contact.floor import FLOOR_ROW, GIVEN_ROW, HEIGHT, K_T, LINEAR, M_S, MU, C, K
from gf_usd.physics.contact.planes.contact_planes import NOBODY, OBSTACLE
from gf_usd.physics.contact.planes.layout import (
    DAMPING,
    DEPTH,
    DRIFT,
    FORCE,
    FRICTION,
    HARDENING,
    LINKS,
    NORMAL,
    PAIR_FACING,
    PARTNER,
    PLACE,
    POINT,
    RATE,
    REACTION,
    REST,
    ROW,
    SPRING,
    START,
    STIFFNESS,
    VELOCITY,
    WEIGHT,
    WORK,
)
from gf_usd.physics.contact.planes.support_triangles import FLAT
from gf_usd.physics.total_lagrangian.limits import CLEARANCE, FALL, SLACK

INDEX = (1 << 30) - 1  # all bits of the index of a component


@ti.func
def first_of(item):
    """Index of the first component of a node or sample that is read from an array.

    With its bits given, the compiler knows that it is not negative: the offsets of the other
    components are then parts of their addresses, and not two instructions each. The sums over nodes
    take 0.8 of the time.
    """
    return (3 * item) & INDEX


@ti.func
def row(A: ti.template(), o):
    """Three components of an array, starting at o."""
    return ti.Vector([A[o], A[o + 1], A[o + 2]])


@ti.func
def keep(A: ti.template(), o, value):
    """Store three components, starting at o."""
    for a in ti.static(range(3)):
        A[o + a] = value[a]


@ti.func
def sample_contact(body: ti.template(), s, up, lift, dt, driven: ti.template()):
    """Force of the floor on sample s; lift is the height of the moving frame of u [m].

    driven : pins move samples, whose prescribed position advances.
    """
    drift = up * 0.0
    o = GIVEN_ROW * s
    d = lift * 0.0
    left = body.numbers[SLACK + 2 * s] - dt * body.numbers[FALL]
    if left <= 0.0:
        rise = lift * 0.0
        for e in range(body.sample_start[s], body.sample_start[s + 1]):
            n = first_of(body.sample_node[e])
            x = up[0] * body.u[n] + up[1] * body.u[n + 1] + up[2] * body.u[n + 2]
            rise += body.sample_weight[e] * x
        d = 0.0 - (body.sample_given[o + HEIGHT] + lift + rise)
        left = 0.0 - d - body.numbers[CLEARANCE]
    body.numbers[SLACK + 2 * s] = left
    if ti.static(driven):
        drift = row(body.sample_given, o + floor.DRIFT)
        body.sample_given[o + HEIGHT] = body.sample_given[o + HEIGHT] + dt * drift.dot(up)
    v = drift
    # Most active samples are above the floor and need no velocity.
    if d > 0.0:
        for e in range(body.sample_start[s], body.sample_start[s + 1]):
            n = first_of(body.sample_node[e])
            v += body.sample_weight[e] * row(body.v, n)
    floor_force(body, s, d, v, up, dt)
    if ti.static(driven):
        f = row(body.sample_force, 3 * s)
        work = body.sample_given[o + floor.WORK]
        body.sample_given[o + floor.WORK] = work - dt * f.dot(drift)


@ti.func
def friction(xi, v, k, c, most):
    """The spring xi [m] after slip, and the force of friction, at most `most` [N]."""
    held = k * xi.norm()
    if held > most:
        xi = (most / held) * xi
    f = 0.0 - (k * xi + c * v)
    size = f.norm()
    if size > most:
        f = (most / size) * f
    return xi, f


@ti.func
def floor_force(body: ti.template(), s, d, v, up, dt):
    """Set the force on sample s at depth d [m] with velocity v; store its depth and whether
    friction is capped.
    """
    f = up * 0.0
    xi = up * 0.0
    if d > 0.0:
        vn = v.dot(up)
        e = ti.max(0.0, d - body.sample_constants[FLOOR_ROW * s + LINEAR])
        harder = body.sample_constants[FLOOR_ROW * s + floor.HARDENING] * e * e * e
        fn = ti.max(
            0.0,
            body.sample_constants[FLOOR_ROW * s + K] * (d + harder)
            - body.sample_constants[FLOOR_ROW * s + C] * vn,
        )
        vt = v - vn * up
        most = body.sample_constants[FLOOR_ROW * s + MU] * fn
        k = body.sample_constants[FLOOR_ROW * s + K_T]
        c = body.sample_constants[FLOOR_ROW * s + C]
        if k > 0.0:
            xi = row(body.sample_spring, 3 * s) + dt * vt
        else:
            c = 0.5 * body.sample_constants[FLOOR_ROW * s + M_S] / dt
            if most > c * vt.norm():
                body.sample_capped[s] = body.sample_capped[s] + 1
        xi, ft = friction(xi, vt, k, c, most)
        f = fn * up + ft
        body.sample_depth[s] = ti.max(body.sample_depth[s], d)
    keep(body.sample_force, 3 * s, f)
    keep(body.sample_spring, 3 * s, xi)


@ti.func
def contact_force(body: ti.template(), node, dt):
    """sum_s W_si f_s on a node, over the active samples."""
    f = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    left = body.numbers[SLACK + 2 * node + 1] - dt * body.numbers[FALL]
    # The slack applies to the floor only, not to contact pairs.
    if left <= 0.0 or body.sample_active[0] > 0:
        first, behind = body.node_sample_start[node], body.node_sample_start[node + 1]
        left = ti.math.inf
        for e in range(first, behind):
            s = body.node_sample[e]
            left = ti.min(left, body.numbers[SLACK + ((2 * s) & INDEX)])
            f += body.node_sample_weight[e] * row(body.sample_force, first_of(s))
    body.numbers[SLACK + 2 * node + 1] = left
    return f


@ti.func
def sample_motion(body: ti.template(), s, dt):
    """Store x (without the offset) and v of sample s, for the samples whose planes it carries."""
    o = ROW * s
    x = row(body.pair, o + REST)
    v = row(body.pair, o + DRIFT)
    keep(body.pair, o + REST, x + dt * v)  # advance the prescribed position
    for e in range(body.sample_start[s], body.sample_start[s + 1]):
        w = body.sample_weight[e]
        n = first_of(body.sample_node[e])
        x += w * row(body.u, n)
        v += w * row(body.v, n)
    keep(body.pair, o + PLACE, x)
    keep(body.pair, o + RATE, v)


@ti.func
def inverse_inertia(a, b, c):
    """J^-1 [1/m^2] of three points at a, b, c [m] from their centroid; 0 where they are collinear.

    J is first divided by its trace: powers of a small spacing would underflow.
    """
    square = a.norm_sqr() + b.norm_sqr() + c.norm_sqr()
    xx = a[0] * a[0] + b[0] * b[0] + c[0] * c[0]
    yy = a[1] * a[1] + b[1] * b[1] + c[1] * c[1]
    zz = a[2] * a[2] + b[2] * b[2] + c[2] * c[2]
    xy = a[0] * a[1] + b[0] * b[1] + c[0] * c[1]
    xz = a[0] * a[2] + b[0] * b[2] + c[0] * c[2]
    yz = a[1] * a[2] + b[1] * b[2] + c[1] * c[2]
    J = ti.Matrix(
        [[square - xx, 0.0 - xy, 0.0 - xz], [0.0 - xy, square - yy, 0.0 - yz],
         [0.0 - xz, 0.0 - yz, square - zz]]
    )  # fmt: skip
    out = 0.0 * J
    if square > 0.0:
        J = J / (2.0 * square)
        if J.determinant() > ti.static(FLAT):
            out = J.inverse() / (2.0 * square)
    return out


@ti.func
def pair_contact(body: ti.template(), s, dt):
    """Force of its plane on sample s, and the reactions on the carriers."""
    who = body.links[LINKS * s + PARTNER]
    o = ROW * s
    x = row(body.pair, o + PLACE)
    f = 0.0 * x
    slid = 0.0 * x
    if who != NOBODY:
        v = row(body.pair, o + RATE)
        n = row(body.pair, o + NORMAL)
        q = row(body.pair, o + POINT)
        vq = row(body.pair, o + VELOCITY)
        weight = row(body.pair, o + WEIGHT)
        ra, rb, rc, arm, spin = f, f, f, f, f
        inverse = inverse_inertia(f, f, f)
        if who == OBSTACLE:
            q = q + dt * vq
            keep(body.pair, o + POINT, q)
        else:
            a = ROW * who
            b = ROW * body.links[LINKS * s + PARTNER + 1]
            c = ROW * body.links[LINKS * s + PARTNER + 2]
            ra, rb = row(body.pair, a + PLACE), row(body.pair, b + PLACE)
            rc = row(body.pair, c + PLACE)
            va, vb, vc = (
                row(body.pair, a + RATE),
                row(body.pair, b + RATE),
                row(body.pair, c + RATE),
            )
            carried = weight[0] * ra + weight[1] * rb + weight[2] * rc
            middle = (ra + rb + rc) / 3.0
            ra, rb, rc, arm = ra - middle, rb - middle, rc - middle, x - carried
            inverse = inverse_inertia(ra, rb, rc)
            spin = inverse @ (ra.cross(va) + rb.cross(vb) + rc.cross(vc))
            n = (n + dt * spin.cross(n)).normalized()
            q = q + dt * spin.cross(q)
            keep(body.pair, o + NORMAL, n)
            keep(body.pair, o + POINT, q)
            q = q + carried
            vq = weight[0] * va + weight[1] * vb + weight[2] * vc + spin.cross(arm)
        d = (q - x).dot(n)
        if d > 0.0:
            v = v - vq
            vn = v.dot(n)
            harder = 1.0 + body.pair[o + HARDENING] * d * d
            fn = ti.max(0.0, body.pair[o + STIFFNESS] * harder * d - body.pair[o + DAMPING] * vn)
            vt = v - vn * n
            xi = row(body.pair, o + SPRING) + dt * (vt + spin.cross(row(body.pair, o + SPRING)))
            xi, ft = friction(
                xi - xi.dot(n) * n, vt, body.pair[o + STIFFNESS], body.pair[o + DAMPING],
                body.pair[o + FRICTION] * fn,
            )  # fmt: skip
            f = fn * n + ft
            slid = xi
            body.pair[o + DEPTH] = ti.max(body.pair[o + DEPTH], d)
            if who == OBSTACLE:
                body.pair[o + WORK] = body.pair[o + WORK] + dt * f.dot(vq)
        if who != OBSTACLE:
            twist = inverse @ f.cross(arm)
            keep(body.pair, o + REACTION, twist.cross(ra) - weight[0] * f)
            keep(body.pair, o + REACTION + 3, twist.cross(rb) - weight[1] * f)
            keep(body.pair, o + REACTION + 6, twist.cross(rc) - weight[2] * f)
    keep(body.pair, o + FORCE, f)
    keep(body.pair, o + SPRING, slid)


@ti.func
def pair_total(body: ti.template(), s, dt):
    """sample_force += own force + reactions of the planes that s carries.

    The work of pins that move the sample against these forces is counted, and that of an obstacle
    at a point of it.
    """
    f = row(body.pair, ROW * s + FORCE)
    for e in range(body.links[LINKS * s + START], body.links[LINKS * (s + 1) + START]):
        entry = body.links[LINKS * (e // 3) + PAIR_FACING + e % 3]
        f += row(body.pair, ROW * (entry // 3) + REACTION + 3 * (entry % 3))
    o = ROW * s
    body.pair[o + WORK] = body.pair[o + WORK] - dt * f.dot(row(body.pair, o + DRIFT))
    keep(body.sample_force, 3 * s, row(body.sample_force, 3 * s) + f)
