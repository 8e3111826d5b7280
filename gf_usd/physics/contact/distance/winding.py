"""Winding numbers of surfaces, which correct the sign of the distance.

The sign by the pseudo-normal is that of the nearest triangle, which is wrong at folds and inverted
parts.
"""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.distance.closest import Closest

WOUND = 0.5  # threshold between the winding numbers 0 outside and 1 inside


def outside_by_winding(
    seen: Closest, inside: Ints, X: Floats, points: Floats, triangles: Ints, *, shell: bool = False
) -> Closest:
    """`seen`, with its rows `inside` set to outside where the winding number is not positive.

    X : (n, 3) [m] points that `seen.rows` refers to; points (V, 3) [m], triangles (T, 3) : a closed
    surface. Its winding number (Jacobson et al. 2013; fast evaluation by Barill et al. 2018, from
    libigl) is 1 inside, 2 where it overlaps itself, 0 outside, -1 in an inverted part.
    shell : the triangles are those of a `shell`, whose winding number `crossings` computes.
    """
    points_inside = np.ascontiguousarray(X[seen.rows[inside]], dtype=float)
    if shell:
        turns = crossings(points_inside, points, triangles)
    else:
        turns = igl.fast_winding_number(
            np.ascontiguousarray(points, dtype=float),
            np.ascontiguousarray(triangles, dtype=np.int64),
            points_inside,
        )
    side = np.ones(len(seen.gap))
    side[inside[np.asarray(turns).reshape(-1) < WOUND]] = -1.0
    return replace(seen, gap=side * seen.gap, normal=side[:, None] * seen.normal)


WELD = 1e-9  # of the extent: nearer vertices are merged
PAIRS = 20_000_000  # pairs of points and triangles compared at once


def shell(points: Floats, triangles: Ints) -> tuple[Ints, Ints] | None:
    """A surface without borders: a representative of each group of merged vertices, and the
    triangles.

    None where it has borders: every edge must occur equally often in both directions.
    """
    cell = WELD * max(float(np.ptp(points, axis=0).max()), 1e-30)
    _, first, of = np.unique(
        np.round(points / cell).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    welded = of.reshape(-1)[triangles]
    start, end = welded.ravel(), np.roll(welded, -1, axis=1).ravel()
    n = len(first)
    way = np.sign(end - start)
    key = np.minimum(start, end) * n + np.maximum(start, end)
    _, edge = np.unique(key, return_inverse=True)
    if np.bincount(edge.reshape(-1), way).any():
        return None
    return first, welded


def crossings(P: Floats, points: Floats, triangles: Ints) -> Ints:
    """(m,) winding number of a shell at points P (m, 3): signed crossings of a ray along x.

    An edge is evaluated identically for all its triangles, so that a ray through it crosses one.
    """
    a, b, c = (points[triangles[:, k]] for k in range(3))
    low = np.minimum(np.minimum(a, b), c)
    high = np.maximum(np.maximum(a, b), c)
    out = np.zeros(len(P), np.int64)
    step = max(1, PAIRS // max(1, len(triangles)))
    for k in range(0, len(P), step):
        p = P[k : k + step, None]
        over = (p[..., 1] >= low[:, 1]) & (p[..., 1] <= high[:, 1])
        over &= (p[..., 2] >= low[:, 2]) & (p[..., 2] <= high[:, 2]) & (p[..., 0] <= high[:, 0])
        i, t = np.nonzero(over)
        sign, x = _through(P[k + i], points, triangles[t])
        ahead = x > P[k + i, 0]
        out[k : k + step] += np.bincount(i[ahead], sign[ahead], len(p)).astype(np.int64)
    return out


def _through(P: Floats, points: Floats, t: Ints) -> tuple[Floats, Floats]:
    """For lines along x through P (n, 3) and triangles t (n, 3): 1, 0 or -1, and the crossing
    points.
    """
    a, b = t[:, [1, 2, 0]], t[:, [2, 0, 1]]  # the edge opposite to each corner
    turned = a > b
    first, last = np.where(turned, b, a), np.where(turned, a, b)
    y, z = points[:, 1], points[:, 2]
    dy, dz = y[last] - y[first], z[last] - z[first]
    side = dy * (P[:, 2:] - z[first]) - dz * (P[:, 1:2] - y[first])
    # A point on the line of an edge is assigned to one side, the same for all its triangles.
    positive = (side > 0.0) | (side == 0.0) & ((dz > 0.0) | (dz == 0.0) & (dy > 0.0))
    left = positive != turned
    sign = np.where(left.all(1), 1.0, np.where(left.any(1), 0.0, -1.0))
    weight = np.abs(side)
    total = weight.sum(1)
    x = (weight * points[t, 0]).sum(1) / np.where(total > 0.0, total, 1.0)
    return sign, x
