"""Which surfaces make one body: those that overlap or touch at rest.

What is modeled of parts, a duck with its beak, falls as one, and so does what a physics body of the
stage holds together.  What lies apart are bodies of their own, that meet only by contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import igl
import numpy as np

from gf_usd.geometry.solid import INSIDE, Solid
from gf_usd.model import Floats, Ints
from gf_usd.nearby import components
from gf_usd.sparse import coo_matrix

FINEST = 64  # parts of an edge: the walls of a hall need no more
TOUCHING = 0.25  # [spacings] nearer than this, surfaces count as touching


def find_bodies(
    solid: Solid, spacing: float, *, owners: Sequence[str] = (), combine: bool = False
) -> Ints:
    """Body of each surface (S,), numbered from 0 in the order of the surfaces.

    spacing : [m] of the particles; owners : what each surface belongs to, "" for nothing: what has
    the same owner is one body; combine : one body in all.
    """
    count = len(solid.surfaces)
    if combine or count == 1:
        return np.zeros(count, np.int64)
    reach = TOUCHING * spacing
    points = [
        np.concatenate([s.points[np.unique(t)], spread(s.points, t, spacing)])
        for s, t in zip(solid.surfaces, solid.triangles)
    ]
    owners = owners or [""] * count
    low = np.array([p.min(0) for p in points]) - reach
    high = np.array([p.max(0) for p in points]) + reach
    close: Any = ((low[:, None] <= high) & (low <= high[:, None])).all(2)
    joined = [
        (a, b)
        for a in range(count)
        for b in range(a + 1, count)
        if owners[a] == owners[b] != ""
        or (
            close[a, b]
            and (_meets(points[a], solid, b, reach) or _meets(points[b], solid, a, reach))
        )
    ]
    one, two = np.array(joined, int).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(count, count))
    label = components(graph)[1]
    _, first = np.unique(label, return_index=True)
    return np.argsort(np.argsort(first))[label]


def spread(points: Floats, triangles: Ints, spacing: float) -> Floats:
    """Points (n, 3) [m] on triangles, no farther than about a spacing [m] from each other."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    parts = np.minimum(np.ceil(longest / spacing), FINEST).astype(int)
    out = []
    for n in np.unique(parts[parts > 1]):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        u = np.stack([i, j], -1)[i + j <= n] / n
        mine = parts == n
        out.append(a[mine, None] + u[:, :1] * (b - a)[mine, None] + u[:, 1:] * (c - a)[mine, None])
    return np.concatenate([one.reshape(-1, 3) for one in out]) if out else np.zeros((0, 3))


def _meets(X: Floats, solid: Solid, surface: int, reach: float) -> bool:
    """Whether a point (n, 3) [m] lies in a surface or within reach [m] of it."""
    points, triangles = solid.surfaces[surface].points, solid.triangles[surface]
    centre = points.mean(0)
    near = ((points.min(0) - reach <= X) & (points.max(0) + reach >= X)).all(1)
    if not near.any():
        return False
    X, points = np.ascontiguousarray(X[near] - centre), np.ascontiguousarray(points - centre)
    squared = igl.point_mesh_squared_distance(X, points, triangles)[0]
    if np.asarray(squared).min() <= reach**2:
        return True
    w = igl.fast_winding_number(points, triangles, X)
    return bool((np.abs(np.asarray(w)) > INSIDE).any())
