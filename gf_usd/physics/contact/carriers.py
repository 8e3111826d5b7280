"""Three samples of a surface that carry a plane: which they are, and how they turn.

A plane rides on three samples k of the body it belongs to, with weights w_k that are barycentric of
its point in their triangle.  With r_k from their centroid they turn at the rate of the rigid motion
nearest to theirs,

    J omega = sum_k r_k x v_k,        J = sum_k (r_k^2 I - r_k r_k^T)

and the plane's normal and its offset from sum_k w_k x_k turn with them.  The transpose of that is
how a force f on the sample that faces the plane, at x_s, comes back to the three:

    f_k = -w_k f + alpha x r_k,       J alpha = -(x_s - sum_k w_k x_k) x f

so that sum_k f_k = -f and sum_k x_k x f_k = -x_s x f: linear and angular momentum are kept, and the
power of the four forces is that of the spring between them.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree

NEAR = 6  # samples of which three are chosen
# Of the area of an equilateral triangle with the same sum of squared edges: below it a triangle is
# so thin that a moment about its long axis asks for large forces.
FAT = 0.3
SPREAD = 0.1  # weight of the triangle's size against how far its point is from what carries it
TRIPLES = np.array(list(combinations(range(NEAR), 3)))  # (20, 3)


class Triples:
    """The triangles of samples X (n, 3) [m] at rest that carry places of the surface."""

    def __init__(self, X: Floats) -> None:
        self._X, self._tree = X, kd_tree(X)

    def __call__(self, places: Floats) -> tuple[Ints, Floats]:
        """Samples (k, 3) and weights (k, 3), the largest first, for places (k, 3) [m] at rest.

        Of the triangles of the nearest samples the one with the least sum of
        |w_k| |X_k - X| + distance from its plane, over its fatness.
        Where the body has fewer than three samples one of them carries alone.
        """
        count = min(NEAR, len(self._X))
        near = self._tree.query(places, k=list(range(1, count + 1)))[1].reshape(-1, count)
        if count < 3:
            alone = np.tile([1.0, 0.0, 0.0], (len(places), 1))
            return np.repeat(near[:, :1], 3, 1), alone
        chosen = TRIPLES[(count > TRIPLES).all(1)]
        away = self._X[near] - places[:, None]  # (k, near, 3)
        corners = away[:, chosen]  # (k, triples, 3, 3)
        weights, height, fatness = triangle(corners)
        far = np.linalg.norm(away, axis=2)[:, chosen]
        cost = (np.abs(weights) * far).sum(2) + height + SPREAD * far.mean(2)
        cost = cost / np.where(fatness > FAT, fatness, 1e-3 * fatness + 1e-12)
        row, best = np.arange(len(places)), cost.argmin(1)
        samples, w = near[row[:, None], chosen[best]], weights[row, best]
        order = np.argsort(-w, axis=1, kind="stable")
        return np.take_along_axis(samples, order, 1), np.take_along_axis(w, order, 1)


def triangle(corners: Floats) -> tuple[Floats, Floats, Floats]:
    """Of triangles (..., 3, 3) [m]: weights (..., 3) of the origin, its height [m], the fatness.

    The weights are barycentric of the origin's projection; where a triangle has no area, a third.
    Fatness is 1 for an equilateral triangle, 0 for a line.
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    normal = np.cross(b - a, c - a)
    square = (normal * normal).sum(-1)
    edges = ((b - a) ** 2).sum(-1) + ((c - b) ** 2).sum(-1) + ((a - c) ** 2).sum(-1)
    safe = np.where(square > 0.0, square, 1.0)
    parts = [(np.cross(p, q) * normal).sum(-1) / safe for p, q in ((b, c), (c, a))]
    weights = np.stack([*parts, 1.0 - parts[0] - parts[1]], -1)
    weights = np.where((square > 0.0)[..., None], weights, 1.0 / 3.0)
    height = np.abs((a * normal).sum(-1)) / np.sqrt(safe)
    fatness = 2.0 * np.sqrt(3.0 * square) / np.where(edges > 0.0, edges, 1.0)
    return weights, height, fatness


FLAT = 1e-4  # of det J / (tr J)^3, at most 1/32: below it three samples lie on a line


def spin(x: Floats, v: Floats) -> Floats:
    """omega (k, 3) [1/s] of triples at x (k, 3, 3) [m] with v (k, 3, 3) [m/s]; 0 on a line."""
    r = x - x.mean(1, keepdims=True)
    J = (r * r).sum((1, 2))[:, None, None] * np.eye(3) - np.einsum("nka,nkb->nab", r, r)
    size = np.trace(J, axis1=1, axis2=2)
    J /= np.where(size > 0.0, size, 1.0)[:, None, None]
    fit = np.linalg.det(J) > FLAT
    moment = np.cross(r, v).sum(1) / np.where(size > 0.0, size, 1.0)[:, None]
    out = np.zeros_like(moment)
    out[fit] = np.linalg.solve(J[fit], moment[fit][..., None])[..., 0]
    return out
