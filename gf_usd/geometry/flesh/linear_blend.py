"""Linear blend skinning of points to bones (Magnenat-Thalmann, Laperriere and Thalmann 1988).

Each bone j moves by an affine map, and a point X with weights w_j by the weighted mean of these:

    x(X, t) = sum_j w_j (A_j(t) X + b_j(t))
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Skeleton

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


def bone_transforms(skeleton: Skeleton) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A (F, bones, 3, 3) and b (F, bones, 3) [m] of each bone at each frame.

    A = (E^-1 D)^T and b = x_0 - A X_0, with the edges of the anchors at rest, E, and posed, D, from
    their first corner X_0, x_0.
    """
    rest = np.stack([bone.anchors for bone in skeleton.bones])  # (B, 4, 3)
    path = np.stack([bone.path for bone in skeleton.bones], 1)  # (F, B, 4, 3)
    edges = np.linalg.inv(rest[:, 1:] - rest[:, :1])
    linear = np.swapaxes(edges @ (path[:, :, 1:] - path[:, :, :1]), 2, 3)
    offset = path[:, :, 0] - np.einsum("fbac,bc->fba", linear, rest[:, 0])
    return linear, offset


def skinned(weights: csr_matrix, linear: Floats, offset: Floats, X: Floats) -> NDArray[np.float64]:
    """(n, d) [m] the points X (n, 3) [m] as bones pose them: sum_j w_j (A_j X + b_j).

    weights : (n, bones); a row that does not sum to 1 scales its point.
    linear, offset : A (bones, d, 3) and b (bones, d) [m] at one frame; d is 3, or 1 for the
        coordinate along one direction, of which A and b are the projections on that.
    """
    return skinned_with_gradients(weights, linear, offset, X)[0]


def skinned_with_gradients(
    weights: csr_matrix, linear: Floats, offset: Floats, X: Floats
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`skinned`, and sum_j w_j A_j (n, d, 3): the gradients for weights that are constant."""
    d = linear.shape[1]
    A = (weights @ linear.reshape(-1, 3 * d)).reshape(-1, d, 3)
    return np.asarray(np.einsum("nab,nb->na", A, X) + weights @ offset), A
