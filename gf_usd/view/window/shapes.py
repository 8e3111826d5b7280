"""The triangles and lines that a window shows: meshes, Gaussians as ellipsoids, the floor."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.radiance import linear_to_srgb
from gf_usd.core.scene import GaussianSet, MotionFrame, Recording, RenderMesh
from gf_usd.view.report.surface import make_display_mesh
from gf_usd.view.report.thinning import random_subset

MAX_ELLIPSOIDS = 20_000  # limit of playback in real time
GRID_CELLS = 10  # of the floor grid, from the center in each direction


class ShadedMesh:
    """All meshes as one, with the split vertices of `make_display_mesh`."""

    def __init__(self, meshes: tuple[RenderMesh, ...]) -> None:
        self._mesh = make_display_mesh(meshes, sum(len(mesh.points) for mesh in meshes))
        self.triangles = self._mesh.corners
        self.colors = self._mesh.colors / 255.0

    def pose(self, meshes: tuple[Floats, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vertices and unit normals (D, 3) at points of the meshes; n ~ sum of a x b over faces."""
        joined = np.concatenate([np.zeros((0, 3)), *meshes])
        points = joined[self._mesh.kept][self._mesh.source]
        corners = points[self.triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        groups = self._mesh.shade
        corner_groups = groups[self.triangles].reshape(-1)
        corner_normals = np.repeat(face, 3, axis=0)
        count = int(groups.max(initial=-1)) + 1
        normal_sums = np.stack(
            [np.bincount(corner_groups, corner_normals[:, i], minlength=count) for i in range(3)],
            axis=1,
        )
        normals = normal_sums[groups]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points, normals / np.where(length > 0.0, length, 1.0)


def mesh_at_frame(recording: Recording, mesh: ShadedMesh, frame: MotionFrame) -> ShadedMesh:
    """The mesh of a frame: a new one for recordings with meshes of varying topology."""
    return ShadedMesh((*recording.meshes, *frame.flows)) if recording.flows else mesh


class EllipsoidMesh:
    """Gaussians as icosahedra scaled to ellipsoids of one standard deviation."""

    def __init__(self, cloud: GaussianSet) -> None:
        self._indices = random_subset(len(cloud), MAX_ELLIPSOIDS)
        self._corners, faces = icosahedron()
        count = len(self._indices)
        first = len(self._corners) * np.arange(count)[:, None, None]
        self.triangles = (faces + first).reshape(-1, 3)
        colors = linear_to_srgb(np.clip(cloud.colors[self._indices], 0.0, 1.0))
        self.colors = np.repeat(colors, len(self._corners), axis=0)

    def pose(self, positions: Floats, axes: Floats) -> tuple[Floats, Floats]:
        """Vertices x = c + A s and normals along A^-T s, both (12 n, 3)."""
        A = np.asarray(axes)[self._indices]
        points = np.asarray(positions)[self._indices][:, None, :] + self._corners @ A.mT
        # the cofactor matrix is det(A) A^-T, and exists for singular A too
        cofactor = np.stack(
            [np.cross(A[:, :, (i + 1) % 3], A[:, :, (i + 2) % 3]) for i in range(3)], axis=2
        )
        normals = self._corners @ cofactor.mT
        normals *= np.sign(np.linalg.det(A))[:, None, None]
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
        return points.reshape(-1, 3), normals.reshape(-1, 3)


def icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners (12, 3) on the unit sphere and outward faces (20, 3) of an icosahedron.

    It is the convex hull of the cyclic permutations of (0, ±1, ±phi), phi the golden ratio.
    """
    phi = 0.5 * (1.0 + math.sqrt(5.0))
    corners = np.array(
        [np.roll((0.0, a, b * phi), k) for k in range(3) for a in (-1, 1) for b in (-1, 1)]
    )
    faces = []
    for i, j, k in combinations(range(12), 3):
        p, q, r = corners[[i, j, k]]
        if all(abs(np.linalg.norm(d) - 2.0) < 1e-9 for d in (p - q, q - r, r - p)):
            faces.append((i, j, k) if np.dot(np.cross(q - p, r - p), p) > 0.0 else (i, k, j))
    return corners / np.linalg.norm(corners[0]), np.array(faces, dtype=np.int64)


def floor_lines(low: Floats, high: Floats, up: Floats, ground: float) -> NDArray[np.float64]:
    """Lines (n, 2, 3) [m] of a grid below a box, at a height [m] along up."""
    axis = int(np.argmax(np.abs(up)))
    across = [i for i in range(3) if i != axis]
    middle = 0.5 * (np.asarray(low) + np.asarray(high))
    half_size = 0.75 * float(np.max(np.asarray(high) - low)) or 1.0
    ticks = np.linspace(-half_size, half_size, 2 * GRID_CELLS + 1)
    lines = []
    for along, other in (across, across[::-1]):
        ends = np.tile(middle, (len(ticks), 2, 1))
        ends[:, :, axis] = ground
        ends[:, :, other] += ticks[:, None]
        ends[:, 0, along] -= half_size
        ends[:, 1, along] += half_size
        lines.append(ends)
    return np.concatenate(lines)
