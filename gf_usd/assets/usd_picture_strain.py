"""How much particles are stretched: from deformation gradients, or from their motion alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]

NEIGHBOURS = 20  # of a particle in a fit: about two shells of a lattice
FLATTEST = 1e-2  # of the largest spread: along a thinner direction neighbours tell nothing


def largest_stretch(gradients: Floats) -> NDArray[np.float64]:
    """max_i |s_i - 1| (N,) of the principal stretches s of F (N, 3, 3): 0 at rest and turned.

    0.3 is a part that was drawn out by 30 %, or pressed together by 30 %, in some direction.
    NaN where F is not finite.
    """
    out = np.full(len(gradients), np.nan)
    sound = np.isfinite(gradients).all(axis=(1, 2))
    stretches = np.linalg.svd(gradients[sound], compute_uv=False)
    out[sound] = np.abs(stretches - 1.0).max(axis=1)
    return out


class NeighbourFit:
    """F of each particle as the best linear map of its neighbours' offsets.

    With offsets dX at rest and dx now, and weights w = 1 - (|dX| / 1.1 |dX_far|)^2, the map
        F = (sum w dx dX') (sum w dX dX')^-1
    minimises sum w |dx - F dX|^2 [moving least squares].  It is exact for affine motion, and a
    mean over the neighbourhood otherwise.  A direction in which the neighbours hardly spread (a
    sheet one particle thick) is taken as not stretched.

    Parameters
    ----------
    rest : (N, 3) rest positions, N >= 2.
    """

    def __init__(self, rest: Floats) -> None:
        k = min(NEIGHBOURS + 1, len(rest))
        distance, self._index = cKDTree(rest).query(rest, k=k)
        self._index = self._index.reshape(-1, k)
        offsets = rest[self._index] - rest[:, None]
        far = np.maximum(distance.reshape(-1, k)[:, -1:], 1e-30)
        weight = 1.0 - (distance.reshape(-1, k) / (1.1 * far)) ** 2
        moment = np.einsum("nk,nki,nkj->nij", weight, offsets, offsets)
        size, axes = np.linalg.eigh(moment)
        known = size > FLATTEST**2 * size[:, -1:]
        inverse = np.where(known, 1.0 / np.where(known, size, 1.0), 0.0)
        solve = np.einsum("nia,na,nja->nij", axes, inverse, axes)
        self._weights = np.einsum("nk,nkj,nji->nki", weight, offsets, solve)
        self._unknown = np.einsum("nia,na,nja->nij", axes, (~known).astype(float), axes)

    def __call__(self, positions: Floats) -> NDArray[np.float64]:
        """F (N, 3, 3) at positions (N, 3)."""
        moved = positions[self._index] - positions[:, None]
        return np.einsum("nki,nkj->nij", moved, self._weights) + self._unknown
