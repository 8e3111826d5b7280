"""What rides on the body: poses of points, deformed normals, deformed Gaussians."""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats, Ints, Pose
from gf_usd.physics.cofactor import cofactors, entries
from gf_usd.physics.sharing import FEW, product
from gf_usd.physics.stencil import Rows
from gf_usd.rows import lengths


def pose(rows: Rows, u: Floats, v: Floats, offset: Floats) -> Pose:
    """x = X + offset + W u,  v = W v_i,  F = I + sum_i u_i (x) grad w_i  (docs/physics.md).

    u, v : (M, 3) nodal [m], [m/s]; offset : (3,) [m] rigid translation.
    """
    u, v = rows.nodes(u), rows.nodes(v)
    x, v = placed(rows, u, v)
    return Pose(x=rows.X + offset + x, v=v, F=_gradient(rows, u))


def placed(rows: Rows, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """W u and W v of `Rows.nodes`, in one pass over W."""
    both = product(rows.W, np.concatenate([u, v], 1))
    return both[:, :3], np.ascontiguousarray(both[:, 3:])


def gradient(rows: Rows, u: Floats) -> Floats:
    """F = I + sum_i u_i (x) grad w_i, (n, 3, 3)."""
    return _gradient(rows, rows.nodes(u))


def _gradient(rows: Rows, u: Floats) -> Floats:
    n = len(rows.X)
    F = np.empty((n, 3, 3))
    if n < FEW:
        F.transpose(2, 0, 1)[...] = (rows.slopes @ u).reshape(3, n, 3)
    else:
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
