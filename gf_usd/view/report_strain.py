"""How far a surface and its Gaussians are stretched, from their shapes alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats, Ints


class SurfaceStretch:
    """Principal stretches of a triangle mesh against its rest shape.

    The edges of a triangle at rest, in its own plane, are the columns of Dm (2, 2); deformed, in
    space, those of Ds (3, 2).  F = Ds Dm^-1, and the stretches are the singular values of F.

    Parameters
    ----------
    points : (V, 3) at rest.   triangles : (T, 3).
    """

    def __init__(self, points: Floats, triangles: Ints) -> None:
        a, b = self._edges(points, triangles)
        length = np.linalg.norm(a, axis=1)
        area = np.linalg.norm(np.cross(a, b), axis=1)
        # slivers have no usable plane: their own stretch is noise
        good = area > 1e-6 * np.maximum(length**2, np.einsum("ij,ij->i", b, b))
        self._triangles = np.asarray(triangles)[good]
        a, b, length, area = a[good], b[good], length[good], area[good]
        along = np.einsum("ij,ij->i", a, b) / length
        self._inverse = np.zeros((len(a), 2, 2))
        self._inverse[:, 0, 0] = 1.0 / length
        self._inverse[:, 0, 1] = -along / area
        self._inverse[:, 1, 1] = length / area
        self._area = np.repeat(area, 3)
        self._vertices = len(points)
        flat = self._triangles.reshape(-1)
        self._weight = np.bincount(flat, self._area, minlength=self._vertices)

    def faces(self, points: Floats) -> NDArray[np.float64]:
        """(T', 2) smaller and larger stretch of each triangle that is no sliver."""
        a, b = self._edges(points, self._triangles)
        F = np.stack([a, b], axis=2) @ self._inverse
        C = np.einsum("nij,nik->njk", F, F)
        middle = 0.5 * (C[:, 0, 0] + C[:, 1, 1])
        reach = np.hypot(0.5 * (C[:, 0, 0] - C[:, 1, 1]), C[:, 0, 1])
        squared = np.stack([middle - reach, middle + reach], axis=1)
        return np.sqrt(np.maximum(squared, 0.0))

    def at_vertices(self, faces: Floats) -> NDArray[np.float64]:
        """(V,) the stretch that is furthest from 1, of the mean over the triangles around.

        Means are geometric and weighted by rest area; 1 where a vertex has no triangle.
        """
        flat = self._triangles.reshape(-1)
        log = np.log(np.maximum(faces, 1e-9))
        mean = np.stack(
            [
                np.bincount(flat, self._area * np.repeat(log[:, k], 3), minlength=self._vertices)
                for k in range(2)
            ]
        ) / np.where(self._weight > 0.0, self._weight, 1.0)
        return np.exp(np.where(np.abs(mean[0]) > np.abs(mean[1]), mean[0], mean[1]))

    @staticmethod
    def _edges(points: Floats, triangles: Ints) -> tuple[Floats, Floats]:
        corners = np.asarray(points)[np.asarray(triangles)]
        return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def volume_ratio(axes: Floats, rest_scales: Floats) -> NDArray[np.float64]:
    """(N,) |J| of Gaussians: det Sigma = J^2 det Sigma0, so |J| = |det A| / (s1 s2 s3 at rest)."""
    rest = np.prod(rest_scales, axis=1)
    now = np.abs(np.linalg.det(axes))
    return np.divide(now, rest, out=np.ones_like(now), where=rest > 0.0)
