"""Detection of a body's axis-aligned mirror planes through the center of its bounding box."""

from __future__ import annotations

from collections.abc import Sequence

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree

SAME = 1e-6  # of the diagonal: rounding of float32 points and unit conversion
FEW = 256  # points that are compared before all are


def mirror_axes(parts: Sequence[tuple[Floats, Ints]], tolerance: float) -> NDArray[np.bool_]:
    """(3,) whether the body is symmetric across the mirror plane normal to each axis.

    Vertices are compared up to rounding, triangles up to a tolerance [m], since mirrored polygons
    may be triangulated along different diagonals.
    parts : points (V, 3) [m] and triangles (T, 3) of each surface.
    """
    used = [np.unique(triangles) for _, triangles in parts]
    points = np.concatenate([p[u] for (p, _), u in zip(parts, used)])
    first = np.cumsum([0, *map(len, used)])
    faces = np.concatenate(
        [np.searchsorted(u, t) + k for (_, t), u, k in zip(parts, used, first)], dtype=np.int64
    )
    low, high = points.min(0), points.max(0)
    middle, same = 0.5 * (low + high), SAME * float(np.linalg.norm(high - low))
    points = points - middle
    tree = kd_tree(points)
    few = points[:: max(1, len(points) // FEW)]  # exclude most bodies that are not symmetric
    out = np.zeros(3, bool)
    for axis in range(3):
        flip = np.where(np.arange(3) == axis, -1.0, 1.0)
        if (tree.query(few * flip, distance_upper_bound=2.0 * same)[0] > same).any():
            continue
        apart, image = tree.query(points * flip, distance_upper_bound=2.0 * same)
        out[axis] = (apart <= same).all() and _same_surface(points, faces, flip, image, tolerance)
    return out


def _same_surface(points: Floats, faces: Ints, flip: Floats, image: Ints, tolerance: float) -> bool:
    """Whether the mirrored centroids of the triangles lie on the surface.

    image : (V,) the point at which each mirrored one lies: most meshes that are symmetric have
    the mirrored triangles, too, and only the distances of others are computed.
    """
    others = faces[~_are_among(image[faces], faces)]
    if not len(others):
        return True
    squared = igl.point_mesh_squared_distance(points[others].mean(1) * flip, points, faces)[0]
    return bool((np.asarray(squared) <= tolerance**2).all())


def _are_among(some: Ints, faces: Ints) -> NDArray[np.bool_]:
    """(S,) whether triangles (S, 3) are among faces (T, 3), with corners in any order."""
    rows = np.sort(np.concatenate([some, faces]), axis=1)
    number = rows[:, 0]
    for column in rows[:, 1:].T:  # numbers of different rows are different, and below their count
        number = np.unique(number * (rows.max() + 1) + column, return_inverse=True)[1].reshape(-1)
    return np.isin(number[: len(some)], number[len(some) :])
