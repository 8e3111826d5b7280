"""Detection of a body's axis-aligned mirror planes through the center of its bounding box."""

from __future__ import annotations

from collections.abc import Sequence

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.mesh.topology import used_points
from gf_usd.core.neighbors import kd_tree

SAME = 1e-6  # of the diagonal: rounding of float32 points and unit conversion
FEW, VERY_FEW = 256, 8  # points that are compared before all are


def mirror_axes(parts: Sequence[tuple[Floats, Ints]], tolerance: float) -> NDArray[np.bool_]:
    """(3,) whether the body is symmetric across the mirror plane normal to each axis.

    Vertices are compared up to rounding, triangles up to a tolerance [m], since mirrored polygons
    may be triangulated along different diagonals.
    parts : points (V, 3) [m] and triangles (T, 3) of each surface.
    """
    used = [used_points(triangles) for _, triangles in parts]
    points = np.concatenate([p[u] for (p, _), (u, _) in zip(parts, used)])
    low, high = points.min(0), points.max(0)
    middle, same = 0.5 * (low + high), SAME * float(np.linalg.norm(high - low))
    points = points - middle
    few = points[:: max(1, len(points) // FEW)]  # exclude most bodies that are not symmetric
    out = np.zeros(3, bool)
    possible = [axis for axis in range(3) if not _clearly_not(points, axis, 3.0 * same)]
    if not possible:
        return out
    first = np.cumsum([0, *(len(u) for u, _ in used)])
    faces = np.concatenate([local + k for (_, local), k in zip(used, first)])
    tree = kd_tree(points)
    for axis in possible:
        flip = np.where(np.arange(3) == axis, -1.0, 1.0)
        if (tree.query(few * flip, distance_upper_bound=2.0 * same)[0] > same).any():
            continue
        apart, image = tree.query(points * flip, distance_upper_bound=2.0 * same)
        out[axis] = (apart <= same).all() and _same_surface(points, faces, flip, image, tolerance)
    return out


def _clearly_not(points: Floats, axis: int, same: float) -> bool:
    """Whether the mirror image of one of VERY_FEW points has no point within `same` [m].

    A tree of all points takes a hundred times as long.
    """
    columns = np.ascontiguousarray(points.T)
    for at in points[:: max(1, len(points) // VERY_FEW)]:
        image = np.where(np.arange(3) == axis, -1.0, 1.0) * at
        near = np.flatnonzero(np.abs(columns[axis] - image[axis]) <= same)
        if not (np.abs(points[near] - image) <= same).all(1).any():
            return True
    return False


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
