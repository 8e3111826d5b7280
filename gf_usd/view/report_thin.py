"""What is left out so that a page stays small: frames, vertices, Gaussians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats, Ints

STEPS = 40  # halvings of the interval of cell sizes; a double has no more than 53


def spread(count: int, most: int) -> NDArray[np.int64]:
    """Up to `most` of 0..count-1, evenly spread, first and last included."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(np.int64))


def sample(count: int, most: int) -> NDArray[np.int64]:
    """Up to `most` of 0..count-1 at random, ascending, the same every time."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def cluster(
    points: Floats, triangles: Ints, part: Ints, most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Thin a mesh by vertex clustering [Rossignac and Borrel 1993].

    Vertices of one part, in one cell of a grid and facing the same octant become one: the vertex
    nearest to their mean, which keeps its own motion.  The cell is the smallest that leaves no
    more than `most`.

    Parameters
    ----------
    points : (V, 3).   triangles : (T, 3).   part : (V,) vertices of different parts stay apart.

    Returns
    -------
    kept : (K,) vertices that are left.   corners : (S, 3) triangles into `kept`.
    faces : (S,) which triangle each was.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) <= most:
        return np.arange(len(points)), np.asarray(triangles), np.arange(len(triangles))
    octant = _octants(points, triangles)
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    fine, coarse = 0.0, size

    def group(cell: float) -> NDArray[np.int64]:
        index = np.floor((points - low) / cell).astype(np.int64)
        rows = np.column_stack([index, np.asarray(part), octant])
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)

    label = group(coarse)
    for _ in range(STEPS):
        middle = 0.5 * (fine + coarse)
        found = group(middle)
        count = int(found.max()) + 1
        if count <= most:
            coarse, label = middle, found
            if count > 0.9 * most:
                break
        else:
            fine = middle
    kept = _nearest_to_mean(points, label)
    corners = label[np.asarray(triangles)]
    a, b, c = corners.T
    faces = np.flatnonzero((a != b) & (b != c) & (c != a))
    # of triangles on the same three vertices the first is enough
    _, first = np.unique(np.sort(corners[faces], axis=1), axis=0, return_index=True)
    faces = faces[np.sort(first)]
    return kept, corners[faces], faces


def _octants(points: Floats, triangles: Ints) -> NDArray[np.int64]:
    """(V,) 0..7: signs of the vertex normals, so that the two sides of a thin wall stay apart."""
    corners = points[np.asarray(triangles)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, np.asarray(triangles)[:, corner], normal)
    return (total > 0.0).astype(np.int64) @ np.array([1, 2, 4])


def _nearest_to_mean(points: Floats, label: Ints) -> NDArray[np.int64]:
    """(K,) the member of each group that is nearest to the group's mean."""
    size = np.bincount(label)
    mean = np.stack([np.bincount(label, points[:, i]) for i in range(3)], axis=1) / size[:, None]
    away = np.linalg.norm(points - mean[label], axis=1)
    order = np.lexsort((away, label))
    return order[np.concatenate([[0], np.cumsum(size)[:-1]])]
