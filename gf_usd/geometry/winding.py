"""Winding of triangle meshes: consistent orientation, containment, half-edges, boundary loops.

patches          manifold parts, and their triangles of inconsistent winding
orientations     which parts face outward, which are cavities, which bound no volume
boundary_loops   closed loops of boundary edges
overlapping      parts whose solids overlap
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints, columns, cross
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import Edges, used_points
from gf_usd.core.neighbors import components

Flags = NDArray[np.bool_]

FLAT_FRACTION = 1e-4  # share of (area)^(3/2) below which a volume counts as 0: no inside
OPEN_FRACTION = 0.25  # of `open_fractions`, above which a part has no inside
PROBES = 16  # vertices of a part that are tested to lie inside another


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Parts connected across manifold edges, which exactly two triangles share."""

    label: Ints  # (T,) of the patch: 0, 1, ...
    against: Flags  # (T,) wound opposite to the majority, by area, of its patch
    one_sided: Flags  # (T,) of a non-orientable patch, such as a Moebius strip


def patches(points: Floats, triangles: Ints, edges: Edges) -> Patches:
    """Patches of welded triangles (T, 3), and their triangles of inconsistent winding.

    By the orientation double cover: every triangle is in it twice, as it is and reversed, and
    copies of neighbors are connected where their windings are consistent.  An orientable patch has
    two connected components, which are each other's reverse; a non-orientable one has one.
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


def flipped(triangles: Ints, which: Flags) -> Ints:
    """Triangles (T, 3) with the winding reversed where `which` (T,) is True."""
    return np.where(which[:, None], triangles[:, ::-1], triangles)


def volumes(points: Floats, triangles: Ints, label: Ints) -> Floats:
    """(K,) [m^3] signed volume of each part about its own center; positive: it faces outward."""
    corners = points[triangles]
    count = np.bincount(label)
    a, b, c = np.moveaxis(corners, 1, 0)
    mean = (a + b + c) / 3.0
    center = np.stack([np.bincount(label, mean[:, d]) / count for d in range(3)], 1)
    a, b, c = np.moveaxis(corners - center[label][:, None, :], 1, 0)
    return np.bincount(label, np.einsum("ti,ti->t", a, cross(b, c)) / 6.0)


def open_fractions(points: Floats, triangles: Ints, label: Ints) -> Floats:
    """(K,) |S| / (A + |S|) with the area A of a part and the sum S of its area vectors.

    S is zero for a closed part; |S| is a lower bound of the area that closes its holes.
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    vector = 0.5 * cross(b - a, c - a)
    gap = np.linalg.norm(
        np.stack([np.bincount(label, vector[:, d]) for d in range(3)], axis=1), axis=1
    )
    whole = np.bincount(label, np.linalg.norm(vector, axis=1)) + gap
    return gap / np.where(whole > 0.0, whole, 1.0)


def boxes(points: Floats, triangles: Ints, label: Ints) -> tuple[Floats, Floats]:
    """(K, 3), (K, 3) [m] lowest and highest corner of the bounding box of each part."""
    order = np.argsort(label, kind="stable")
    first = np.flatnonzero(np.diff(label[order], prepend=-1))
    a, b, c = np.moveaxis(points[triangles[order]], 1, 0)
    low, high = columns(np.minimum(np.minimum(a, b), c)), columns(np.maximum(np.maximum(a, b), c))
    return (
        np.minimum.reduceat(low, first, axis=1).T,
        np.maximum.reduceat(high, first, axis=1).T,
    )


