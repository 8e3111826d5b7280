"""What a group of eight cells does in a substep: stress (eq. 2) and the APIC filter (eq. 1 and 3).

A group writes to a block of its own, 27 nodes x 3 for each cell, so groups never race.
"""

import taichi as ti

from gf_usd.physics.lanes import LANES, von_mises
from gf_usd.physics.option_kernel import clip, cut
from gf_usd.physics.stencil_kernel import (
    differences,
    differences_transposed,
    gather,
    gradient,
    middle,
    put_block,
    spline,
    spread,
)
from gf_usd.physics.unrolled_kernel import at, let, put, unrolled


@ti.func
def strain(body: ti.template(), b, u: ti.template(), s: ti.template(), h: ti.template(), ih,
           options: ti.template()):  # fmt: skip
    """F = F0 + sum_i u_i (x) G_ip of one batch; F0 = I, or what `reanchor` left; ih = 1/h."""
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


@ti.func
def stress_group(
    body: ti.template(), group, law: ti.template(), damped: ti.template(), ih, converged,
    options: ti.template(),
):  # fmt: skip
    """-V0 P G of the particles of eight cells into their block."""
    u = gather(body, body.u, group)
    differences(u)
    rate = gather(body, body.v, group) if ti.static(damped) else u
    if ti.static(damped):
        differences(rate)
    out = zeros(u)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle(body, b)
        F = strain(body, b, u, s, h, ih, options)
        if ti.static(options.clamped):
            clip(body, b, F, True)
        P = law.pk1(F, body.mu[b], body.lam[b], converged)
        if ti.static(damped):
            # Kelvin-Voigt: P += 2 mu tau F sym(F^T dF/dt), objective.
            D = gradient(rate, s, h)
            k = body.viscosity[b] * (0.25 * ih)
            add_viscous(P, k, F, D)
        if ti.static(options.capped):
            cut(body, b, P, True)
        k = (0.0 - 0.5 * ih) * body.V0[b]
        spread(scaled(k, P), s, h, out)
    differences_transposed(out)
    put_block(body.block, group, out)


@unrolled
def zeros(like):
    """As many lane vectors of zeros."""
    zero = let(like[0] * 0.0)
    return [zero] * len(like)


@unrolled
def scaled(k, A):
    """k A."""
    k = let(k)
    return let([k * a for a in A])


@unrolled
def add_viscous(P, k, F, D):
    """P += k F (e + e^T) with e = F^T D."""
    for a in range(3):
        for c in range(3):
            e = let(k * (F[a] * D[c] + F[3 + a] * D[3 + c] + F[6 + a] * D[6 + c]))
            # e_ac enters the symmetric part twice
            for r in range(0, 9, 3):
                put(P[r + c], P[r + c] + F[r + a] * e)
                put(P[r + a], P[r + a] + F[r + c] * e)


@ti.func
def filter_group(body: ti.template(), group):
    """m (v_p + C_p dX) of the particles of eight cells into their block: eq. 3 then eq. 1.

    v_p = sum w v_i and C_p = 4/h^2 sum w v_i (x) dX; with dX in cells the h cancels.
    """
    q = gather(body, body.v, group)
    out = zeros(q)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        f = [body.fx[3 * b], body.fx[3 * b + 1], body.fx[3 * b + 2]]
        filter_batch(q, f, body.m[b], out)
    put_block(body.block, group, out)


@unrolled
def filter_batch(q, f, m, out):
    """Add m (v_p + C_p dX) of the particles at f cells, of mass m, to out, from nodal v in q."""
    w = let([spline(f[a]) for a in range(3)])
    g = let([[w[a][i] * (float(i) - f[a]) for i in range(3)] for a in range(3)])  # w dX
    for d in range(3):
        t, t1, t2 = [], [], []
        for i in range(3):
            rows = [[q[27 * i + 9 * j + 3 * k + d] for k in range(3)] for j in range(3)]
            s = let([dot(w[2], row) for row in rows])
            s2 = [dot(g[2], row) for row in rows]
            t.append(let(dot(w[1], s)))
            t1.append(dot(g[1], s))
            t2.append(dot(w[1], s2))
        v = let(m * dot(w[0], t))
        c0 = let(4.0 * m * dot(g[0], t))
        c1 = let(4.0 * m * dot(w[0], t1))
        c2 = let(4.0 * m * dot(w[0], t2))
        for i in range(3):
            a = let(w[0][i] * v + g[0][i] * c0)
            b1 = let(w[0][i] * c1)
            b2 = let(w[0][i] * c2)
            for j in range(3):
                p = let(w[1][j] * a + g[1][j] * b1)
                r = let(w[1][j] * b2)
                for k in range(3):
                    n = 27 * i + 9 * j + 3 * k + d
                    put(out[n], out[n] + w[2][k] * p + g[2][k] * r)


@unrolled
def dot(a, b):
    """a_0 b_0 + a_1 b_1 + a_2 b_2."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@ti.func
def group_energy(
    body: ti.template(), group, out: ti.template(), law: ti.template(), ih, converged,
    options: ti.template(),
):  # fmt: skip
    """out[8 group + lane] = sum_p V0 psi(F_p) of a cell."""
    q = gather(body, body.u, group)
    differences(q)
    total = q[0] * 0.0
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle(body, b)
        F = strain(body, b, q, s, h, ih, options)
        if ti.static(options.clamped):
            clip(body, b, F, False)
        total += body.V0[b] * law.psi(F, body.mu[b], body.lam[b], converged)
    for lane in ti.static(range(LANES)):
        out[group * LANES + lane] = total[lane]


@ti.func
def group_von_mises(
    body: ti.template(), group, out: ti.template(), law: ti.template(), ih, converged,
    options: ti.template(),
):  # fmt: skip
    """out[8 b + lane] = von Mises of each particle of eight cells."""
    q = gather(body, body.u, group)
    differences(q)
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        s, h = middle(body, b)
        F = strain(body, b, q, s, h, ih, options)
        if ti.static(options.clamped):
            clip(body, b, F, False)
        P = law.pk1(F, body.mu[b], body.lam[b], converged)
        if ti.static(options.capped):
            cut(body, b, P, False)
        value = von_mises(P, F)
        for lane in ti.static(range(LANES)):
            out[b * LANES + lane] = value[lane]
