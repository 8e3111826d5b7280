"""Floor contact on surface samples, inside a substep.

A sample of mass m_s at depth d > 0 below the floor, moving along the floor's normal n with v_n:

    f_n = max(0, k d - c v_n),   c = -2 sqrt(k m_s) ln r / sqrt(pi^2 + ln^2 r)   (section 3.4)
    f_t = -min(mu f_n, m_s |v_t| / (2 dt)) v_t / |v_t|                          (Coulomb)

The second bound is the limit of stability of explicit friction (docs/physics.md): there the
sample sticks.  Where it acts while mu f_n is larger it is counted.

Contact of surface samples with other bodies and with obstacles, inside a substep.

A sample s faces at most one plane, chosen by `neighbors` between substeps.  The plane belongs to
an obstacle, which moves it (point q, velocity v_q), or to a body, where it rides on that body's
sample b nearest to it (q = x_b + offset, v_q = v_b).  With the plane's outward normal n, at depth
d = (q - x_s) . n > 0,

    f_n = max(0, k d - c (v_s - v_q) . n)        f_t by Coulomb, capped as on the floor
    f_s += f,    f_b -= f

so that what one body loses another gains, to rounding.  A sample sums what it is dealt in the order
of a list, without atomics: the result does not depend on the number of threads.
"""

import taichi as ti

from gf_usd.physics.contact.narrow_phase import (
    DAMPING,
    DEPTH,
    DRIFT,
    FORCE,
    FRICTION,
    LINKS,
    MASS,
    NOBODY,
    NORMAL,
    OBSTACLE,
    PAIR_FACING,
    PARTNER,
    PLACE,
    POINT,
    RATE,
    REST,
    ROW,
    START,
    STIFFNESS,
    VELOCITY,
    WORK,
)


@ti.func
def sample_contact(body: ti.template(), s, up, lift, dt):
    """Force of the floor on sample s; lift is the height of the moving frame of u [m]."""
    rise = lift * 0.0
    for e in range(body.sample_start[s], body.sample_start[s + 1]):
        n = body.sample_node[e] * 3
        x = up[0] * body.u[n] + up[1] * body.u[n + 1] + up[2] * body.u[n + 2]
        rise += body.sample_weight[e] * x
    d = 0.0 - (body.sample_height[s] + lift + rise)
    v = up * 0.0
    # Most that are watched are above the floor: their velocity is not asked for.
    if d > 0.0:
        for e in range(body.sample_start[s], body.sample_start[s + 1]):
            n = body.sample_node[e] * 3
            v += body.sample_weight[e] * ti.Vector([body.v[n], body.v[n + 1], body.v[n + 2]])
    floor_force(body, s, d, v, up, dt)


@ti.func
def floor_force(body: ti.template(), s, d, v, up, dt):
    """Set the force on sample s at depth d [m], moving with v; note its depth and cap."""
    f = up * 0.0
    if d > 0.0:
        vn = v.dot(up)
        fn = ti.max(0.0, body.sample_stiffness[s] * d - body.sample_damping[s] * vn)
        vt = v - vn * up
        speed = vt.norm()
        slip = body.sample_friction[s] * fn
        stick = 0.5 * body.sample_mass[s] * speed / dt
        if slip > stick:
            body.sample_capped[s] = body.sample_capped[s] + 1
        f = fn * up
        if speed > 0.0:
            f = f - (ti.min(slip, stick) / speed) * vt
        body.sample_depth[s] = ti.max(body.sample_depth[s], d)
    for a in ti.static(range(3)):
        body.sample_force[3 * s + a] = f[a]


@ti.func
def contact_force(body: ti.template(), node):
    """sum_s W_si f_s on a node, over the samples that are watched."""
    f = ti.Vector([body.u[0] * 0.0, body.u[0] * 0.0, body.u[0] * 0.0])
    for e in range(body.node_sample_start[node], body.node_sample_start[node + 1]):
        s = body.node_sample[e] * 3
        w = body.node_sample_weight[e]
        f += w * ti.Vector(
            [body.sample_force[s], body.sample_force[s + 1], body.sample_force[s + 2]]
        )
    return f


@ti.func
def row(A: ti.template(), o):
    """Three numbers of an array from o on."""
    return ti.Vector([A[o], A[o + 1], A[o + 2]])


@ti.func
def keep(A: ti.template(), o, value):
    """The same, written."""
    for a in ti.static(range(3)):
        A[o + a] = value[a]


@ti.func
def sample_motion(body: ti.template(), s, dt):
    """x (without the offset) and v of sample s, kept for those that face it."""
    o = ROW * s
    x = row(body.pair, o + REST)
    v = row(body.pair, o + DRIFT)
    keep(body.pair, o + REST, x + dt * v)  # what a pin gives moves on
    for e in range(body.sample_start[s], body.sample_start[s + 1]):
        w = body.sample_weight[e]
        x += w * row(body.u, 3 * body.sample_node[e])
        v += w * row(body.v, 3 * body.sample_node[e])
    keep(body.pair, o + PLACE, x)
    keep(body.pair, o + RATE, v)


@ti.func
def pair_contact(body: ti.template(), s, dt):
    """Force on sample s of the plane it faces."""
    who = body.links[LINKS * s + PARTNER]
    o = ROW * s
    f = row(body.pair, o + PLACE) * 0.0
    if who != NOBODY:
        n = row(body.pair, o + NORMAL)
        q = row(body.pair, o + POINT)
        vq = row(body.pair, o + VELOCITY)
        if who == OBSTACLE:
            keep(body.pair, o + POINT, q + dt * vq)
        else:
            q += row(body.pair, ROW * who + PLACE)
            vq = row(body.pair, ROW * who + RATE)
        d = (q - row(body.pair, o + PLACE)).dot(n)
        if d > 0.0:
            v = row(body.pair, o + RATE) - vq
            vn = v.dot(n)
            fn = ti.max(0.0, body.pair[o + STIFFNESS] * d - body.pair[o + DAMPING] * vn)
            vt = v - vn * n
            speed = vt.norm()
            slip = body.pair[o + FRICTION] * fn
            stick = 0.5 * body.pair[o + MASS] * speed / dt
            if slip > stick:
                body.sample_capped[s] = body.sample_capped[s] + 1
            f = fn * n
            if speed > 0.0:
                f = f - (ti.min(slip, stick) / speed) * vt
            body.pair[o + DEPTH] = ti.max(body.pair[o + DEPTH], d)
            if who == OBSTACLE:
                body.pair[o + WORK] = body.pair[o + WORK] + dt * f.dot(vq)
    keep(body.pair, o + FORCE, f)


@ti.func
def pair_total(body: ti.template(), s):
    """sample_force += own force - what those that face it got."""
    f = row(body.sample_force, 3 * s) + row(body.pair, ROW * s + FORCE)
    for e in range(body.links[LINKS * s + START], body.links[LINKS * (s + 1) + START]):
        f = f - row(body.pair, ROW * body.links[LINKS * e + PAIR_FACING] + FORCE)
    keep(body.sample_force, 3 * s, f)