def rows_of(label: Ints) -> list[Ints]:
    """The rows of the triangles of each part."""
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def enclosing_parts(points: Floats, triangles: Ints, label: Ints, volume: Floats) -> Ints:
    """(K,) the part of least volume that contains each part; -1: none does.

    volume : (K,) [m^3] of each part, without sign.
    """
    parent = np.full(len(volume), -1)
    if len(volume) < 2:
        return parent
    low, high = (columns(corner) for corner in boxes(points, triangles, label))
    parts = rows_of(label)

    @cache
    def probes(part: int) -> Ints:
        corners = used_points(triangles[parts[part]])[0]
        return corners[:: max(1, len(corners) // PROBES)]

    # By ascending volume, so that the first part around another is its parent, and that a part has
    # one hierarchy for all that may be in it: there may be thousands of specks in the box of a scan
    for j in np.argsort(volume, kind="stable"):
        within = parent < 0
        for lower, upper in zip(low, high):
            within &= (lower > lower[j]) & (upper < upper[j])
        if not within.any():
            continue
        rows = np.flatnonzero(within)
        tested = [probes(int(i)) for i in rows]
        inside = winding_inside(points, triangles[parts[j]], points[np.concatenate(tested)])
        start = np.cumsum([0, *map(len, tested[:-1])])
        parent[rows[np.logical_and.reduceat(inside, start)]] = j
    return parent


def winding_inside(points: Floats, triangles: Ints, X: Floats) -> Flags:
    """(n,) True for X (n, 3) where the winding number of the triangles exceeds one half, in
    magnitude."""
    return np.abs(winding_numbers(points, triangles, X)) > 0.5


def winding_numbers(points: Floats, triangles: Ints, X: Floats) -> Floats:
    """(n,) winding numbers of triangles (T, 3) about X (n, 3): positive behind their front."""
    return winding_function(points, triangles)(X)


def winding_function(points: Floats, triangles: Ints) -> Callable[[Floats], Floats]:
    """`winding_numbers` as a function of X (n, 3), for several queries."""
    used, local = used_points(triangles)
    center = points[used].mean(0)
    hierarchy = winding_hierarchy(points[used] - center, local)
    return lambda X: np.asarray(hierarchy.winding_number(X - center)).reshape(-1)


def winding_hierarchy(points: Floats, triangles: Ints) -> igl.FastWindingNumberBVH:
    """The hierarchy of the fast sum of winding numbers (Barill et al. 2018), for several queries.

    points : (V, 3); triangles : (T, 3).
    """
    made = igl.FastWindingNumberBVH()
    made.init(np.ascontiguousarray(points, float), np.ascontiguousarray(triangles, np.int64))
    return made


@dataclass(frozen=True, kw_only=True)
class Orientations:
    """Orientation of parts: +1 outward, -1 inward, 0 for a part without an inside."""

    current: Ints  # (K,) as modeled
    target: Ints  # (K,) as it should be: -1 for cavities
    inner: Flags  # (K,) inside the solid of another part, with no cavity in it: bounds no volume
    volume: Floats  # (K,) [m^3] signed
    area: Floats  # (K,) [m^2]

    @property
    def wrong(self) -> Flags:
        """(K,) parts whose orientation is to be reversed."""
        return (self.current != 0) & (self.current == -self.target)


def orientations(points: Floats, triangles: Ints, label: Ints) -> Orientations:
    """Current and target orientation of each part.

    A part has an inside if its volume is not flat (`FLAT_FRACTION`) and its `open_fractions` is at
    most `OPEN_FRACTION`; its target is then outward.  A part inside another one of opposite
    orientation is a cavity, whose target is inward.
    """
    volume = volumes(points, triangles, label)
    area = np.bincount(label, areas(points, triangles))
    inside = np.abs(volume) > FLAT_FRACTION * area**1.5
    inside &= open_fractions(points, triangles, label) <= OPEN_FRACTION
    current = np.where(inside, np.sign(volume), 0).astype(int)
    target = np.abs(current)
    parent = enclosing_parts(points, triangles, label, np.abs(volume))
    # By descending volume: the enclosing part is larger and decided before.
    for i in np.argsort(-np.abs(volume), kind="stable"):
        j = parent[i]
        if j >= 0 and target[j] == 1 and current[i] * current[j] == -1:
            target[i] = -1
    inner = np.zeros(len(target), bool)
    # By ascending volume: a part with a cavity in it bounds a volume even inside another one.
    for i in np.argsort(np.abs(volume), kind="stable"):
        within = target[i] == 1 and parent[i] >= 0 and target[parent[i]] == 1
        inner[i] = within and inner[parent == i].all()
    return Orientations(current=current, target=target, inner=inner, volume=volume, area=area)


def boundary_loops(edges: Edges) -> tuple[list[Ints], int]:
    """Closed loops of boundary half-edges, and the number of boundary edges that lie in none.

    Each loop follows the direction of its half-edges and passes no vertex twice: a boundary that
    touches itself is split into several loops.  A loop may include `Edges.surplus` of non-manifold
    edges; a loop of these alone (the rim of an inner wall) is left out.
    """
    leaving: dict[int, list[int]] = {}
    for half in [*edges.surplus.tolist(), *edges.boundary.tolist()]:
        leaving.setdefault(int(edges.directed[half, 0]), []).append(half)
    true = np.zeros(len(edges.id), bool)
    true[edges.boundary] = True
    loops: list[Ints] = []
    for first in list(leaving):
        while leaving[first]:
            loops.extend(_walk(edges, leaving, first))
    loops = [loop for loop in loops if true[loop].any()]
    return loops, len(edges.boundary) - sum(int(true[loop].sum()) for loop in loops)


def _walk(edges: Edges, leaving: dict[int, list[int]], first: int) -> list[Ints]:
    """The loops of one walk from a vertex until no half-edge is left; removes those it passes."""
    loops: list[Ints] = []
    walk: list[int] = []
    place = {first: 0}
    vertex = first
    while leaving.get(vertex):
        half = leaving[vertex].pop()
        walk.append(half)
        vertex = int(edges.directed[half, 1])
        if vertex in place:
            start = place[vertex]
            loops.append(np.array(walk[start:], np.int64))
            for passed in walk[start + 1 :]:
                del place[int(edges.directed[passed, 0])]
            walk = walk[:start]
        place[vertex] = len(walk)
    return loops


def fan_area(ring: Floats) -> float:
    """[m^2] area of the triangle fan between a closed ring (n, 3) [m] and its centroid."""
    spokes = ring - ring.mean(0)
    return float(0.5 * np.linalg.norm(cross(spokes, np.roll(spokes, -1, 0)), axis=1).sum())


OVERLAP_PROBES = 50_000  # sample points: bounds time
FINEST = 12  # sample points along an edge, where there are few triangles
DEPTH = 1e-4  # [diagonals of a part] of sample points below its surface: contact is no overlap
OVERLAP_WINDING = 1.5  # the winding number is 1 in one part, 2 where two overlap


def overlapping(points: Floats, triangles: Ints, label: Ints) -> NDArray[np.bool_]:
    """(K,) parts of outward-facing triangles (T, 3) that overlap others.

    Just below the surface of a part the winding number is 1, and 2 where another part overlaps it.
    """
    count = int(label.max(initial=-1)) + 1
    if count < 2:
        return np.zeros(count, bool)
    rows = np.arange(0, len(triangles), -(-len(triangles) // OVERLAP_PROBES))
    n = int(np.clip(np.sqrt(2.0 * OVERLAP_PROBES / len(rows)), 1, FINEST))
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    # centroids of the n (n + 1) / 2 upright triangles of a subdivided triangle
    u, v = ((np.stack([i, j])[:, i + j < n] + 1.0 / 3.0) / n)[:, None, :, None]
    a, b, c = (corner[:, None, :] for corner in np.moveaxis(points[triangles[rows]], 1, 0))
    normal = cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    low, high = boxes(points, triangles, label)
    depth = DEPTH * np.linalg.norm(high - low, axis=1)[label[rows]][:, None, None]
    X = (a + u * (b - a) + v * (c - a) - depth * normal).reshape(-1, 3)
    center = points[triangles].mean((0, 1))
    faces = np.ascontiguousarray(triangles, np.int64)
    w = np.asarray(igl.fast_winding_number(points - center, faces, X - center))
    shared = (w.reshape(len(rows), -1) > OVERLAP_WINDING).any(1)
    return np.bincount(label[rows], shared, count) > 0
