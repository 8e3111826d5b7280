"""Floor contact on surface samples, inside a substep.

A sample of mass m_s at depth d > 0 below the floor, moving along the floor's normal n with v_n:

    f_n = max(0, k d - c v_n),   c = -2 sqrt(k m_s) ln r / sqrt(pi^2 + ln^2 r)   (section 3.4)
    f_t = -min(mu f_n, m_s |v_t| / (2 dt)) v_t / |v_t|                          (Coulomb)

The second bound is the limit of stability of explicit friction (docs/physics.md): there the
sample sticks.  Where it acts while mu f_n is larger it is counted.
"""

import taichi as ti


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
