"""Broad phase of self-contact: patches of the surface that may be near each other, and when.

The surface of a body is divided into patches, and every pair of them is compared by bounding
spheres.  A pair that is apart is skipped until it could have come together; a pair of neighbors at
rest is skipped until the surface is folded between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.physics.contact.self_contact.patch_tables import (
    CHANGE,
    COSINE,
    FOLD_TIME,
    FOLDS,
    GAP,
    MEAN,
    NEIGHBORS,
    NORMAL,
    OPPOSED,
    PAIR_COLUMNS,
    PATCH_COLUMNS,
    RATE,
    UNTIL,
)
from gf_usd.system.taichi_runtime import ensure_running

PATCH = 48  # samples of a patch, about
MOST = 16_000  # pairs of parts of patches that are compared
STIR = 1e-3  # [spacings] step of the finite difference for the rate at which patches turn

Columns = Sequence[Floats]  # x, y and z of vectors: rows of three are several times as slow


def closing(away: Columns, distance: Floats, relative: Columns) -> Floats:
    """(n,) [m/s] bound of the rate at which distances shrink until the next detection.

    away : 3 x (n,) [m] from one point to the other; distance : (n,) [m], its length;
    relative : 3 x (n,) [m/s] velocity of the other against the one.
    """
    along = dot(away, relative) / np.maximum(distance, 1e-30)
    return np.maximum(-along, 0.0) + CHANGE * np.sqrt(dot(relative, relative))


def spread_closing(
    away: Columns, distance: Floats, mean: Floats, spread: Floats, a: Ints, b: Ints
) -> Floats:
    """(n,) [m/s] the same bound for sets a and b (n,) of samples.

    mean : (p, 3) [m/s] mean velocity of each set; spread : (p,) [m/s] largest deviation from it.
    """
    rate = closing(away, distance, differences(mean, a, b))
    rate += (1.0 + CHANGE) * (spread.take(a) + spread.take(b))
    return rate


def farthest(away: Floats, order: Ints, start: Ints) -> Floats:
    """(p,) length of the longest of vectors (n, 3) of each set, whose members are those of `order`
    from start (p,) on."""
    squared = np.einsum("na,na->n", away, away)
    return np.sqrt(np.maximum.reduceat(squared[order], start))


def each_with_each(first: Ints, count: Ints, a: Ints, b: Ints) -> tuple[Ints, Ints, Ints]:
    """All pairs of a member of set a_k and a member of set b_k, for pairs of sets a, b (k,).

    Returns the members (m,) and (m,), and where those of each pair of sets begin (k,).
    first, count : (p,) the members of a set are `count` numbers from `first` on.
    """
    size = count[a] * count[b]
    start = np.cumsum(size) - size
    of = np.repeat(np.arange(len(a)), size)
    i, j = np.divmod(np.arange(len(of)) - start[of], count[b][of])
    return first[a][of] + i, first[b][of] + j, start


def dot(p: Columns, q: Columns) -> Floats:
    """(n,) dot products of vectors in columns."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def differences(q: Floats, a: Ints, b: Ints) -> Columns:
    """q_b - q_a, 3 x (k,), of rows a (k,) and b (k,) of q (n, 3)."""
    x, y, z = np.ascontiguousarray(q.T)
    return x.take(b) - x.take(a), y.take(b) - y.take(a), z.take(b) - z.take(a)


@dataclass(frozen=True, kw_only=True)
class PatchPairs:
    """All P pairs of patches at one time."""

    near: Ints  # (P,) whether samples of the two may be in contact
    gap: Floats  # (P,) [m] between their bounding spheres
    until: Floats  # (P,) [s] until they may be near; 0: they are; inf: neighbors, not folded
    rate: Floats  # (P,) [m/s] bound of the rate at which the gap shrinks
    fold: float  # [s] until neighbors may be folded onto each other


