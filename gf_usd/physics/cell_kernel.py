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
    spline,
    spread,
)


@ti.func
def strain(body: ti.template(), b, u: ti.template(), s: ti.template(), h: ti.template(), ih,
           options: ti.template()):  # fmt: skip
    """F = F0 + sum_i u_i (x) G_ip of one batch; F0 = I, or what `reanchor` left; ih = 1/h."""
    F = gradient(u, s, h)
    for a in ti.static(range(9)):
        F[a] = F[a] * (0.5 * ih)
    if ti.static(options.anchored):
        for a in ti.static(range(9)):
            F[a] = F[a] + body.F0[9 * b + a]
    else:
        for a in ti.static(range(3)):
            F[4 * a] = F[4 * a] + 1.0
    return F


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
    zero = u[0] * 0.0
    out = [zero for n in ti.static(range(81))]
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
            for a in ti.static(range(3)):
                for c in ti.static(range(3)):
                    e = k * (F[a] * D[c] + F[3 + a] * D[3 + c] + F[6 + a] * D[6 + c])
                    # e_ac enters sym twice: F (e + e^T).
                    for r in ti.static(range(3)):
                        P[3 * r + c] = P[3 * r + c] + F[3 * r + a] * e
                        P[3 * r + a] = P[3 * r + a] + F[3 * r + c] * e
        if ti.static(options.capped):
            cut(body, b, P, True)
        k = (0.0 - 0.5 * ih) * body.V0[b]
        for a in ti.static(range(9)):
            P[a] = k * P[a]
        spread(P, s, h, out)
    differences_transposed(out)
    for n in ti.static(range(81)):
        body.block[81 * group + n] = out[n]


@ti.func
def filter_group(body: ti.template(), group):
    """m (v_p + C_p dX) of the particles of eight cells into their block: eq. 3 then eq. 1.

    v_p = sum w v_i and C_p = 4/h^2 sum w v_i (x) dX; with dX in cells the h cancels.
    """
    q = gather(body, body.v, group)
    zero = q[0] * 0.0
    out = [zero for n in ti.static(range(81))]
    for b in range(body.group_batch[group], body.group_batch[group + 1]):
        f0 = body.fx[3 * b]
        f1 = body.fx[3 * b + 1]
        f2 = body.fx[3 * b + 2]
        w = [spline(f0), spline(f1), spline(f2)]
        m = body.m[b]
        for d in ti.static(range(3)):
            v = zero
            c0 = zero
            c1 = zero
            c2 = zero
            for i in ti.static(range(3)):
                t = zero
                tj = zero
                tk = zero
                for j in ti.static(range(3)):
                    o = ti.static(3 * (9 * i + 3 * j) + d)
                    q0 = w[2][0] * q[o]
                    q1 = w[2][1] * q[o + 3]
                    q2 = w[2][2] * q[o + 6]
                    s = w[1][j] * (q0 + q1 + q2)
                    t += s
                    tj += (float(j) - f1) * s
                    tk += w[1][j] * ((1.0 - f2) * q1 + (2.0 - f2) * q2 - f2 * q0)
                v += w[0][i] * t
                c0 += w[0][i] * (float(i) - f0) * t
                c1 += w[0][i] * tj
                c2 += w[0][i] * tk
            for i in ti.static(range(3)):
                a = m * w[0][i] * (v + 4.0 * (float(i) - f0) * c0)
                e = 4.0 * m * w[0][i]
                for j in ti.static(range(3)):
                    p = w[1][j] * (a + e * (float(j) - f1) * c1)
                    r = w[1][j] * e * c2
                    for k in ti.static(range(3)):
                        n = ti.static((9 * i + 3 * j + k) * 3 + d)
                        out[n] = out[n] + w[2][k] * (p + (float(k) - f2) * r)
    for n in ti.static(range(81)):
        body.block[81 * group + n] = out[n]


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
