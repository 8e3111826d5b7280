"""How a pinned region moves between its anchors.

Anchors are points whose place is known at every frame.  Any other point of the region moves by the
map that fits the anchors near it best, with weights w_j that fall off with distance,

    x(X) = xbar + A (X - Xbar),    A = argmin sum_j w_j |A (X_j - Xbar) - (x_j - xbar)|^2

affine where the anchors fill space, else the nearest rotation (Kabsch 1976): anchors on a flat face
say nothing of the stretch across it.
"""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats
from gf_usd.nearby import kd_tree

NEIGHBOURS = 24
SAME = 1e-6  # of the region's size: a point as near to an anchor as that moves with it
FLAT = 1e-3  # ratio of the spreads of the anchors under which they count as flat


class Motion:
    """The motion of one pin; frames outside the path stay at its ends."""

    def __init__(self, anchors: Floats, path: Floats) -> None:
        self.anchors, self.path = np.asarray(anchors, float), np.asarray(path, float)
        still = len(self.path) < 2 or np.array_equal(self.path, self.path[:1].repeat(len(path), 0))
        self.moving = not (still and np.array_equal(self.path[0], self.anchors))
        self._tree = kd_tree(self.anchors)
        self._extent = float(np.linalg.norm(np.ptp(self.anchors, axis=0)))

    def anchors_at(self, frame: float) -> Floats:
        """(k, 3) [m], linear between frames."""
        frame = float(np.clip(frame, 0.0, len(self.path) - 1))
        low = min(int(frame), max(len(self.path) - 2, 0))
        high = min(low + 1, len(self.path) - 1)
        t = frame - low
        return (1.0 - t) * self.path[low] + t * self.path[high]

    def at(self, X: Floats, frame: float) -> tuple[Floats, Floats]:
        """x (n, 3) [m] and A (n, 3, 3) of points X (n, 3) [m]."""
        now = self.anchors_at(frame)
        k = min(NEIGHBOURS, len(self.anchors))
        distance, near = self._tree.query(X, k=k)
        distance, near = distance.reshape(len(X), k), near.reshape(len(X), k)
        scale = distance.mean(1, keepdims=True) + 1e-300
        w = 1.0 / (1.0 + (distance / scale) ** 2)
        w /= w.sum(1, keepdims=True)
        P, Q = self.anchors[near], now[near]
        Pbar, Qbar = (np.einsum("nk,nka->na", w, S) for S in (P, Q))
        P, Q = P - Pbar[:, None], Q - Qbar[:, None]
        C = np.einsum("nk,nka,nkb->nab", w, P, P)
        B = np.einsum("nk,nka,nkb->nab", w, Q, P)
        spread = np.linalg.eigvalsh(C)
        solid = spread[:, 0] > FLAT * spread[:, 2]
        safe = np.where(solid[:, None, None], C, np.eye(3))
        A = np.where(solid[:, None, None], B @ np.linalg.inv(safe), kabsch(B))
        x = Qbar + np.einsum("nab,nb->na", A, X - Pbar)
        known = distance[:, 0] <= SAME * self._extent
        x[known] = now[near[known, 0]]
        return x, A


def kabsch(B: Floats) -> Floats:
    """Rotations (n, 3, 3) nearest to B = sum w q p^T, of determinant +1."""
    U, _, Vt = np.linalg.svd(B)
    sign = np.sign(np.linalg.det(U @ Vt))
    U[:, :, 2] *= np.where(sign < 0.0, -1.0, 1.0)[:, None]
    return U @ Vt
