"""What a window draws, as triangles and lines: mesh, Gaussians and floor."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gf_usd.colour import linear_to_srgb
from gf_usd.model import Floats
from gf_usd.recording import GaussianSet
from gf_usd.scene import RenderMesh
from gf_usd.view.report_surface import make_skin
from gf_usd.view.report_thin import sample

MOST_BALLS = 20_000  # more would not be moved in real time
CELLS = 10  # of the floor's grid, each way from the middle


class Skin:
    """All meshes as one, with vertices split at creases and where the colour changes."""

    def __init__(self, meshes: tuple[RenderMesh, ...]) -> None:
        self._skin = make_skin(meshes, sum(len(mesh.points) for mesh in meshes))
        self.triangles = self._skin.corners
        self.colours = self._skin.colours / 255.0

    def pose(self, meshes: tuple[Floats, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vertices and unit normals (D, 3) of the meshes' points; n = sum of a x b over faces."""
        points = np.concatenate(meshes)[self._skin.kept][self._skin.source]
        corners = points[self.triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        shade = self._skin.shade
        into = shade[self.triangles].reshape(-1)
        each = np.repeat(face, 3, axis=0)
        count = int(shade.max(initial=-1)) + 1
        total = np.stack([np.bincount(into, each[:, i], minlength=count) for i in range(3)], axis=1)
        normals = total[shade]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points, normals / np.where(length > 0.0, length, 1.0)


class Balls:
    """Gaussians as ellipsoids of one standard deviation, a few faces each."""

    def __init__(self, cloud: GaussianSet) -> None:
        self._chosen = sample(len(cloud), MOST_BALLS)
        self._corners, faces = icosahedron()
        count = len(self._chosen)
        first = len(self._corners) * np.arange(count)[:, None, None]
        self.triangles = (faces + first).reshape(-1, 3)
        colours = linear_to_srgb(np.clip(cloud.colours[self._chosen], 0.0, 1.0))
        self.colours = np.repeat(colours, len(self._corners), axis=0)

    def pose(self, positions: Floats, axes: Floats) -> tuple[Floats, Floats]:
        """Vertices x = c + A s and normals along A^-T s, both (12 n, 3)."""
        A = np.asarray(axes)[self._chosen]
        points = np.asarray(positions)[self._chosen][:, None, :] + self._corners @ A.mT
        # cofactors are A^-T but for a factor, and exist where A is flat as well
        cofactor = np.stack(
            [np.cross(A[:, :, (i + 1) % 3], A[:, :, (i + 2) % 3]) for i in range(3)], axis=2
        )
        normals = self._corners @ cofactor.mT
        normals *= np.sign(np.linalg.det(A))[:, None, None]
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
        return points.reshape(-1, 3), normals.reshape(-1, 3)


def icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners (12, 3) on the unit ball and faces (20, 3), outward: the hull of (0, ±1, ±phi)."""
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
    """(n, 2, 3) [m] lines of a grid under a box, at a height along up."""
    axis = int(np.argmax(np.abs(up)))
    across = [i for i in range(3) if i != axis]
    middle = 0.5 * (np.asarray(low) + np.asarray(high))
    reach = 0.75 * float(np.max(np.asarray(high) - low)) or 1.0
    ticks = np.linspace(-reach, reach, 2 * CELLS + 1)
    lines = []
    for along, other in (across, across[::-1]):
        ends = np.tile(middle, (len(ticks), 2, 1))
        ends[:, :, axis] = ground
        ends[:, :, other] += ticks[:, None]
        ends[:, 0, along] -= reach
        ends[:, 1, along] += reach
        lines.append(ends)
    return np.concatenate(lines)
