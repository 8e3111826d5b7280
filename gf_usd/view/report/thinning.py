"""Thinning of frames, vertices and Gaussians, which bounds the size of a page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints

MAX_BISECTIONS = 40  # of the bisection of the cell size; float64 has 53 bits


def evenly_spaced(count: int, most: int) -> NDArray[np.int64]:
    """Up to `most` of 0..count - 1, evenly spaced, including the first and the last."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(np.int64))


def random_subset(count: int, most: int) -> NDArray[np.int64]:
    """A random subset of 0..count - 1 of at most `most` numbers, ascending; deterministic."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def cluster_vertices(
    points: Floats, triangles: Ints, part: Ints, most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Thin a mesh by vertex clustering [Rossignac and Borrel 1993].

    Vertices of one part, one grid cell and one octant of normals are replaced by the vertex nearest
    to their mean.  The cell size is found by bisection: the smallest with at most `most` clusters.

    Parameters
    ----------
    points : (V, 3).   triangles : (T, 3).   part : (V,) only vertices of one part are merged.

    Returns
    -------
    kept : (K,) remaining vertices.   corners : (S, 3) triangles into `kept`.
    faces : (S,) the input triangle of each.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) <= most:
        return np.arange(len(points)), np.asarray(triangles), np.arange(len(triangles))
    octant = _normal_octants(points, triangles)
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    fine, coarse = 0.0, size

    def cluster_by_cell(cell: float) -> NDArray[np.int64]:
        index = np.floor((points - low) / cell).astype(np.int64)
        rows = np.column_stack([index, np.asarray(part), octant])
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)

    label = cluster_by_cell(coarse)
    for _ in range(MAX_BISECTIONS):
        middle = 0.5 * (fine + coarse)
        found = cluster_by_cell(middle)
        count = int(found.max()) + 1
        if count <= most:
            coarse, label = middle, found
            if count > 0.9 * most:
                break
        else:
            fine = middle
    kept = _select_nearest_to_mean(points, label)
    corners = label[np.asarray(triangles)]
    a, b, c = corners.T
    faces = np.flatnonzero((a != b) & (b != c) & (c != a))
    # remove duplicate triangles
    _, first = np.unique(np.sort(corners[faces], axis=1), axis=0, return_index=True)
    faces = faces[np.sort(first)]
    return kept, corners[faces], faces


def _normal_octants(points: Floats, triangles: Ints) -> NDArray[np.int64]:
    """Octant 0..7 of vertex normals (V,), so that the sides of a thin wall are not merged."""
    corners = points[np.asarray(triangles)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, np.asarray(triangles)[:, corner], normal)
    return (total > 0.0).astype(np.int64) @ np.array([1, 2, 4])


def _select_nearest_to_mean(points: Floats, label: Ints) -> NDArray[np.int64]:
    """The member (K,) of each group that is nearest to the mean of the group."""
    size = np.bincount(label)
    mean = np.stack([np.bincount(label, points[:, i]) for i in range(3)], axis=1) / size[:, None]
    distance = np.linalg.norm(points - mean[label], axis=1)
    order = np.lexsort((distance, label))
    return order[np.concatenate([[0], np.cumsum(size)[:-1]])]