class Patches:
    """Patches of the contact samples of one body.

    X, normal : (n, 3) samples at rest; see : [spacings] gap below which patches are near;
    thick : [spacings] patches that are nearer than that beyond `see` at rest are neighbors.
    """

    def __init__(
        self, X: Floats, normal: Floats, spacing: float, *, see: float, thick: float
    ) -> None:
        from scipy.sparse import csr_matrix

        edge = np.sqrt(PATCH * max(1.0, len(X) / 6000.0)) * spacing
        side = np.abs(normal).argmax(1)
        cell = np.floor((X - X.min(0)) / edge).astype(np.int64)
        way = 2 * side + (np.take_along_axis(normal, side[:, None], 1)[:, 0] > 0.0)
        _, of = np.unique(np.column_stack([cell, way]), axis=0, return_inverse=True)
        self._of = of.reshape(-1)
        self._order = np.argsort(self._of, kind="stable")
        self._count = np.bincount(self._of)
        self._start = np.cumsum(self._count) - self._count
        rows, columns = self._of[self._order], self._order
        mean = csr_matrix((1.0 / self._count[rows], (rows, columns)))
        n0 = mean @ normal
        size = np.linalg.norm(n0, axis=1, keepdims=True)
        # a sample where sides of a sheet meet may have no normal: any frame serves its patch
        n0 = np.where(size > 1e-12, n0 / np.maximum(size, 1e-12), np.eye(3)[2])
        axis = np.eye(3)[np.abs(n0).argmin(1)]
        t1 = cross(n0, axis)
        t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
        t2 = cross(n0, t1)
        away = X - (mean @ X)[self._of]
        # x = c + a t1 + b t2 by least squares over each patch: two rows of sums of x.
        a, b = (away * t1[self._of]).sum(1), (away * t2[self._of]).sum(1)
        aa, ab, bb = (np.bincount(self._of, p) for p in (a * a, a * b, b * b))
        determinant = aa * bb - ab * ab
        flat = determinant > 1e-6 * np.maximum(aa, bb) ** 2
        scale = np.where(flat, 1.0 / np.where(flat, determinant, 1.0), 0.0)
        first = (bb[self._of] * a - ab[self._of] * b) * scale[self._of]
        second = (aa[self._of] * b - ab[self._of] * a) * scale[self._of]
        self._samples = self._order.astype(np.int32)
        self._starts = np.append(self._start, len(X)).astype(np.int32)
        self._slopes = np.stack([first[columns], second[columns]], 1)
        self._parts = _Parts(X, self._of, 0.5 * edge)
        self._a, self._b = np.triu_indices(len(self._count), 1)
        self._spacing, self._see = spacing, see * spacing
        self._members = np.stack([self._a, self._b], 1).astype(np.int32)
        self._kind = np.zeros(len(self._a), np.int32)
        self._cosine_at_rest = np.zeros(len(self._a))
        patches, pairs, _ = self._compared(X, np.zeros_like(X))
        n, cosine = patches[:, NORMAL:MEAN], pairs[:, COSINE]
        self.adjacent = pairs[:, GAP] < (see + thick) * spacing  # (P,) neighbors at rest
        opposed = np.einsum("na,na->n", n[self._a], n[self._b]) < -OPPOSED
        walls = opposed & (cosine > OPPOSED)  # of a gap: they may close at any time
        self._kind[self.adjacent] = NEIGHBORS
        self._kind[self.adjacent & ~walls] |= FOLDS
        self._cosine_at_rest = np.maximum(cosine, 0.0)

    def pairs(self, x: Floats, v: Floats) -> PatchPairs:
        """All pairs of patches with samples at x (n, 3) [m] and velocities v (n, 3) [m/s]."""
        _, pairs, near = self._compared(x, v)
        return PatchPairs(
            near=near, gap=pairs[:, GAP], until=pairs[:, UNTIL], rate=pairs[:, RATE],
            fold=float(pairs[:, FOLD_TIME].min(initial=np.inf)),
        )  # fmt: skip

    def _compared(self, x: Floats, v: Floats) -> tuple[Floats, Floats, Ints]:
        """The tables of patches (p, `PATCH_COLUMNS`) and of pairs (P, `PAIR_COLUMNS`), and (P,)
        whether samples of the two may be in contact."""
        ensure_running()
        from gf_usd.physics.contact.self_contact.patch_kernels import compare_patches

        x, v = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(v, np.float64)
        fastest = float(np.sqrt(np.einsum("na,na->n", v, v).max()))
        time = STIR * self._spacing / fastest if fastest > 0.0 else 0.0
        patches = np.empty((len(self._count), PATCH_COLUMNS))
        pairs = np.empty((len(self._kind), PAIR_COLUMNS))
        near = np.empty(len(self._kind), np.int32)
        compare_patches(
            x, v, self._samples, self._starts, self._slopes, self._members, self._kind,
            self._cosine_at_rest, self._see, time, patches, pairs, near,
        )  # fmt: skip
        return patches, pairs, near != 0

    def unseen(self, pairs: PatchPairs, x: Floats, v: Floats, span: float, clear: float) -> Floats:
        """(P,) [s] for which the detection of now misses no contact of each pair.

        Samples of pairs that are near search within `see`: others of them may come as near as
        `clear` [m].  Pairs that are not near may come to half of `see`.  Where the bounds of
        patches give less than a span [s], those of their parts, whose velocities differ less, are
        computed, the most urgent pairs first and up to MOST pairs of parts.
        """
        until = pairs.until.copy()
        left = np.where(pairs.near, clear, 0.5 * self._see)
        near = np.flatnonzero(pairs.near)
        until[near] = (self._see - clear) / np.maximum(pairs.rate[near], 1e-30)
        some = np.flatnonzero(until < span)
        some = some[np.argsort(until[some], kind="stable")]
        some = some[: self._parts.fitting(self._a[some], self._b[some])]
        if len(some):
            gap, rate, start = self._parts.pairs(self._a[some], self._b[some], x, v)
            far = np.repeat(left[some], np.diff(np.append(start, len(gap))))
            later = np.maximum(gap, self._see) - far
            least = np.minimum.reduceat(later / np.maximum(rate, 1e-30), start)
            until[some] = np.maximum(until[some], least)
        return until

    def soonest(self, until: Floats, span: float, most: int) -> Ints:
        """Pairs of patches with the least until (P,) [s], below a span [s].

        most : bound of the number of their pairs of samples.
        """
        pairs = np.flatnonzero(until < span)
        pairs = pairs[np.argsort(until[pairs], kind="stable")]
        size = np.cumsum(self._count[self._a[pairs]] * self._count[self._b[pairs]])
        return pairs[size <= most]

    def samples_near(self, pairs: PatchPairs, some: Ints) -> Ints:
        """(n,) whether samples are of patches that are near another one, or that hold samples of
        the mask `some` (n,)."""
        chosen = np.zeros(len(self._count), bool)
        chosen[self._of[some]] = True
        chosen[self._a[pairs.near]] = chosen[self._b[pairs.near]] = True
        return chosen[self._of]

    def samples(self, pairs: Ints) -> tuple[Ints, Ints, Ints]:
        """All pairs of samples (m,), (m,) of pairs (k,) of patches; those of each begin at (k,)."""
        i, j, start = each_with_each(self._start, self._count, self._a[pairs], self._b[pairs])
        return self._order[i], self._order[j], start


