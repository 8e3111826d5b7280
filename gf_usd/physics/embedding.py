"""What rides on the body: poses of points, deformed normals, deformed Gaussians."""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats, Ints, Pose
from gf_usd.physics.stencil import Rows


def pose(rows: Rows, u: Floats, v: Floats, offset: Floats) -> Pose:
    """x = X + offset + W u,  v = W v_i,  F = I + sum_i u_i (x) grad w_i  (docs/physics.md).

    u, v : (M, 3) nodal [m], [m/s]; offset : (3,) [m] rigid translation.
    """
    F = np.stack([G @ u for G in rows.G], -1)
    F += np.eye(3)
    return Pose(x=rows.X + offset + rows.W @ u, v=rows.W @ v, F=F)


def deform_normals(normals: Floats, points: Ints, F: Floats) -> Floats:
    """n = cof(F) n0, normalised: surfaces turn with the cofactor, defined at J <= 0 too.

    normals : (K, 3) at rest; points : (K,) the point that carries each; F : (V, 3, 3).
    """
    n = np.einsum("kab,kb->ka", cofactor(F)[points], normals)
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    return np.where(length > 0.0, n / np.where(length > 0.0, length, 1.0), normals)


def cofactor(F: Floats) -> Floats:
    """cof F = J F^-T, (..., 3, 3)."""
    a, b, c = F[..., 0, :], F[..., 1, :], F[..., 2, :]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], -2)
