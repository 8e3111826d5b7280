"""How far points of a body lie on either side of the border between parts of its surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats, Ints

TOUCHING = 1e-12  # [1] of the distance: closer than this two closest points are one


def part_weights(
    X: Floats, parts: Sequence[tuple[Floats, Ints]], width: float
) -> NDArray[np.float64]:
    """(n, K) weights of K parts of a surface at points X (n, 3) [m]; every row adds up to 1.

    With p_k the nearest point of part k at the distance d_k, the plane halfway between p_k and p_j
    is at b_kj = (d_j^2 - d_k^2) / (2 |p_j - p_k|) from X, positive on the side of k.  Then
    w_k = S(1/2 + 2 min_j b_kj / width), scaled to a sum of 1, with S(t) = t^2 (3 - 2 t) on 0..1.
    Where the border runs along a flat face, 2 b is the distance from it at any depth.

    parts : points (V, 3) [m] and triangles (T, 3) of each; width : [m] over which one turns into
    the other.
    """
    found: list[Any] = [
        igl.point_mesh_squared_distance(X, points, faces) for points, faces in parts
    ]
    squared = np.stack([np.asarray(one[0]) for one in found], 1)
    closest = np.stack([np.asarray(one[2]) for one in found], 1)
    out = np.ones(squared.shape)
    for k in range(len(parts)):
        others = [j for j in range(len(parts)) if j != k]
        if not others:
            continue
        apart = np.linalg.norm(closest[:, others] - closest[:, [k]], axis=2)
        more = squared[:, others] - squared[:, [k]]
        scale = np.sqrt(np.maximum(squared[:, others], squared[:, [k]]))
        one_point = apart <= TOUCHING * scale
        beyond = np.where(one_point, 0.0, more / np.where(one_point, 1.0, 2.0 * apart)).min(1)
        out[:, k] = smoothstep(0.5 + 2.0 * beyond / width)
    return out / out.sum(1, keepdims=True)


def smoothstep(t: Floats) -> NDArray[np.float64]:
    """t^2 (3 - 2 t), with t kept within 0..1."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
