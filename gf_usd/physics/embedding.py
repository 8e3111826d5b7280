"""What rides on the body: poses of points, deformed normals, deformed Gaussians."""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats, Ints, Pose
from gf_usd.physics.cofactor import cofactors, entries
from gf_usd.physics.sharing import product
from gf_usd.physics.stencil import Rows
from gf_usd.rows import lengths


def pose(rows: Rows, u: Floats, v: Floats, offset: Floats) -> Pose:
    """x = X + offset + W u,  v = W v_i,  F = I + sum_i u_i (x) grad w_i  (docs/physics.md).

    u, v : (M, 3) nodal [m], [m/s]; offset : (3,) [m] rigid translation.
    """
    u, v = rows.nodes(u), rows.nodes(v)
    return Pose(x=rows.X + offset + product(rows.W, u), v=product(rows.W, v), F=_gradient(rows, u))


def gradient(rows: Rows, u: Floats) -> Floats:
    """F = I + sum_i u_i (x) grad w_i, (n, 3, 3)."""
    return _gradient(rows, rows.nodes(u))


def _gradient(rows: Rows, u: Floats) -> Floats:
    F = np.empty((len(rows.X), 3, 3))
    for axis, G in enumerate(rows.G):
        F[:, :, axis] = product(G, u)
    F += np.eye(3)
    return F


def deform_normals(normals: Floats, points: Ints, F: Floats) -> Floats:
    """n = cof(F) n0, normalised: surfaces turn with the cofactor, defined at J <= 0 too.

    normals : (K, 3) at rest; points : (K,) the point that carries each; F : (V, 3, 3).
    """
    turned = cofactors(entries(F)).reshape(3, 3, -1)
    n = np.einsum("abk,kb->ka", turned[:, :, points], normals)
    length = lengths(n)[:, None]
    if length.all():
        return np.divide(n, length, out=n)
    return np.where(length > 0.0, n / np.where(length > 0.0, length, 1.0), normals)
