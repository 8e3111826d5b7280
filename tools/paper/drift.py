"""Drift: the distance of a mesh from the surface of its Gaussians (GaussianFlesh section 4.2).

The surface is a level of their density:

    rho(x) = sum_p exp(-q_p(x) / 2),      q_p(x) = (x - x_p)^T Sigma_p^-1 (x - x_p)

GaussianFlesh measures a mesh against such an isosurface (section 4.2) and gives neither its level
nor its widths.  Fitted to its tables: level 0.43, rest widths .1 r along the normal and .2 r across
for 120 particles in a ball of radius r.  In spacings s = (V / N)^(1/3) = .327 r, so that they hold
for any number of particles, these are .306 s and .612 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import igl
import numpy as np
from scipy.spatial import cKDTree

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import GfUsdError, InputError

LEVEL = 0.43
SIGMA_R, SIGMA_T = 0.306, 0.612  # [spacings]
REACH = 4.0  # [standard deviations] a Gaussian is cut off where it is exp(-8) = 3e-4
RESOLUTION = 64  # cells along the longest side: the surface is then within 1e-3 of it (tested)


def density(points: Floats, positions: Floats, axes: Floats, *, batch: int = 4096) -> Floats:
    """rho (n,) at points (n, 3) [m] of Gaussians at positions (N, 3) [m] with axes (N, 3, 3) [m].

    axes : A with Sigma = A A^T; its columns are the axes as long as the standard deviations.
    """
    inverse = np.linalg.inv(axes)
    reach = REACH * np.linalg.norm(axes, axis=(1, 2))
    tree = cKDTree(points)
    out = np.zeros(len(points))
    for p, near in enumerate(tree.query_ball_point(positions, reach)):
        for start in range(0, len(near), batch):
            rows = near[start : start + batch]
            d = (points[rows] - positions[p]) @ inverse[p].T
            out[rows] += np.exp(-0.5 * np.einsum("na,na->n", d, d))
    return out


def isosurface(
    positions: Floats, axes: Floats, *, level: float = LEVEL, resolution: int = RESOLUTION
) -> tuple[Floats, Ints]:
    """Points (V, 3) [m] and triangles (T, 3) of rho = level, by marching cubes.

    Raises InputError where the density nowhere reaches the level.
    """
    widest = float(np.linalg.norm(axes, axis=1).max())
    low, high = positions.min(0) - 3.0 * widest, positions.max(0) + 3.0 * widest
    step = float((high - low).max()) / resolution
    n = np.ceil((high - low) / step).astype(int) + 1
    # igl requires x to vary fastest
    z, y, x = np.meshgrid(*(np.arange(n[d]) for d in (2, 1, 0)), indexing="ij")
    grid = low + step * np.stack([x.ravel(), y.ravel(), z.ravel()], -1)
    values = density(grid, positions, axes)
    if values.max() <= level:
        raise InputError(
            f"the density of {len(positions)} Gaussians is at most {values.max():.3g}: it nowhere"
            f" reaches the level {level:g}",
            "widen the Gaussians, or take a lower level",
        )
    march: Any = igl.marching_cubes  # its stub has no unpacked sizes
    made = march(values, np.ascontiguousarray(grid), *map(int, n), float(level))
    return np.asarray(made[0]), np.asarray(made[1], np.int64)


def kernel_axes(F: Floats, frames: Floats, spacing: float) -> Floats:
    """A = F R diag(.306 s, .612 s, .612 s) (N, 3, 3), of which the paper's surface is a level.

    F : (N, 3, 3); frames : (N, 3, 3) rest rotations, axis 0 the normal; spacing : s [m].
    """
    return F @ (frames * (spacing * np.array([SIGMA_R, SIGMA_T, SIGMA_T])))


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Distances [m] of a mesh's vertices to the isosurface."""

    mean: float
    largest: float
    distances: Floats  # (V,)


def distances(points: Floats, vertices: Floats, triangles: Ints) -> Floats:
    """(n,) [m] of points (n, 3) to a triangle mesh, exact, by open3d's RaycastingScene.

    Raises GfUsdError where open3d is not installed.
    """
    try:
        import open3d
    except ImportError as error:
        raise GfUsdError(
            f"exact distances need open3d, which cannot be imported: {error}",
            "pip install open3d",
        ) from error
    scene = open3d.t.geometry.RaycastingScene()
    tensor: Any = open3d.core.Tensor  # its stub has no numpy arrays
    # single precision: centered, so that far from the origin no digits are lost
    center = vertices.mean(0)
    scene.add_triangles(
        tensor((vertices - center).astype(np.float32)),
        tensor(triangles.astype(np.uint32)),
    )
    query = tensor((points - center).astype(np.float32))
    return scene.compute_distance(query).numpy().astype(float)


def drift(
    vertices: Floats,
    positions: Floats,
    F: Floats,
    frames: Floats,
    spacing: float,
    *,
    level: float = LEVEL,
    resolution: int = RESOLUTION,
) -> Drift:
    """Distances of mesh vertices (V, 3) [m] to the isosurface of the Gaussian density.

    positions : (N, 3) [m] of the particles; F : (N, 3, 3); frames : (N, 3, 3) rest rotations of the
    Gaussians, axis 0 the normal; spacing : s [m].  The kernel is exp(-q/2), q of Sigma = A A^T with
    A = F R diag(.306, .612, .612) s; the level is .43.
    """
    surface = isosurface(
        positions, kernel_axes(F, frames, spacing), level=level, resolution=resolution
    )
    d = distances(np.asarray(vertices, float), *surface)
    return Drift(mean=float(d.mean()), largest=float(d.max()), distances=d)
