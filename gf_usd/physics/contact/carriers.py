"""Three samples of a surface that carry a plane: which they are, and how they turn.

A plane moves with three samples k of the body it belongs to, with weights w_k barycentric of
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
        dots = away @ away.swapaxes(1, 2)
        weights, height, fatness = triangle(dots, chosen)
        far = np.sqrt(np.einsum("nkk->nk", dots))[:, chosen]
        cost = (np.abs(weights) * far).sum(2) + height + SPREAD * far.mean(2)
        cost = cost / np.where(fatness > FAT, fatness, 1e-3 * fatness + 1e-12)
        row, best = np.arange(len(places)), cost.argmin(1)
        samples, w = near[row[:, None], chosen[best]], weights[row, best]
        order = np.argsort(-w, axis=1, kind="stable")
        return np.take_along_axis(samples, order, 1), np.take_along_axis(w, order, 1)


def triangle(dots: Floats, corners: Ints) -> tuple[Floats, Floats, Floats]:
    """Of triangles (t, 3) of points: weights (k, t, 3) of the origin, its height [m], the fatness.

    dots : (k, n, n) [m^2] products of the points, from the origin.  The weights are barycentric of
    the origin's projection; where a triangle has no area, the first corner's is 1.  Fatness is 1
    for an equilateral triangle, 0 for a line.
    """
    a, b, c = corners.T
    aa, ab, ac = dots[:, a, a], dots[:, a, b], dots[:, a, c]
    u, v = dots[:, b, b] - 2.0 * ab + aa, dots[:, c, c] - 2.0 * ac + aa
    uv = dots[:, b, c] - ab - ac + aa
    pu, pv = aa - ab, aa - ac
    square = np.maximum(u * v - uv * uv, 0.0)
    safe = np.where(square > 0.0, square, np.inf)
    s, t = (v * pu - uv * pv) / safe, (u * pv - uv * pu) / safe
    height = np.sqrt(np.maximum(aa - s * pu - t * pv, 0.0))
    edges = 2.0 * (u + v - uv)
    fatness = 2.0 * np.sqrt(3.0 * square) / np.where(edges > 0.0, edges, 1.0)
    return np.stack([1.0 - s - t, s, t], -1), height, fatness


FLAT = 1e-4  # of det J / (tr J)^3, at most 1/32: below it three samples lie on a line


def spin(x: Floats, v: Floats) -> Floats:
    """omega (k, 3) [1/s] of triples at x (k, 3, 3) [m] with v (k, 3, 3) [m/s]; 0 on a line."""
    r = x - x.mean(1, keepdims=True)
    return turn(r, cross(r.reshape(-1, 3), v.reshape(-1, 3)).reshape(-1, 3, 3).sum(1))


def turn(r: Floats, moment: Floats) -> Floats:
    """alpha (k, 3) with J alpha = moment (k, 3), of triples at r (k, 3, 3) [m] from their centroid;
    0 on a line."""
    products = r.swapaxes(1, 2) @ r
    size = 2.0 * np.trace(products, axis1=1, axis2=2)
    scale = np.where(size > 0.0, size, 1.0)
    J = (0.5 * size)[:, None, None] * np.eye(3) - products
    J /= scale[:, None, None]
    fit = np.linalg.det(J) > FLAT
    J[~fit] = np.eye(3)
    alpha = np.linalg.solve(J, (moment / scale[:, None])[..., None])[..., 0]
    return np.where(fit[:, None], alpha, 0.0)


NEXT, LAST = (1, 2, 0), (2, 0, 1)  # axes after and before each


def cross(a: Floats, b: Floats) -> Floats:
    """a x b of rows (n, 3): `numpy.cross` without its questions about axes and shapes."""
    return a.take(NEXT, 1) * b.take(LAST, 1) - a.take(LAST, 1) * b.take(NEXT, 1)
