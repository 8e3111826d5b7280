"""Updates of nodes, samples and particles in a substep of the Updated Lagrangian solver."""

import taichi as ti

from gf_usd.physics.contact.kernels import floor_force, friction, keep, row
from gf_usd.physics.laws import stress
from gf_usd.physics.updated_lagrangian import planes
from gf_usd.physics.updated_lagrangian.embedded_points import SUPPORT


@ti.func
def vector(A: ti.template(), o):
    """Three components of an array, starting at o."""
    return ti.Vector([A[o], A[o + 1], A[o + 2]])


@ti.func
def turned(A: ti.template(), p, d):
    """A_p d for the matrix of particle p."""
    return ti.Vector(
        [
            A[9 * p] * d[0] + A[9 * p + 1] * d[1] + A[9 * p + 2] * d[2],
            A[9 * p + 3] * d[0] + A[9 * p + 4] * d[1] + A[9 * p + 5] * d[2],
            A[9 * p + 6] * d[0] + A[9 * p + 7] * d[1] + A[9 * p + 8] * d[2],
        ]
    )


@ti.func
def drift_particle(body: ti.template(), p, laws: ti.template(), dt):
    """x += dt v, F += dt L F: the initial half drift of a frame."""
    for d in ti.static(range(3)):
        body.x[3 * p + d] = body.x[3 * p + d] + dt * body.v[3 * p + d]
    drift_gradient(body, p, body.F, 9 * p, dt)
    if ti.static(laws.flows):
        drift_gradient(body, p, body.history, laws.history * p, dt)


@ti.func
def drift_gradient(body: ti.template(), p, F: ti.template(), o, dt):
    """F += dt L F of particle p, whose F begins at o."""
    for a in ti.static(range(3)):
        column = ti.Vector([F[o + a], F[o + 3 + a], F[o + 6 + a]])
        rate = turned(body.L, p, column)
        for d in ti.static(range(3)):
            F[o + 3 * d + a] = column[d] + dt * rate[d]


@ti.func
def clamp_particle(body: ti.template(), p, laws: ti.template(), low, high):
    """Clip the singular values of the gradient from which the stress is computed to [low, high]."""
    if ti.static(laws.flows):
        clamp_gradient(body, p, body.history, laws.history * p, low, high)
    else:
        clamp_gradient(body, p, body.F, 9 * p, low, high)


@ti.func
def clamp_gradient(body: ti.template(), p, gradients: ti.template(), o, low, high):
    """Clip the singular values of the F that begins at o to [low, high].

    Where J < 0 the smallest is negative.
    """
    F = ti.Matrix.rows([vector(gradients, o), vector(gradients, o + 3), vector(gradients, o + 6)])
    square = F.norm_sqr()
    # s1 s2 <= |F|^2 / 2, so that s3 = J / (s1 s2) >= 2 J / |F|^2: most need no decomposition.
    if square > high * high or 2.0 * F.determinant() < low * square:
        G, outside = stress.clipped_matrix(F, low, high)
        if outside > 0:
            body.clamped[p] = 1
            for a in ti.static(range(3)):
                for b in ti.static(range(3)):
                    gradients[o + 3 * a + b] = G[a, b]


@ti.func
def sample_force(body: ti.template(), s, up, lift, dt, pair_contact: ti.template()):
    """Force of the floor on sample s, by the formulas of `contact.kernels`, and of its plane.

    lift : [m] height of the moving frame's origin above the floor; pair_contact : there are planes.
    """
    x = up * 0.0
    v = up * 0.0
    for e in range(SUPPORT * s, SUPPORT * (s + 1)):
        p = body.support_particle[e]
        w = body.support_weight[e]
        d = turned(body.F, p, vector(body.support_arm, 3 * e))
        x += w * (vector(body.x, 3 * p) + d)
        v += w * (vector(body.v, 3 * p) + turned(body.L, p, d))
    floor_force(body, s, 0.0 - (lift + x.dot(up)), v, up, dt)
    if ti.static(pair_contact):
        plane_force(body, s, planes.ROW * body.sample_plane[s], x, v, dt)


@ti.func
def plane_force(body: ti.template(), s, o, x, v, dt):
    """Add the force of the plane whose values begin at o on sample s at x, with velocity v.

    o : negative without a plane.
    """
    if o >= 0:
        n = row(body.plane, o + planes.NORMAL)
        vq = row(body.plane, o + planes.VELOCITY)
        q = row(body.plane, o + planes.POINT) + dt * vq
        keep(body.plane, o + planes.POINT, q)
        d = (q - x).dot(n)
        slid = 0.0 * x
        if d > 0.0:
            k, c = body.plane[o + planes.STIFFNESS], body.plane[o + planes.DAMPING]
            u = v - vq
            un = u.dot(n)
            fn = ti.max(0.0, k * d * (1.0 + body.plane[o + planes.HARDENING] * d * d) - c * un)
            ut = u - un * n
            xi = row(body.plane, o + planes.SPRING) + dt * ut
            xi, ft = friction(xi - xi.dot(n) * n, ut, k, c, body.plane[o + planes.FRICTION] * fn)
            slid = xi
            f = fn * n + ft
            keep(body.sample_force, 3 * s, row(body.sample_force, 3 * s) + f)
            keep(body.plane, o + planes.IMPULSE, row(body.plane, o + planes.IMPULSE) + dt * f)
            moment = row(body.plane, o + planes.MOMENT) + dt * x.cross(f)
            keep(body.plane, o + planes.MOMENT, moment)
            body.plane[o + planes.DEPTH] = ti.max(body.plane[o + planes.DEPTH], d)
            body.plane[o + planes.WORK] = body.plane[o + planes.WORK] + dt * f.dot(vq)
        keep(body.plane, o + planes.SPRING, slid)


@ti.func
def push_particle(body: ti.template(), p):
    """Force f_p and moment M_p = sum w f (x) d of the samples in whose support particle p is.

    The transpose of the interpolation of a sample's motion, so that work, momentum and angular
    momentum are consistent.
    """
    f = vector(body.x, 3 * p) * 0.0
    m0 = f
    m1 = f
    m2 = f
    for at in range(body.particle_support_start[p], body.particle_support_start[p + 1]):
        e = body.particle_support[at]
        g = body.support_weight[e] * vector(body.sample_force, 3 * (e // SUPPORT))
        d = turned(body.F, p, vector(body.support_arm, 3 * e))
        f += g
        m0 += g[0] * d
        m1 += g[1] * d
        m2 += g[2] * d
    for a in ti.static(range(3)):
        body.push[12 * p + a] = f[a]
        body.push[12 * p + 3 + a] = m0[a]
        body.push[12 * p + 6 + a] = m1[a]
        body.push[12 * p + 9 + a] = m2[a]


@ti.func
def node_sum(body: ti.template(), n, zero):
    """Mass and momentum of node n, summed over the cells' blocks in a fixed order."""
    m = zero[0]
    p = zero
    for s in range(27):
        cell = body.node_cells[27 * n + s]
        if cell >= 0 and body.cell_count[ti.max(cell, 0)] > 0:
            o = cell * 108 + 4 * s
            m += body.block[o]
            p += vector(body.block, o + 1)
    return m, p


@ti.func
def move_node(body: ti.template(), n, g, dt, keep):
    """v_i = (p_i / m_i + dt g) keep."""
    m, p = node_sum(body, n, g * 0.0)
    v = p * 0.0
    if m > 0.0:
        v = (p / m + dt * g) * keep
    for d in ti.static(range(3)):
        body.node_v[3 * n + d] = v[d]