class _Parts:
    """Patches `of` (n,) of samples X (n, 3) [m] at rest, divided by cells of an edge [m]."""

    def __init__(self, X: Floats, of: Ints, edge: float) -> None:
        from scipy.sparse import csr_matrix

        cell = np.floor((X - X.min(0)) / edge).astype(np.int64)
        found, part = np.unique(np.column_stack([of, cell]), axis=0, return_inverse=True)
        self._of = part.reshape(-1)
        self._order = np.argsort(self._of, kind="stable")
        count = np.bincount(self._of)
        self._start = np.cumsum(count) - count
        rows = self._of[self._order]
        self._mean = csr_matrix((1.0 / count[rows], (rows, self._order)))
        self._count = np.bincount(found[:, 0])  # parts of each patch
        self._first = np.cumsum(self._count) - self._count

    def fitting(self, a: Ints, b: Ints) -> int:
        """How many of the first pairs (k,) of patches have no more than MOST pairs of parts."""
        return int(np.searchsorted(np.cumsum(self._count[a] * self._count[b]), MOST, "right"))

    def pairs(self, a: Ints, b: Ints, x: Floats, v: Floats) -> tuple[Floats, Floats, Ints]:
        """Bounds for all pairs of parts of patches a and b (k,).

        Returns the gaps between bounding spheres (m,) [m], the rates (m,) [m/s] at which these may
        shrink, and where the pairs of parts of each pair of patches begin (k,).
        """
        i, j, start = each_with_each(self._first, self._count, a, b)
        c, mean = self._mean @ x, self._mean @ v
        r, spread = (
            farthest(q - middle[self._of], self._order, self._start)
            for q, middle in ((x, c), (v, mean))
        )
        away = differences(c, i, j)
        distance = np.sqrt(dot(away, away))
        rate = spread_closing(away, distance, mean, spread, i, j)
        return distance - r.take(i) - r.take(j), rate, start
