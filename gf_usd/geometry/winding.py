"""Which way triangles face: patches that agree with themselves, and what lies inside what."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.geometry.edges import Edges
from gf_usd.model import Floats, Ints
from gf_usd.nearby import components
from gf_usd.sparse import coo_matrix

Flags = NDArray[np.bool_]

FLAT_FRACTION = 1e-4  # volume below this share of (area)^(3/2): no inside, so no outside either
OPEN_FRACTION = 0.25  # a wider mouth: neither
PROBES = 16  # vertices of a part that must lie inside another for the part to do
SIDES = 1024  # parts whose boxes are compared together: bounds memory


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Triangles joined across edges that exactly two of them share."""

    label: Ints  # (T,) 0, 1, ...
    against: Flags  # (T,) faces against the greater part, by area, of its patch
    one_sided: Flags  # (T,) of a patch that no choice of directions makes agree (a Moebius strip)


def areas(points: Floats, triangles: Ints) -> Floats:
    """(T,) [m^2]."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def patches(points: Floats, triangles: Ints, edges: Edges) -> Patches:
    """Patches of welded triangles (T, 3), and which triangles face against their own.

    Two copies of every triangle, as it is and turned, are joined wherever two neighbours agree: a
    patch that can be made to agree falls into two sheets, each the other turned inside out.
    """
    n = len(triangles)
    one, two = edges.pairs.T
    clash = np.where(edges.directed[one, 0] == edges.directed[two, 0], n, 0)
    a, b = one // 3, two // 3
    rows = np.concatenate([a, a + n])
    columns = np.concatenate([b + clash, b + n - clash])
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n, 2 * n))
    sheet = components(graph)[1]
    as_is, turned = sheet[:n], sheet[n:]
    label = np.unique(np.minimum(as_is, turned), return_inverse=True)[1].reshape(-1)
    against = as_is > turned
    area = areas(points, triangles)
    whole = np.bincount(label, area)
    lost = np.bincount(label, area * against, minlength=len(whole))
    against ^= (lost > 0.5 * whole)[label]
    one_sided = as_is == turned
    return Patches(label=label, against=against & ~one_sided, one_sided=one_sided)


def turned(triangles: Ints, which: Flags) -> Ints:
    """Triangles (T, 3) with the winding of some of them reversed."""
    return np.where(which[:, None], triangles[:, ::-1], triangles)


def volumes(points: Floats, triangles: Ints, label: Ints) -> Floats:
    """(K,) [m^3] signed volume of each part, about its own centre; positive faces outward."""
    corners = points[triangles]
    count = np.bincount(label)
    mean = corners.mean(1)
    centre = np.stack([np.bincount(label, mean[:, d]) / count for d in range(3)], 1)
    a, b, c = np.moveaxis(corners - centre[label][:, None, :], 1, 0)
    return np.bincount(label, np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0)


def mouths(points: Floats, triangles: Ints, label: Ints) -> Floats:
    """(K,) |S| / (A + |S|), S = sum of the area vectors of a part and A its area.

    S is zero for a closed part; |S| is the least area that closes one hole.
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    vector = 0.5 * np.cross(b - a, c - a)
    gap = np.linalg.norm(
        np.stack([np.bincount(label, vector[:, d]) for d in range(3)], axis=1), axis=1
    )
    whole = np.bincount(label, np.linalg.norm(vector, axis=1)) + gap
    return gap / np.where(whole > 0.0, whole, 1.0)


def boxes(points: Floats, triangles: Ints, label: Ints) -> tuple[Floats, Floats]:
    """(K, 3), (K, 3) [m] lowest and highest corner of each part."""
    order = np.argsort(label, kind="stable")
    corners = points[triangles[order]]
    first = np.flatnonzero(np.diff(label[order], prepend=-1))
    return (
        np.minimum.reduceat(corners.min(1), first, axis=0),
        np.maximum.reduceat(corners.max(1), first, axis=0),
    )


def rows_of(label: Ints) -> list[Ints]:
    """Triangles of each part."""
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def containers(points: Floats, triangles: Ints, label: Ints) -> Ints:
    """(K,) the smallest part that each part lies inside; -1 where it lies inside none."""
    low, high = boxes(points, triangles, label)
    volume = np.abs(volumes(points, triangles, label))
    parts = rows_of(label)
    parent = np.full(len(parts), -1)
    for start in range(0, len(parts), SIDES):
        mine = np.arange(start, min(start + SIDES, len(parts)))
        around = (low[None] < low[mine, None]).all(2) & (high[None] > high[mine, None]).all(2)
        for i, j in np.argwhere(around):
            i = mine[i]
            if parent[i] >= 0 and volume[parent[i]] <= volume[j]:
                continue
            corners = np.unique(triangles[parts[i]])
            probes = corners[:: max(1, len(corners) // PROBES)]
            if winding_inside(points, triangles[parts[j]], points[probes]).all():
                parent[i] = j
    return parent


def winding_inside(points: Floats, triangles: Ints, X: Floats) -> Flags:
    """(n,) True for X (n, 3) where the winding number of the triangles exceeds one half."""
    used, local = np.unique(triangles, return_inverse=True)
    centre = points[used].mean(0)
    local = np.ascontiguousarray(local.reshape(-1, 3), np.int64)
    w = igl.fast_winding_number(points[used] - centre, local, X - centre)
    return np.abs(np.atleast_1d(w)) > 0.5


@dataclass(frozen=True, kw_only=True)
class Facing:
    """How parts face: +1 outward, -1 inward, 0 where there is no inside to speak of."""

    now: Ints  # (K,)
    goal: Ints  # (K,) -1 for cavities
    inner: Flags  # (K,) lie in the flesh of another part and enclose nothing that is not so too

    @property
    def wrong(self) -> Flags:
        """(K,) parts that face the other way than they should."""
        return (self.now != 0) & (self.now == -self.goal)


def facing(points: Floats, triangles: Ints, label: Ints) -> Facing:
    """How each part faces, and how it should.

    Parts face outward, if they have an inside: some volume, and no mouth wider than
    `OPEN_FRACTION`.  One that lies inside another and faces the other way bounds a cavity: that
    is how hollow things are modelled, and it stays opposite to what it lies in.
    """
    volume = volumes(points, triangles, label)
    area = np.bincount(label, areas(points, triangles))
    inside = np.abs(volume) > FLAT_FRACTION * area**1.5
    inside &= mouths(points, triangles, label) <= OPEN_FRACTION
    now = np.where(inside, np.sign(volume), 0).astype(int)
    goal = np.abs(now)
    parent = containers(points, triangles, label)
    # From the outside in: what a part lies in is larger and decided before it.
    for i in np.argsort(-np.abs(volume), kind="stable"):
        j = parent[i]
        if j >= 0 and goal[j] == 1 and now[i] * now[j] == -1:
            goal[i] = -1
    inner = np.zeros(len(goal), bool)
    # From the inside out: a part that holds a cavity bounds flesh, wherever it lies.
    for i in np.argsort(np.abs(volume), kind="stable"):
        within = goal[i] == 1 and parent[i] >= 0 and goal[parent[i]] == 1
        inner[i] = within and inner[parent == i].all()
    return Facing(now=now, goal=goal, inner=inner)
