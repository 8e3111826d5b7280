"""Support triangles: the samples of a body that carry a contact plane, and the plane's rotation.

A plane moves with three samples k of its body, its carriers, with w_k the barycentric weights of
its point in their triangle. With r_k relative to their centroid, the angular velocity is that of
the least squares rigid motion,

    J omega = sum_k r_k x v_k,        J = sum_k (r_k^2 I - r_k r_k^T)

and the plane's normal and its offset from sum_k w_k x_k rotate with it. The reaction to a force f
on the sample at x_s is distributed by the transpose:

    f_k = -w_k f + alpha x r_k,       J alpha = -(x_s - sum_k w_k x_k) x f

so that sum_k f_k = -f and sum_k x_k x f_k = -x_s x f: linear and angular momentum are conserved,
and the power of the four forces is that of the spring between them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree
from gf_usd.system.taichi_runtime import ensure_running

NEAR = 6  # candidates from which three are chosen
# Of the area of an equilateral triangle with the same sum of squared edges: in a thinner triangle a
# moment about the long axis requires large forces.
FAT = 0.3
SPREAD = 0.1  # weight of the triangle's size relative to the distance of its point


class SupportTriangles:
    """Finds the triangles of samples X (n, 3) [m] at rest that carry points of the surface."""

    def __init__(self, X: Floats) -> None:
        self._X, self._tree = X, kd_tree(X)

    def near(self, places: Floats) -> Ints:
        """(k, NEAR) the samples nearest to points (k, 3) [m] at rest; -1: no more."""
        count = min(NEAR, len(self._X))
        out = np.full((len(places), NEAR), -1, np.int32)
        found = self._tree.query(places, k=list(range(1, count + 1)))[1]
        out[:, :count] = found.reshape(-1, count)
        return out

    def __call__(self, places: Floats) -> tuple[Ints, Floats]:
        """Samples (k, 3) and weights (k, 3), the largest first, for points (k, 3) [m] at rest."""
        return choose_support_triangles(self._X, places, self.near(places))


def choose_support_triangles(X: Floats, places: Floats, near: Ints) -> tuple[Ints, Floats]:
    """Samples (k, 3) of X (n, 3) [m] and weights (k, 3), the largest first, for points (k, 3) [m].

    near : (k, NEAR) the samples nearest to each; -1: no more. The triangle of these with the least
    sum of |w_k| |X_k - X| and the distance from its plane, divided by its shape measure. With fewer
    than three samples, one is the only carrier.
    """
    ensure_running()
    from gf_usd.physics.contact.planes.support_kernels import choose_triangles

    samples, weights = np.empty((len(places), 3), np.int32), np.empty((len(places), 3))
    if len(places):
        X, places = (np.ascontiguousarray(a, np.float64) for a in (X, places))
        choose_triangles(X, places, near, FAT, SPREAD, samples, weights)
    return samples.astype(np.int64), weights


FLAT = 1e-4  # of det J / (tr J)^3, at most 1/32: below it three samples are collinear


def spin(x: Floats, v: Floats) -> Floats:
    """omega (k, 3) [1/s] of triples at x (k, 3, 3) [m] with v (k, 3, 3) [m/s]; 0 if collinear."""
    x, y, z = _from_centroid(x)
    u, v, w = np.ascontiguousarray(np.moveaxis(v, 2, 0))
    return _turn((x, y, z), (_sum(y * w - z * v), _sum(z * u - x * w), _sum(x * v - y * u)))


def turn(r: Floats, moment: Floats) -> Floats:
    """alpha (k, 3) with J alpha = moment (k, 3), for triples at r (k, 3, 3) [m] from their
    centroid; 0 if collinear.
    """
    x, y, z = np.moveaxis(r, 2, 0)
    return _turn((x, y, z), (moment[:, 0], moment[:, 1], moment[:, 2]))


def _turn(r: Sequence[Floats], moment: Sequence[Floats]) -> Floats:
    """The same by components: r 3 x (k, 3), moment 3 x (k,). By the cofactors of J / (2 tr J)."""
    x, y, z = r
    xx, yy, zz = _sum(x * x), _sum(y * y), _sum(z * z)
    size = 2.0 * (xx + yy + zz)
    scale = np.where(size > 0.0, size, 1.0)
    a, b, c = (yy + zz) / scale, (zz + xx) / scale, (xx + yy) / scale
    d, e, f = -_sum(y * z) / scale, -_sum(z * x) / scale, -_sum(x * y) / scale
    A, B, C = b * c - d * d, c * a - e * e, a * b - f * f
    D, E, F = e * f - a * d, f * d - b * e, d * e - c * f
    det = a * A + f * F + e * E
    over = np.where(det > FLAT, 1.0 / (np.where(det > FLAT, det, 1.0) * scale), 0.0)
    p, q, s = (over * one for one in moment)
    return np.stack([A * p + F * q + E * s, F * p + B * q + D * s, E * p + D * q + C * s], 1)


def _from_centroid(x: Floats) -> Floats:
    """3 x (k, 3) of corners x (k, 3, 3), by axis."""
    r = np.ascontiguousarray(np.moveaxis(x, 2, 0))
    return r - (_sum(r) / 3.0)[..., None]


def _sum(three: Floats) -> Floats:
    """Sum over the last axis, of length three: faster than NumPy's reduction, which loops
    per row.
    """
    return three[..., 0] + three[..., 1] + three[..., 2]
