"""Smooth skinning decomposition: moving points as rigid joints, with few weights per point.

    x_v(t) ~ sum_j w_vj (R_j(t) p_v + d_j(t)),    w_vj >= 0,  sum_j w_vj = 1

with at most four joints j for each point v of rest position p_v, after B. H. Le and Z. Deng,
Smooth skinning decomposition with rigid bones, ACM Transactions on Graphics 31(6), 2012.  Weights
and transforms are solved in turn: the weights of a point by least squares with these bounds, the
transforms of a joint by a weighted Kabsch fit to the residual of the other joints.  Joints are
added where the error is largest, until it is within the tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints

INFLUENCES = 4  # joints of a point: what glTF's first set and most engines take
STEPS = 255  # weights are multiples of 1/255, as glTF's normalized bytes
CANDIDATES = 12  # joints that a point chooses its four from
FIRST = 8  # joints to begin with
LEAST = 0.06  # of the joints there are: so many come at once where few are needed
GROWTH = 1.35  # of the number of joints from one try to the next
SWEEPS = 5  # of weights and transforms for each number of joints
CHUNK = 2_000_000  # numbers of a temporary table
FITTED = 10_000  # points that transforms are fitted to at most; weights are those of all
EVEN = 0.1  # weight of errors next to the largest one, which has 1 more
RIDGE = 1e-9  # of the trace, added to the diagonal: joints that move alike make it singular


@dataclass(frozen=True, kw_only=True)
class Skinning:
    """Joints and weights; transforms take rest positions to the frames."""

    rotations: Floats  # (J, T, 3, 3) for column vectors
    translations: Floats  # (J, T, 3)
    joints: Ints  # (V, 4) into the joints, largest weight first; 0 where the weight is 0
    weights: Ints  # (V, 4) in units of 1/255; a row adds up to 255

    def __len__(self) -> int:
        return len(self.rotations)

    def pose(self, rest: Floats) -> Floats:
        """(T, V, 3) positions of the points rest (V, 3)."""
        return _pose(
            rest, self.rotations, self.translations, self.joints, self.weights / STEPS
        ).transpose(1, 0, 2)


def kabsch(p: Floats, x: Floats, a: Floats) -> tuple[Floats, Floats]:
    """The rigid transforms that minimize sum_v a_v |R p_v + d - x_v|^2 in each frame.

    p (n, 3), x (T, n, 3), a (n,) or (T, n) weights; returns R (T, 3, 3) and d (T, 3).
    W. Kabsch, Acta Crystallographica A32, 1976.
    """
    a = np.broadcast_to(a, x.shape[:2])
    a = a / np.maximum(a.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    p_mean, x_mean = a @ p, np.einsum("tn,tnk->tk", a, x)
    spread = np.matmul(
        ((p - p_mean[:, None]) * a[..., None]).transpose(0, 2, 1), x - x_mean[:, None]
    )
    u, _, vt = np.linalg.svd(spread)
    turn = np.matmul(u, vt)
    u[:, :, 2] *= np.where(np.linalg.det(turn) < 0.0, -1.0, 1.0)[:, None]
    R = np.matmul(u, vt).transpose(0, 2, 1)
    return R, x_mean - np.einsum("tij,tj->ti", R, p_mean)


def simplex_weights(G: Floats, most: int = INFLUENCES) -> Floats:
    """(n, K) weights w >= 0 with sum 1 that make w' G w small, of which `most` are not zero.

    G (n, K, K) are the products of the residuals that each joint would leave alone.  The least
    of w' G w with sum 1 is solved over all K, then again without the most negative weight of each
    row, and without the smallest while more than `most` are left.
    """
    n, K = G.shape[:2]
    trace = np.maximum(np.trace(G, axis1=1, axis2=2), np.finfo(float).tiny)
    G = G / trace[:, None, None] + RIDGE * np.eye(K)
    weights = np.zeros((n, K))
    rows, free = np.arange(n), np.ones((n, K), bool)
    while len(rows):
        mine = free[rows]
        A = np.where(mine[:, :, None] & mine[:, None, :], G[rows], np.eye(K))
        w = np.linalg.solve(A, mine.astype(float)[:, :, None])[..., 0] * mine
        w /= w.sum(axis=1, keepdims=True)
        worst = np.where(mine, w, np.inf).argmin(axis=1)
        least = w[np.arange(len(rows)), worst]
        go_on = (least < 0.0) | (mine.sum(axis=1) > most)
        weights[rows[~go_on]] = w[~go_on]
        free[rows[go_on], worst[go_on]] = False
        rows = rows[go_on]
    return weights


def left_alone(p: Floats, x: Floats, u: Floats, R: Floats, d: Floats) -> Floats:
    """(n, J) sum_t u_vt |R_jt p_v + d_jt - x_vt|^2: the error of each joint alone.

    Expanded, it is a sum of products of terms of the points with terms of the joints, two matrix
    products.  Its rounding error is that of |x|^2, so that it is only used to select joints.

    p (n, 3), x (n, T, 3), u (n, T), R (J, T, 3, 3), d (J, T, 3).
    """
    n, J = len(u), len(R)
    pulled = u[:, :, None] * x
    cross = (
        np.concatenate(
            [(pulled[..., None] * p[:, None, None, :]).reshape(n, -1), pulled.reshape(n, -1)],
            axis=1,
        )
        @ np.concatenate([R.reshape(J, -1), d.reshape(J, -1)], axis=1).T
    )
    back = np.matmul(d[:, :, None, :], R)[:, :, 0]  # R' d
    square = (
        np.concatenate([(u[:, :, None] * p[:, None, :]).reshape(n, -1), u], axis=1)
        @ np.concatenate([2.0 * back.reshape(J, -1), (d * d).sum(axis=2)], axis=1).T
    )
    still = u.sum(axis=1) * (p * p).sum(axis=1) + np.einsum("nt,ntk,ntk->n", u, x, x)
    return still[:, None] + square - 2.0 * cross


def quantized(weights: Floats) -> Ints:
    """(n, k) whole multiples of 1/255 nearest to weights (n, k), each row with the sum 255."""
    scaled = weights * STEPS
    whole = np.floor(scaled).astype(np.int64)
    missing = STEPS - whole.sum(axis=1)
    order = np.argsort(whole - scaled, axis=1, kind="stable")
    rank = np.argsort(order, axis=1, kind="stable")
    return whole + (rank < missing[:, None])


def decompositions(
    rest: Floats, frames: Floats, tolerance: float, most: int
) -> Iterator[tuple[Skinning, float]]:
    """Skinnings with more and more joints, and the largest error of each.

    The last one has an error of at most `tolerance`, or `most` joints.  Transforms are fitted to
    FITTED points at most, and in addition to the points with the largest errors.

    rest (V, 3), frames (T, V, 3), tolerance : in one unit of length.
    """
    same = np.concatenate([rest, frames.transpose(1, 0, 2).reshape(len(rest), -1)], axis=1)
    # points that move as one have the same weights: no crack opens along a seam of a mesh
    _, first, of = np.unique(same, axis=0, return_index=True, return_inverse=True)
    of = of.reshape(-1)
    whole = _Fit(rest[first], frames[:, first].transpose(1, 0, 2))
    chosen = np.sort(np.random.default_rng(0).permutation(len(first))[:FITTED])
    fit = whole if len(chosen) == len(first) else whole.part(chosen)
    count = min(FIRST, most, len(first))
    while True:
        fit.add_joints(count - len(fit.R), tolerance)
        fit.u[:] = 1.0
        for sweep in range(SWEEPS):
            fit.solve_weights()
            fit.solve_transforms()
            if sweep:
                fit.stress_errors()
        found = fit.rounded()
        if fit is not whole:
            found = whole.with_transforms(found)
        error = whole.largest_error()
        yield (
            Skinning(
                rotations=found.rotations, translations=found.translations,
                joints=found.joints[of], weights=found.weights[of],
            ),
            error,
        )  # fmt: skip
        if error <= tolerance or len(fit.R) >= min(most, len(first)):
            return
        if fit is not whole:
            far = np.argsort(-whole.errors().max(axis=1), kind="stable")[: FITTED // 10]
            chosen = np.union1d(chosen, far)
            fit = whole.part(chosen)
        wanted = len(fit.R) * min(2.0, max(GROWTH, 0.8 * error / tolerance))
        count = min(max(int(wanted), len(fit.R) + 1), most, len(first))


def _pose(p: Floats, R: Floats, d: Floats, index: Ints, w: Floats) -> Floats:
    """(V, T, 3); the arrays as in `Skinning`, weights as numbers."""
    x = np.zeros((len(p), R.shape[1], 3))
    for j in range(len(R)):
        at, slot = np.nonzero((index == j) & (w > 0.0))
        if len(at):
            moved = np.matmul(R[j], p[at].T).transpose(2, 0, 1) + d[j]
            x[at] += w[at, slot, None, None] * moved
    return x


class _Fit:
    """The state of a decomposition; x (V, T, 3)."""

    def __init__(self, p: Floats, x: Floats) -> None:
        self.p, self.x = p, x
        frames = x.shape[1]
        self.R = np.zeros((0, frames, 3, 3))
        self.d = np.zeros((0, frames, 3))
        self.index = np.zeros((len(p), INFLUENCES), np.int64)
        self.w = np.zeros((len(p), INFLUENCES))
        self.y = np.zeros_like(x)  # what the joints make of p
        self.u = np.ones(x.shape[:2])  # (V, T) weights of the errors

    def part(self, rows: Ints) -> _Fit:
        """The state of some of the points, with the same joints."""
        fit = _Fit(self.p[rows], self.x[rows])
        fit.R, fit.d = self.R.copy(), self.d.copy()
        fit.index, fit.w, fit.y = self.index[rows], self.w[rows], self.y[rows]
        return fit

    def with_transforms(self, found: Skinning) -> Skinning:
        """All points on the joints of a skinning, with the weights that suit them."""
        self.R, self.d = found.rotations, found.translations
        self.u[:] = 1.0
        self.solve_weights()
        whole = self.round_weights()
        return Skinning(
            rotations=self.R, translations=self.d, joints=self.index.copy(), weights=whole
        )

    def errors(self) -> Floats:
        """(V, T) distances."""
        return np.sqrt(((self.y - self.x) ** 2).sum(axis=2))

    def largest_error(self) -> float:
        """Over all points and frames."""
        return float(self.errors().max())

    def stress_errors(self) -> None:
        """Have the next sweep weigh large errors more, since the largest one counts."""
        e = self.errors()
        self.u = (e / max(float(e.max()), np.finfo(float).tiny)) ** 2 + EVEN

    def add_joints(self, count: int, tolerance: float) -> None:
        """Joints where the error is largest, each fitted to the points around it.

        At most `count`; fewer, down to a share of those there are, once the error is within the
        tolerance around all of them.
        """
        tiny = np.finfo(float).tiny
        spread_out = not len(self.R)
        left = np.full(len(self.p), np.inf) if spread_out else self.errors().max(axis=1)
        near = max(len(self.p) // (2 * (len(self.R) + count)), min(12, len(self.p)))
        R: list[Floats] = []
        d: list[Floats] = []
        for _ in range(count):
            at = int(left.argmax())
            if len(R) >= LEAST * len(self.R) and not spread_out and left[at] <= tolerance:
                break
            gap = ((self.p - self.p[at]) ** 2).sum(axis=1)
            mine = np.argpartition(gap, near - 1)[:near]
            reach = max(float(gap[mine].max()), tiny)
            turned, moved = kabsch(
                self.p[mine], self.x[mine].transpose(1, 0, 2), np.exp(-2.0 * gap[mine] / reach)
            )
            R.append(turned)
            d.append(moved)
            if spread_out:
                left = np.minimum(left, gap)
            else:  # the points that it was fitted to are served
                left = left * np.minimum(1.0, gap / (2.0 * reach))
        self.R = np.concatenate([self.R, np.array(R)])
        self.d = np.concatenate([self.d, np.array(d)])

    def solve_weights(self) -> None:
        """The best four joints of each point, and their weights."""
        J, T = self.d.shape[:2]
        K = min(CANDIDATES, J)
        rows = max(1, CHUNK // (T * max(12, 3 * K)))
        turn, shift = self.R.reshape(J, T * 3, 3), self.d.reshape(J, T * 3)
        root = np.repeat(np.sqrt(self.u), 3, axis=1)
        for start in range(0, len(self.p), rows):
            part = slice(start, start + rows)
            p, x, u = self.p[part], self.x[part], self.u[part]
            near = np.argpartition(left_alone(p, x, u, self.R, self.d), K - 1, axis=1)[:, :K]
            chosen = np.matmul(turn[near], p[:, None, :, None])[..., 0] + shift[near]
            chosen -= x.reshape(-1, 1, T * 3)
            chosen *= root[part, None]
            w = simplex_weights(np.matmul(chosen, chosen.transpose(0, 2, 1)))
            order = np.argsort(-w, axis=1, kind="stable")[:, :INFLUENCES]
            count = order.shape[1]
            self.w[part, :count] = np.take_along_axis(w, order, axis=1)
            self.index[part, :count] = np.take_along_axis(near, order, axis=1)
        self.index[self.w <= 0.0] = 0
        self.y = _pose(self.p, self.R, self.d, self.index, self.w)

    def solve_transforms(self) -> None:
        """One joint after the other, fitted to what the others leave."""
        for j in range(len(self.R)):
            at, slot = np.nonzero((self.index == j) & (self.w > 0.0))
            if len(at) < INFLUENCES:
                continue  # too few points to determine its rotation
            w = self.w[at, slot, None, None]
            mine = np.matmul(self.R[j], self.p[at].T).transpose(2, 0, 1) + self.d[j]
            wanted = mine + (self.x[at] - self.y[at]) / w
            a = self.u[at].T * w[:, 0, 0] ** 2
            R, d = kabsch(self.p[at], wanted.transpose(1, 0, 2), a)
            moved = np.matmul(R, self.p[at].T).transpose(2, 0, 1) + d
            self.y[at] += w * (moved - mine)
            self.R[j], self.d[j] = R, d

    def rounded(self) -> Skinning:
        """The form that is written: weights in steps of 1/255, and transforms solved for these."""
        whole = self.round_weights()
        self.solve_transforms()
        return Skinning(
            rotations=self.R.copy(), translations=self.d.copy(), joints=self.index, weights=whole
        )

    def round_weights(self) -> Ints:
        """Gives the points weights in units of 1/255, the largest first: (V, 4)."""
        whole = quantized(self.w)
        order = np.argsort(-whole, axis=1, kind="stable")
        whole = np.take_along_axis(whole, order, axis=1)
        self.index = np.where(whole > 0, np.take_along_axis(self.index, order, axis=1), 0)
        self.w = whole / STEPS
        self.y = _pose(self.p, self.R, self.d, self.index, self.w)
        return whole
