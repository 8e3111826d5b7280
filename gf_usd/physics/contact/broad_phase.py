"""Broad phase: bodies and obstacles that are near each other, and for how long they are.

A pair whose boxes are apart is left alone until they could have come together.

Parts of one body: its surface is divided into patches, and every pair of them is compared.  Those
that are apart are left alone until they could have come together, those that are neighbors at rest
until the surface is folded between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.contact.carriers import cross
from gf_usd.physics.contact.narrow_phase import Obstacle


@dataclass(frozen=True, kw_only=True)
class Box:
    """A body as others come near it."""

    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    mean: Floats  # (3,) [m/s] of its samples
    spread: float  # [m/s] the fastest of them against the mean

    @classmethod
    def around(cls, x: Floats, v: Floats) -> Box:
        """Of samples at x (n, 3) [m] with v (n, 3) [m/s]."""
        mean = v.mean(0)
        off = v - mean
        fastest = float(np.sqrt(np.einsum("na,na->n", off, off).max()))
        low, high = corners(x)
        return cls(low=low, high=high, mean=mean, spread=fastest)


def schedule(
    boxes: Sequence[Box],
    obstacles: Sequence[Obstacle],
    contact_setup: ContactSetup,
    *,
    frame: float,
    fall: float,
    reach: float,
    spacing: float,
    still: Ints | None = None,
) -> tuple[list[tuple[int, int]], float]:
    """Which pairs (body, body or -1 - obstacle) are near, and for how long [s] that holds.

    frame : where the obstacles are; fall : [m/s] that gravity adds until the next detection;
    reach : [m] from where something is faced; bodies `still` (B,) do not move: what does not either
    is no concern of theirs.
    """
    near: list[tuple[int, int]] = []
    hold = float("inf")

    def until(gap: Floats, speed: Floats) -> float:
        # What no sample faces yet is farther than that off, or comes from beyond the box.
        left = np.maximum(reach, gap - spacing) / np.maximum(speed + fall, 1e-30)
        return float(left.min(initial=np.inf))

    low, high = np.array([box.low for box in boxes]), np.array([box.high for box in boxes])
    mean, spread = np.array([box.mean for box in boxes]), np.array([box.spread for box in boxes])
    speeds = [obstacle.speed(frame) for obstacle in obstacles]
    rests = np.zeros(len(boxes), bool) if still is None else np.asarray(still, bool)
    through: dict[int, list[int]] = {}
    for one, other in contact_setup.through:
        through.setdefault(max(one, other), []).append(min(one, other))

    early = frame < contact_setup.meet_from
    for a, mine in enumerate(boxes):
        met = ~rests[:a] if rests[a] else np.ones(a, bool)
        met &= not early
        met[through.get(a, [])] = False
        others = np.flatnonzero(met)
        apart = np.maximum(np.maximum(low[others] - mine.high, mine.low - high[others]), 0.0)
        gap = np.sqrt((apart * apart).sum(1))
        drift = mean[others] - mine.mean
        hold = min(hold, until(gap, np.sqrt((drift * drift).sum(1)) + mine.spread + spread[others]))
        for b in others[gap < reach].tolist():
            near += [(a, b), (b, a)]
        for k, obstacle in enumerate(obstacles):
            if (a, k) in contact_setup.through_colliders or (rests[a] and speeds[k] == 0.0):
                continue
            speed = float(np.linalg.norm(mine.mean)) + mine.spread + speeds[k]
            away = obstacle.gap(mine.low, mine.high)
            hold = min(hold, until(np.array([away]), np.array([speed])))
            if away < reach:
                near.append((a, -1 - k))
    return near, hold


PATCH = 48  # samples of a patch, about
OPPOSED = 0.5  # cosine from where two walls, or two patches, look at each other
FOLD = 0.25  # cosine by which neighboring patches turn to each other before they are looked at
CREASE = 0.75  # cosine by which they turn at most before it is looked whether they do
CHANGE = 0.5  # of a relative speed: by as much a velocity may change until the next detection
MOST = 16_000  # pairs of parts of patches that are looked at
STIR = 1e-3  # [spacings] that a patch is moved by to see how fast it turns


Columns = Sequence[Floats]  # three, of vectors: rows of three are several times as slow


def closing(away: Columns, distance: Floats, relative: Columns) -> Floats:
    """(n,) [m/s] by which distances may shrink; away : 3 x (n,) [m] from one to the other.

    relative : 3 x (n,) [m/s] of the other against the one.
    """
    along = dot(away, relative) / np.maximum(distance, 1e-30)
    return np.maximum(-along, 0.0) + CHANGE * np.sqrt(dot(relative, relative))


def spread_closing(
    away: Columns, distance: Floats, mean: Floats, spread: Floats, a: Ints, b: Ints
) -> Floats:
    """(n,) [m/s] the same of sets a and b (n,) of samples, whose velocities are mean (p, 3) [m/s]
    and up to spread (p,) [m/s] from it.
    """
    rate = closing(away, distance, differences(mean, a, b))
    rate += (1.0 + CHANGE) * (spread.take(a) + spread.take(b))
    return rate


def farthest(away: Floats, order: Ints, start: Ints) -> Floats:
    """(p,) the longest of vectors (n, 3) of each set: those of `order` from its start (p,) on."""
    squared = np.einsum("na,na->n", away, away)
    return np.sqrt(np.maximum.reduceat(squared[order], start))


def each_with_each(first: Ints, count: Ints, a: Ints, b: Ints) -> tuple[Ints, Ints, Ints]:
    """Every pair (m,), (m,) of a member of a set and one of its partner, sets a and b (k,).

    Third come where those of each of the k begin.  first, count : (p,) the members of a set are so
    many numbers from its first on.
    """
    size = count[a] * count[b]
    start = np.cumsum(size) - size
    of = np.repeat(np.arange(len(a)), size)
    i, j = np.divmod(np.arange(len(of)) - start[of], count[b][of])
    return first[a][of] + i, first[b][of] + j, start


def dot(p: Columns, q: Columns) -> Floats:
    """(n,) of vectors in columns."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def differences(q: Floats, a: Ints, b: Ints) -> Columns:
    """q_b - q_a, 3 x (k,), of rows a (k,) and b (k,) of q (n, 3)."""
    x, y, z = np.ascontiguousarray(q.T)
    return x.take(b) - x.take(a), y.take(b) - y.take(a), z.take(b) - z.take(a)


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Every pair of patches at one time."""

    near: Ints  # (P,) whether they may be near each other
    gap: Floats  # (P,) [m] between the balls around them
    until: Floats  # (P,) [s] before they are not; 0 where they are; inf where they are neighbors
    rate: Floats  # (P,) [m/s] at which they may come together
    fold: float  # [s] before neighbors may be folded onto each other


class Patches:
    """The surface of a body at rest in patches: X, normal (n, 3) of its samples.

    see : [spacings] from where patches are near; thick : [spacings] through a limb.
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
        t1 = np.cross(n0, axis)
        t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
        t2 = np.cross(n0, t1)
        away = X - (mean @ X)[self._of]
        # x = c + a t1 + b t2 by least squares over each patch: two rows of sums of x.
        a, b = (away * t1[self._of]).sum(1), (away * t2[self._of]).sum(1)
        aa, ab, bb = (np.bincount(self._of, p) for p in (a * a, a * b, b * b))
        determinant = aa * bb - ab * ab
        flat = determinant > 1e-6 * np.maximum(aa, bb) ** 2
        scale = np.where(flat, 1.0 / np.where(flat, determinant, 1.0), 0.0)
        first = (bb[self._of] * a - ab[self._of] * b) * scale[self._of]
        second = (aa[self._of] * b - ab[self._of] * a) * scale[self._of]
        self._mean = mean
        self._parts = _Parts(X, self._of, 0.5 * edge)
        self._first = csr_matrix((first[columns], (rows, columns)))
        self._second = csr_matrix((second[columns], (rows, columns)))
        self._a, self._b = np.triu_indices(len(self._count), 1)
        self._spacing, self._see = spacing, see * spacing
        c, n, r = self._shape(X)
        gap, look = self._gap(differences(c, self._a, self._b), r), self._look(c, n, None)
        self.adjacent = gap < (see + thick) * spacing  # (P,) neighbors at rest
        opposed = np.einsum("na,na->n", n[self._a], n[self._b]) < -OPPOSED
        walls = opposed & (look > OPPOSED)  # of a gap: they may close at any time
        self._folds = np.flatnonzero(self.adjacent & ~walls)
        self._look0 = np.maximum(look, 0.0)[self._folds]

    def judge(self, x: Floats, v: Floats) -> Judged:
        """How near the patches are to each other; x, v : (n, 3) [m], [m/s] of the samples."""
        a, b, s = self._a, self._b, self._spacing
        c, n, r = self._shape(x)
        away = differences(c, a, b)
        distance = np.sqrt(dot(away, away))
        gap = distance - r.take(a) - r.take(b)
        mean = self._mean @ v
        spread = self._farthest(v - mean[self._of])
        rate = spread_closing(away, distance, mean, spread, a, b)
        look = self._look(c, n, self._folds)
        open_ = look <= self._look0 + FOLD
        waits = np.zeros(len(a), bool)  # for a fold
        waits[self._folds] = open_
        close = gap < self._see
        near = close & ~waits
        rest = np.flatnonzero(near & ~self.adjacent)
        near[rest] = self._look(c, n, rest) > -OPPOSED
        until = np.maximum(gap - 0.5 * self._see, 0.5 * self._see) / np.maximum(rate, 1e-30)
        until[near], until[waits] = 0.0, np.inf
        fold = np.inf
        fastest = float(np.sqrt(np.einsum("na,na->n", v, v).max()))
        if (some := np.flatnonzero(open_ & close[self._folds])).size and fastest > 0.0:
            step = STIR * s / fastest
            later = self._look(c + step * mean, self._normal(x + step * v), self._folds[some])
            left = self._look0[some] + CREASE - look[some]
            turn = np.maximum(later - look[some], 1e-30) / step
            fold = float((left / turn).min()) / (1.0 + CHANGE)
        return Judged(near=near, gap=gap, until=until, rate=rate, fold=fold)

    def unseen(self, judged: Judged, x: Floats, v: Floats, span: float, clear: float) -> Floats:
        """(P,) [s] before what samples of a pair do not see comes as near as it must be seen.

        Pairs that are near are seen, so that what is farther off may come as near as `clear` [m];
        others may come to half of what is seen.  What is sooner than span [s] by the patches, and
        of that the first, is asked of parts of them: samples that are close move alike.
        """
        until = judged.until.copy()
        left = np.where(judged.near, clear, 0.5 * self._see)
        near = np.flatnonzero(judged.near)
        until[near] = (self._see - clear) / np.maximum(judged.rate[near], 1e-30)
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

    def few(self, until: Floats, span: float, most: int) -> Ints:
        """The pairs of patches that may meet first, by until (P,) [s], and within a span [s].

        most : pairs of samples that they have at most.
        """
        pairs = np.flatnonzero(until < span)
        pairs = pairs[np.argsort(until[pairs], kind="stable")]
        size = np.cumsum(self._count[self._a[pairs]] * self._count[self._b[pairs]])
        return pairs[size <= most]

    def around(self, judged: Judged, some: Ints) -> Ints:
        """(n,) whether samples are of patches that may be near one, or of those of samples `some`
        (n,)."""
        looks = np.zeros(len(self._count), bool)
        looks[self._of[some]] = True
        looks[self._a[judged.near]] = looks[self._b[judged.near]] = True
        return looks[self._of]

    def samples(self, pairs: Ints) -> tuple[Ints, Ints, Ints]:
        """Every pair (m,), (m,) of samples of pairs (k,) of patches, and where each (k,) begins."""
        i, j, start = each_with_each(self._start, self._count, self._a[pairs], self._b[pairs])
        return self._order[i], self._order[j], start

    def _shape(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Center (p, 3) [m], normal (p, 3) and radius (p,) [m] of each patch."""
        c = self._mean @ x
        return c, self._normal(x), self._farthest(x - c[self._of])

    def _normal(self, x: Floats) -> Floats:
        # t1 x t2 = n0 (t2 = n0 x t1 gives t1 x t2 = n0).
        n = cross(self._first @ x, self._second @ x)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        return n / np.where(length > 0.0, length, 1.0)

    def _farthest(self, away: Floats) -> Floats:
        return farthest(away, self._order, self._start)

    def _gap(self, away: Columns, r: Floats) -> Floats:
        """(P,) [m] between the balls around the two of each pair, whose middles are away."""
        return np.sqrt(dot(away, away)) - r.take(self._a) - r.take(self._b)

    def _look(self, c: Floats, n: Floats, pairs: Ints | None) -> Floats:
        """The cosine by which both of some pairs look at each other; None: of all."""
        a = self._a if pairs is None else self._a[pairs]
        b = self._b if pairs is None else self._b[pairs]
        along = differences(c, a, b)
        columns = np.ascontiguousarray(n.T)
        one = dot(along, tuple(q.take(a) for q in columns))
        other = dot(along, tuple(q.take(b) for q in columns))
        return np.minimum(one, -other) / np.maximum(np.sqrt(dot(along, along)), 1e-30)


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
        """[m] between the balls around every part of a patch a (k,) and of its partner in b (k,),
        [m/s] at which they may come together, and where those of each pair (k,) begin.
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
