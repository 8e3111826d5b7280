"""Signed distance of points to triangles: exact, within a reach.

The sign is that of the angle-weighted pseudo-normal at the closest point (Baerentzen and Aanaes
2005, from libigl), which does not depend on the resolution or deformation of the surface. Where the
surface is folded onto itself or inverted, that sign is wrong, and `winding` corrects it.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross

ON_SURFACE = 1e-6  # of the reach: at a smaller distance the direction is rounding

# Columns of the results of `self_contact.search_kernels` per sample: reals, and integers.
NORMAL, WEIGHTS, PSEUDO, LEAST, FOUND = 0, 3, 6, 9, 10
SEED, TRIANGLE, TIES, WHICH = 0, 1, 2, 3
LOOKS, WANTED = 0, 1  # and columns of its flags

# Columns of the table of a `SurfaceTree`: where the leaves, boxes, triangles and neighbors of each
# surface begin, how many leaves and triangles it has, and whether its boxes are to be refitted.
FIRST_LEAF, LEAVES, BOXES, TRIANGLES, FACES, AROUND, MOVED, COLUMNS = 0, 1, 2, 3, 4, 5, 6, 7


@dataclass(frozen=True, kw_only=True)
class Closest:
    """The closest points of a surface to some of a set of points."""

    rows: Ints  # (k,) indices of the points within reach
    gap: Floats  # (k,) [m] signed distance, negative inside
    triangle: Ints  # (k,)
    weights: Floats  # (k, 3) barycentric, of the closest point
    point: Floats  # (k, 3) [m] the closest point
    normal: Floats  # (k, 3) outward unit normal


def closest(X: Floats, points: Floats, triangles: Ints, reach: float) -> Closest:
    """Closest points for X (n, 3) [m] within reach [m] of triangles (T, 3) of points (V, 3) [m]."""
    low, high = X.min(0) - 2.0 * reach, X.max(0) + 2.0 * reach
    a, b, c = (points[triangles[:, k]] for k in range(3))
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    close = np.flatnonzero(((most >= low) & (least <= high)).all(1))
    if len(close) == 0:
        return no_points()
    used, local = np.unique(triangles[close], return_inverse=True)
    center = X.mean(0)
    first, last = least[close].min(0) - reach, most[close].max(0) + reach
    in_box = np.flatnonzero(((first <= X) & (last >= X)).all(1))
    if len(in_box) == 0:
        return no_points()
    S, at, C, N = igl.signed_distance(
        np.ascontiguousarray(X[in_box] - center, dtype=float),
        np.ascontiguousarray(points[used] - center, dtype=float),
        np.ascontiguousarray(local.reshape(-1, 3), dtype=np.int64),
        sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL,
        lower_bound=-reach,  # beyond it the distance is nan
        upper_bound=reach,
    )
    gap, at = np.asarray(S).reshape(-1), np.asarray(at).reshape(-1)
    near = np.flatnonzero(np.abs(gap) < reach)
    gap, at, point, rows = gap[near], close[at[near]], np.asarray(C)[near] + center, in_box[near]
    away = X[rows] - point
    on = np.linalg.norm(away, axis=1) <= ON_SURFACE * reach
    away[on] = np.asarray(N)[near][on]
    # The direction to the closest point is the gradient of the distance, up to its sign.
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


def above_plane(X: Floats, corners: Floats, reach: float) -> Closest:
    """The same for the half space below the plane of a triangle with corners (3, 3) [m]."""
    a, b, c = corners
    n = cross(b - a, c - a)
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


def no_points() -> Closest:
    """A result without points."""
    whole, three = np.zeros(0, np.int64), np.zeros((0, 3))
    return Closest(
        rows=whole, gap=np.zeros(0), triangle=whole, weights=three, point=three, normal=three
    )
