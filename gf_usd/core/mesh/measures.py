"""The areas of triangles, and the volume that they enclose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, cross, lengths


def signed_volume(points: Floats, triangles: Ints) -> float:
    """V = 1/6 sum a . (b x c) over the triangles; positive where they face outward.

    Meaningful for a closed mesh.  Taken about the mesh's own center, so that an asset far from
    the origin loses no digits.
    """
    triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    if len(triangles) == 0:
        return 0.0
    corners = np.asarray(points, dtype=np.float64)[triangles]
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return float(np.einsum("ti,ti->", a, cross(b, c)) / 6.0)


def areas(points: Floats, triangles: Ints) -> NDArray[np.float64]:
    """(T,) of the triangles."""
    points = np.asarray(points, float)
    a, b, c = (points.take(corner, axis=0) for corner in np.asarray(triangles).T)
    return 0.5 * lengths(cross(b - a, c - a))
