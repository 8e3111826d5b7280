"""A cube of edge 1 at the origin as quads and as triangles, and area vectors of triangles."""

from __future__ import annotations

import numpy as np
from mesh_makers import CORNERS, QUADS
from numpy.typing import NDArray

from gf_usd.core.mesh.triangulation import triangulate

CUBE, CUBE_FACES = CORNERS, np.array(QUADS)


def cube_triangles() -> NDArray[np.int64]:
    """(12, 3) triangles of the cube."""
    return triangulate(CUBE, np.full(6, 4), CUBE_FACES.ravel())[0]


def area_vectors(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """(T, 3) normals of triangles, as long as their areas."""
    a, b, c = np.moveaxis(np.asarray(points)[triangles], 1, 0)
    return 0.5 * np.cross(b - a, c - a)
