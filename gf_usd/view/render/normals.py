"""Vertex normals with creases, for meshes without authored normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints


def corner_normals(points: Floats, triangles: Ints, crease_angle: float) -> NDArray[np.float32]:
    """Unit normals (T, 3, 3) at triangle corners.

    n(corner of f at v) = sum of angle_g n_g over the triangles g around v whose dihedral angle to f
    is at most the crease angle; angle_g is the angle of g at v [Thurmer and Wuthrich 1998], so that
    normals do not depend on how polygons are triangulated.

    Parameters
    ----------
    points : (V, 3).   triangles : (T, 3).   crease_angle : [deg]; 180 smooths everything.
    """
    triangles = np.asarray(triangles, dtype=np.int64)
    corners = np.asarray(points, dtype=np.float64)[triangles]
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    normal = np.cross(ahead[:, 0], behind[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    across = np.linalg.norm(np.cross(ahead, behind), axis=2)
    angle = np.arctan2(across, np.einsum("tci,tci->tc", ahead, behind))

    face = np.repeat(np.arange(len(triangles)), 3)
    vertex = triangles.ravel()
    mine, other = _corners_sharing_a_vertex(vertex)
    close = np.einsum("pi,pi->p", normal[face[mine]], normal[face[other]])
    keep = close >= np.cos(np.radians(crease_angle)) - 1e-9
    weight = np.where(keep, angle.ravel()[other], 0.0)
    total = np.stack(
        [
            np.bincount(mine, weight * normal[face[other], axis], minlength=len(vertex))
            for axis in range(3)
        ],
        axis=1,
    )
    size = np.linalg.norm(total, axis=1, keepdims=True)
    smooth = np.divide(total, size, out=normal[face].copy(), where=size > 1e-12)
    return smooth.reshape(-1, 3, 3).astype(np.float32)


def _corners_sharing_a_vertex(vertex: Ints) -> tuple[Ints, Ints]:
    """All ordered pairs of corners that share a vertex, including each corner with itself."""
    order = np.argsort(vertex, kind="stable")
    _, start, count = np.unique(vertex[order], return_index=True, return_counts=True)
    repeats = np.repeat(count, count)  # for each corner in order: how many it pairs with
    first = np.repeat(np.repeat(start, count), repeats)
    offset = np.arange(int(repeats.sum())) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    return np.repeat(order, repeats), order[first + offset]
