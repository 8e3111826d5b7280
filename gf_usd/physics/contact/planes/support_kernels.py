"""Kernel that chooses the support triangle of each point: see `support_triangles`."""

import taichi as ti

from gf_usd.physics.contact.distance.kernels import vector
from gf_usd.physics.taichi_arrays import on_arrays


@ti.func
def weigh(a, b, c):
    """Weights of the origin in a triangle, its height [m] and the triangle's shape measure, 0 to 1.

    The weights are the barycentric ones of the origin's projection; where the triangle has no area,
    the first corner has weight 1.
    """
    u, v = b - a, c - a
    uu, uv, vv = u.norm_sqr(), u.dot(v), v.norm_sqr()
    pu, pv = -a.dot(u), -a.dot(v)
    square = ti.max(uu * vv - uv * uv, 0.0)
    s, t = 0.0 * square, 0.0 * square
    if square > 0.0:
        s, t = (vv * pu - uv * pv) / square, (uu * pv - uv * pu) / square
    height = ti.sqrt(ti.max(a.norm_sqr() - s * pu - t * pv, 0.0))
    edges = 2.0 * (uu + vv - uv)
    fatness = 0.0 * square
    if edges > 0.0:
        fatness = 2.0 * ti.sqrt(3.0 * square) / edges
    return ti.Vector([1.0 - s - t, s, t]), height, fatness


@on_arrays
@ti.kernel
def choose_triangles(
    X: ti.types.ndarray(dtype=ti.f64, ndim=2),
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),
    near: ti.types.ndarray(dtype=ti.i32, ndim=2),
    fat: ti.f64,
    spread: ti.f64,
    samples: ti.types.ndarray(dtype=ti.i32, ndim=2),
    weights: ti.types.ndarray(dtype=ti.f64, ndim=2),
):
    """The samples among X (n, 3) [m] that carry points (k, 3) [m]: indices and weights (k, 3), the
    largest weight first.

    near : (k, 6) samples near each point; -1: no more. With fewer than three, the first is the only
    carrier. fat, spread : FAT and SPREAD of `support_triangles`.
    """
    for i in range(places.shape[0]):
        p = vector(places, i)
        count = 0
        for k in range(near.shape[1]):
            if near[i, k] >= 0:
                count += 1
        who = ti.Vector([near[i, 0], near[i, 0], near[i, 0]])
        w = ti.Vector([1.0 + 0.0 * p[0], 0.0 * p[0], 0.0 * p[0]])
        least = ti.math.inf + 0.0 * fat
        for j in range(count):
            a = vector(X, near[i, j]) - p
            for k in range(j + 1, count):
                b = vector(X, near[i, k]) - p
                for m in range(k + 1, count):
                    c = vector(X, near[i, m]) - p
                    share, height, fatness = weigh(a, b, c)
                    cost = height
                    for corner in ti.static(range(3)):
                        size = ti.max(share[corner], -share[corner])
                        cost += (size + spread / 3.0) * (a, b, c)[corner].norm()
                    cost /= fatness if fatness > fat else 1e-3 * fatness + 1e-12
                    if cost < least:
                        least, w = cost, share
                        who = ti.Vector([near[i, j], near[i, k], near[i, m]])
        for _ in range(2):
            for k in ti.static(range(2)):
                if w[k] < w[k + 1]:
                    larger, first = w[k + 1], who[k + 1]
                    w[k + 1], who[k + 1] = w[k], who[k]
                    w[k], who[k] = larger, first
        for k in ti.static(range(3)):
            samples[i, k], weights[i, k] = who[k], w[k]
