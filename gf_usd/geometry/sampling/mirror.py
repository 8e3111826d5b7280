"""Detection of a body's axis-aligned mirror planes through the center of its bounding box."""

from __future__ import annotations

from collections.abc import Sequence

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree

SAME = 1e-6  # of the diagonal: rounding of float32 points and unit conversion


def mirror_axes(parts: Sequence[tuple[Floats, Ints]], tolerance: float) -> NDArray[np.bool_]:
    """(3,) whether the body is symmetric across the mirror plane normal to each axis.

    Vertices are compared up to rounding, triangles up to a tolerance [m], since mirrored polygons
    may be triangulated along different diagonals.
    parts : points (V, 3) [m] and triangles (T, 3) of each surface.
    """
    used = [np.unique(triangles) for _, triangles in parts]
    points = np.concatenate([p[u] for (p, _), u in zip(parts, used)])
    low, high = points.min(0), points.max(0)
    middle, same = 0.5 * (low + high), SAME * float(np.linalg.norm(high - low))
    points = points - middle
    tree = kd_tree(points)
    out = np.zeros(3, bool)
    for axis in range(3):
        flip = np.where(np.arange(3) == axis, -1.0, 1.0)
        apart = tree.query(points * flip, distance_upper_bound=2.0 * same)[0]
        out[axis] = (apart <= same).all() and _same_surface(parts, middle, flip, tolerance)
    return out


def _same_surface(
    parts: Sequence[tuple[Floats, Ints]], middle: Floats, flip: Floats, tolerance: float
) -> bool:
    """Whether the mirrored centroids of the triangles lie on the surface."""
    points = np.concatenate([p for p, _ in parts]) - middle
    first = np.cumsum([0, *(len(p) for p, _ in parts)])
    faces = np.concatenate([t + o for (_, t), o in zip(parts, first)])
    squared = igl.point_mesh_squared_distance(points[faces].mean(1) * flip, points, faces)[0]
    return bool((np.asarray(squared) <= tolerance**2).all())
