"""Drift: how far a mesh is from the surface that its Gaussians show (GaussianFlesh section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import GfUsdError
from tools.paper_isosurface import LEVEL, RESOLUTION, isosurface, kernel_axes


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
            "pip install 'gf-usd[open3d]'",
        ) from error
    scene = open3d.t.geometry.RaycastingScene()
    tensor: Any = open3d.core.Tensor  # its stub knows no numpy arrays
    # single precision: centred, so that far from the origin no digits are lost
    centre = vertices.mean(0)
    scene.add_triangles(
        tensor((vertices - centre).astype(np.float32)),
        tensor(triangles.astype(np.uint32)),
    )
    query = tensor((points - centre).astype(np.float32))
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
