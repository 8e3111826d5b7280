"""Comparison of all pairs of patches of a surface: see `Patches.pairs`.

A patch needs sums over its samples, and a pair some fifty operations, which in NumPy are a hundred
passes over short arrays.
"""

import taichi as ti

from gf_usd.physics.contact.distance.kernels import vector
from gf_usd.physics.contact.self_contact.patch_tables import (
    CENTER,
    CHANGE,
    COSINE,
    CREASE,
    FOLD,
    FOLD_TIME,
    FOLDS,
    GAP,
    MEAN,
    NEIGHBORS,
    NORMAL,
    OPPOSED,
    RADIUS,
    RATE,
    SPREAD,
    TURNED,
    UNTIL,
)
from gf_usd.physics.taichi_arrays import on_arrays

Reals = ti.types.ndarray(dtype=ti.f64, ndim=2)
Numbers = ti.types.ndarray(dtype=ti.f64, ndim=1)
Pairs = ti.types.ndarray(dtype=ti.i32, ndim=2)
Whole = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.func
def facing_cosine(away, one, other):
    """Cosine between the normals of two patches and the line of their centers, the lesser of
    both."""
    return ti.min(away.dot(one), -away.dot(other)) / ti.max(away.norm(), 1e-30)


@ti.func
def unit(n):
    length = n.norm()
    return n / length if length > 0.0 else n


@ti.func
def closing_rate(away, distance, relative):
    """`patches.closing` of one pair."""
    along = away.dot(relative) / ti.max(distance, 1e-30)
    return ti.max(-along, 0.0) + CHANGE * relative.norm()


@ti.func
def put(A: ti.template(), i, first: ti.template(), value):
    for a in ti.static(range(3)):
        A[i, first + a] = value[a]


@on_arrays
@ti.kernel
def compare_patches(
    x: Reals, v: Reals, order: Whole, start: Whole, slopes: Reals, members: Pairs, kind: Whole,
    at_rest: Numbers, see: ti.f64, time: ti.f64, patches: Reals, pairs: Reals, near: Whole,
):  # fmt: skip
    """Shapes and motions of p patches, and gaps, rates, cosines and times of P pairs of them.

    x, v : (n, 3) [m], [m/s] of the samples; order (n,), start (p + 1,) : the samples of each patch;
    slopes : (n, 2) of the samples in this order, weights of the least squares of both tangents;
    members : (P, 2) patches; kind, at_rest : (P,) flags of pairs, and cosines at rest; see : [m];
    time : [s] of the finite difference, 0: none; patches, pairs : tables, see `patch_tables`;
    near : (P,) whether samples of the two may be in contact.
    """
    for p in range(patches.shape[0]):
        share = 1.0 / ti.cast(start[p + 1] - start[p], ti.f64)
        zero = 0.0 * ti.Vector([see, see, see])
        c, mean, along, across, along_rate, across_rate = zero, zero, zero, zero, zero, zero
        for e in range(start[p], start[p + 1]):
            X, V = vector(x, order[e]), vector(v, order[e])
            c += share * X
            mean += share * V
            along += slopes[e, 0] * X
            across += slopes[e, 1] * X
            along_rate += slopes[e, 0] * V
            across_rate += slopes[e, 1] * V
        radius, spread = 0.0 * see, 0.0 * see
        for e in range(start[p], start[p + 1]):
            radius = ti.max(radius, (vector(x, order[e]) - c).norm_sqr())
            spread = ti.max(spread, (vector(v, order[e]) - mean).norm_sqr())
        put(patches, p, CENTER, c)
        put(patches, p, NORMAL, unit(along.cross(across)))
        put(patches, p, MEAN, mean)
        later = (along + time * along_rate).cross(across + time * across_rate)
        put(patches, p, TURNED, unit(later))
        patches[p, RADIUS], patches[p, SPREAD] = ti.sqrt(radius), ti.sqrt(spread)
    for k in range(pairs.shape[0]):
        i, j = members[k, 0], members[k, 1]
        away = vector(patches, j, CENTER) - vector(patches, i, CENTER)
        relative = vector(patches, j, MEAN) - vector(patches, i, MEAN)
        distance = away.norm()
        gap = distance - patches[i, RADIUS] - patches[j, RADIUS]
        rate = closing_rate(away, distance, relative)
        rate += (1.0 + CHANGE) * (patches[i, SPREAD] + patches[j, SPREAD])
        cosine = facing_cosine(away, vector(patches, i, NORMAL), vector(patches, j, NORMAL))
        unfolded = (kind[k] & FOLDS) != 0 and cosine <= at_rest[k] + FOLD
        close = gap < see and not unfolded
        if (kind[k] & NEIGHBORS) == 0 and cosine <= -OPPOSED:
            close = False
        until = ti.max(gap - 0.5 * see, 0.5 * see) / ti.max(rate, 1e-30)
        fold = ti.math.inf + 0.0 * see
        if close:
            until = 0.0 * see
        if unfolded:
            until = ti.math.inf + 0.0 * see
            if gap < see and time > 0.0:
                one, other = vector(patches, i, TURNED), vector(patches, j, TURNED)
                turned = facing_cosine(away + time * relative, one, other) - cosine
                fold = (at_rest[k] + CREASE - cosine) * time / ti.max(turned, 1e-30)
        pairs[k, GAP], pairs[k, RATE], pairs[k, COSINE] = gap, rate, cosine
        pairs[k, UNTIL], pairs[k, FOLD_TIME] = until, fold / (1.0 + CHANGE)
        near[k] = ti.cast(close, ti.i32)
