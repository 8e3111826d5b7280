"""Signed distance of points to triangles: exact, near the triangles only.

The sign is that of the angle-weighted pseudo-normal at the closest point (Baerentzen and Aanaes
2005, by libigl), so that a surface may be as fine or as deformed as it likes.  Where it is folded
onto itself or inside out, that sign is wrong, and how often it winds around a point counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints

ON_SURFACE = 1e-6  # of the reach: nearer, the direction to the surface is rounding
WOUND = 0.5  # winding numbers are whole but for the error of the fast sum: 0 outside, 1 within


@dataclass(frozen=True, kw_only=True)
class Closest:
    """The surface as some of a set of points see it."""

    rows: Ints  # (k,) which of the points are near
    gap: Floats  # (k,) [m] signed distance, negative inside
    triangle: Ints  # (k,)
    weights: Floats  # (k, 3) barycentric, of the closest point
    point: Floats  # (k, 3) [m] the closest point
    normal: Floats  # (k, 3) unit, out of the surface


def closest(X: Floats, points: Floats, triangles: Ints, reach: float) -> Closest:
    """Points X (n, 3) [m] no farther than reach [m] from triangles (T, 3) of points (V, 3) [m]."""
    low, high = X.min(0) - 2.0 * reach, X.max(0) + 2.0 * reach
    a, b, c = (points[triangles[:, k]] for k in range(3))
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    close = np.flatnonzero(((most >= low) & (least <= high)).all(1))
    if len(close) == 0:
        return _none()
    used, local = np.unique(triangles[close], return_inverse=True)
    center = X.mean(0)
    first, last = least[close].min(0) - reach, most[close].max(0) + reach
    asked = np.flatnonzero(((first <= X) & (last >= X)).all(1))
    if len(asked) == 0:
        return _none()
    S, at, C, N = igl.signed_distance(
        np.ascontiguousarray(X[asked] - center, dtype=float),
        np.ascontiguousarray(points[used] - center, dtype=float),
        np.ascontiguousarray(local.reshape(-1, 3), dtype=np.int64),
        sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL,
        lower_bound=-reach,  # what is farther off is not looked for: its distance is nan
        upper_bound=reach,
    )
    gap, at = np.asarray(S).reshape(-1), np.asarray(at).reshape(-1)
    near = np.flatnonzero(np.abs(gap) < reach)
    gap, at, point, rows = gap[near], close[at[near]], np.asarray(C)[near] + center, asked[near]
    away = X[rows] - point
    on = np.linalg.norm(away, axis=1) <= ON_SURFACE * reach
    away[on] = np.asarray(N)[near][on]
    # The direction to the closest point is that of the distance's gradient, up to its sign.
    away *= np.where(on | (gap > 0.0), 1.0, -1.0)[:, None]
    length = np.linalg.norm(away, axis=1, keepdims=True)
    return Closest(
        rows=rows,
        gap=gap,
        triangle=at,
        weights=barycentric(point, points[triangles[at]]),
        point=point,
        normal=away / np.where(length > 0.0, length, 1.0),
    )


def outside_where_unwound(
    seen: Closest, inside: Ints, X: Floats, points: Floats, triangles: Ints, *, shell: bool = False
) -> Closest:
    """`seen` with those of its rows `inside` outside around which the surface does not wind.

    X : (n, 3) [m] that `seen.rows` are of; points (V, 3) [m], triangles (T, 3) : all of a closed
    surface.  Its winding number (Jacobson et al. 2013; summed fast as Barill et al. 2018, by
    libigl) is 1 inside, 2 where it overlaps itself, 0 outside, -1 in a lobe that is inside out.
    shell : the triangles are those of a `shell`, whose winding number `crossings` counts.
    """
    asked = np.ascontiguousarray(X[seen.rows[inside]], dtype=float)
    if shell:
        turns = crossings(asked, points, triangles)
    else:
        turns = igl.fast_winding_number(
            np.ascontiguousarray(points, dtype=float),
            np.ascontiguousarray(triangles, dtype=np.int64),
            asked,
        )
    side = np.ones(len(seen.gap))
    side[inside[np.asarray(turns).reshape(-1) < WOUND]] = -1.0
    return replace(seen, gap=side * seen.gap, normal=side[:, None] * seen.normal)


WELD = 1e-9  # of the extent: vertices nearer to each other are one
PAIRS = 20_000_000  # of points and triangles whose boxes are compared at once


def shell(points: Floats, triangles: Ints) -> tuple[Ints, Ints] | None:
    """A surface without borders: the vertices that stand for all, and the triangles of these.

    None where it has borders: every edge has to be there as often one way as the other.
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
    """(m,) how often a shell winds around points P (m, 3): crossings of a ray along x, by sign.

    Every edge is seen the same way by all its triangles, so that a ray through it crosses one.
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
    """Of lines along x through P (n, 3) and triangles t (n, 3): 1, 0 or -1 and where they cross."""
    a, b = t[:, [1, 2, 0]], t[:, [2, 0, 1]]  # the edges opposite to each corner
    turned = a > b
    first, last = np.where(turned, b, a), np.where(turned, a, b)
    y, z = points[:, 1], points[:, 2]
    dy, dz = y[last] - y[first], z[last] - z[first]
    side = dy * (P[:, 2:] - z[first]) - dz * (P[:, 1:2] - y[first])
    # On its line a point counts for one side, the same for every triangle of the edge.
    positive = (side > 0.0) | (side == 0.0) & ((dz > 0.0) | (dz == 0.0) & (dy > 0.0))
    left = positive != turned
    sign = np.where(left.all(1), 1.0, np.where(left.any(1), 0.0, -1.0))
    weight = np.abs(side)
    total = weight.sum(1)
    x = (weight * points[t, 0]).sum(1) / np.where(total > 0.0, total, 1.0)
    return sign, x


def above_plane(X: Floats, corners: Floats, reach: float) -> Closest:
    """The same for the half space under the triangle of corners (3, 3) [m]; inside has no end."""
    a, b, c = corners
    n = np.cross(b - a, c - a)
    n = n / np.linalg.norm(n)
    gap = (X - a) @ n
    rows = np.flatnonzero(gap < reach)
    point = X[rows] - gap[rows, None] * n
    return Closest(
        rows=rows,
        gap=gap[rows],
        triangle=np.zeros(len(rows), np.int64),
        weights=barycentric(point, np.broadcast_to(corners, (len(rows), 3, 3))),
        point=point,
        normal=np.broadcast_to(n, (len(rows), 3)),
    )


def barycentric(P: Floats, corners: Floats) -> Floats:
    """(n, 3) weights of points (n, 3) in the planes of their triangles (n, 3, 3)."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = P - a
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    wu, wv = (w * u).sum(1), (w * v).sum(1)
    det = uu * vv - uv * uv
    det = np.where(det > 0.0, det, 1.0)
    s, t = (vv * wu - uv * wv) / det, (uu * wv - uv * wu) / det
    return np.stack([1.0 - s - t, s, t], 1)


def _none() -> Closest:
    whole, three = np.zeros(0, np.int64), np.zeros((0, 3))
    return Closest(
        rows=whole, gap=np.zeros(0), triangle=whole, weights=three, point=three, normal=three
    )
