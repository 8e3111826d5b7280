"""Bodies: groups of surfaces that overlap or touch at rest, or that a physics body of USD contains.

Bodies interact by contact only.  Surfaces of two physics bodies are never in the same body, even
where they touch, and surfaces of two components only where they overlap: a chess piece stands on
the board, but the wheel of a car is inside its wheelhouse.

`part_weights` gives weights of the parts of a surface (such as its material subsets) at points of
the body, which blend across the border between parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.geometry.solid import Solid, mean_thickness

INNER = 256  # points inside a surface that are tested, about: a copy has all of them inside
FINEST = 64  # subdivisions of an edge at most: bounds the samples of very large triangles
TOUCHING = 0.25  # [spacings] nearer than this, surfaces count as touching
THIN = 0.25  # of the mean thickness, where that is less
PROBES = 6  # points along each edge of the box that two surfaces have in common


def find_bodies(
    solid: Solid, spacing: float, *, owners: Sequence[str] = (), combine: bool = False,
    kinds: Ints | None = None,
) -> Ints:  # fmt: skip
    """The body of each surface (S,), numbered from 0 in the order of the surfaces.

    spacing : [m] of the particles.
    owners : (S,) physics body of each surface, "": none.  Surfaces of the same owner are one body,
        and surfaces of different owners never are.
    combine : one body of all surfaces.
    kinds : (S,) surfaces of different kinds are never one body; None: one kind.
    """
    count = len(solid.surfaces)
    if combine or count == 1:
        return np.zeros(count, np.int64)
    reach = TOUCHING * spacing
    points = _skins(solid, spacing)
    owners = owners or [""] * count
    close = _close(points, reach)
    label, held = _owned(owners, np.zeros(count, int) if kinds is None else kinds)
    own = [s.component for s in solid.surfaces]
    components = [{one} - {""} for one in own]
    for k, one in enumerate(label):
        components[one] |= components[k]
    pairs = [
        (a, b)
        for a in range(count)
        for b in range(a + 1, count)
        if close[a, b] and (kinds is None or kinds[a] == kinds[b])
    ]

    @cache
    def touch(a: int, b: int) -> bool:
        return _meets(points[a], solid, b, reach) or _meets(points[b], solid, a, reach)

    def join(found: Callable[[int, int], bool]) -> bool:
        """Make one body of the pairs found; whether there were any."""
        joined = False
        for a, b in pairs:
            one, two = label[a], label[b]
            # two physics bodies are never merged, not even by a surface that touches both
            if one == two or (held[one] and held[two]) or not found(a, b):
                continue
            held[one] = held[one] or held[two]
            components[one] |= components[two]
            label[label == two] = one
            joined = True
        return joined

    def one_thing(a: int, b: int) -> bool:
        if own[a] == own[b]:
            return touch(a, b)
        return _overlap(solid, points, a, b, reach)

    def compatible(a: int, b: int) -> bool:
        """Whether surfaces touch whose bodies so far share a component, or one has none."""
        one, two = components[label[a]], components[label[b]]
        return (not one or not two or bool(one & two)) and touch(a, b)

    join(one_thing)  # first, since what belongs to no component must not decide
    while join(compatible):
        pass
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[label]


def overlapping(
    solid: Solid,
    spacing: float,
    of: Ints,
    owners: Sequence[str],
    inner: Sequence[Floats] = (),
) -> list[tuple[int, int]]:
    """Pairs of surfaces of different owners and bodies that overlap by more than `TOUCHING`.

    inner : points (n, 3) [m] inside each surface.  They find copies at the same place, of which no
        point of one surface is inside the other.
    """
    rivals = [k for k, owner in enumerate(owners) if owner]
    if len({owners[k] for k in rivals}) < 2:
        return []
    points, depth = _skins(solid, spacing), TOUCHING * spacing
    close = _close(points, -depth)
    for k, X in enumerate(inner):
        points[k] = np.concatenate([points[k], X[:: max(1, len(X) // INNER)]])
    return [
        (a, b)
        for a in rivals
        for b in rivals
        if a < b
        and of[a] != of[b]
        and close[a, b]
        and (_enters(points[a], solid, b, depth) or _enters(points[b], solid, a, depth))
    ]


def _skins(solid: Solid, spacing: float) -> list[Floats]:
    """Sample points (n, 3) [m] on each surface."""
    return [
        np.concatenate([s.points[np.unique(t)], spread(s.points, t, spacing)])
        for s, t in zip(solid.surfaces, solid.triangles)
    ]


def _close(points: Sequence[Floats], reach: float) -> NDArray[np.bool_]:
    """(S, S) whether bounding boxes, each enlarged by reach [m], overlap."""
    low = np.array([p.min(0) for p in points]) - reach
    high = np.array([p.max(0) for p in points]) + reach
    return np.asarray(((low[:, None] <= high) & (low <= high[:, None])).all(2))


def _owned(owners: Sequence[str], kinds: Ints) -> tuple[Ints, list[str]]:
    """(S,) label of each surface by owner and kind, and the owner of each label."""
    first: dict[tuple[str, int], int] = {}
    label = [
        first.setdefault((owner, int(kind)), k) if owner else k
        for k, (owner, kind) in enumerate(zip(owners, kinds, strict=True))
    ]
    return np.array(label), list(owners)


def spread(points: Floats, triangles: Ints, spacing: float) -> Floats:
    """Points (n, 3) [m] on triangles, at most about one spacing [m] apart."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    parts = np.minimum(np.ceil(longest / spacing), FINEST).astype(int)
    out = []
    for n in np.unique(parts[parts > 1]):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        u = np.stack([i, j], -1)[i + j <= n] / n
        mine = parts == n
        out.append(a[mine, None] + u[:, :1] * (b - a)[mine, None] + u[:, 1:] * (c - a)[mine, None])
    return np.concatenate([one.reshape(-1, 3) for one in out]) if out else np.zeros((0, 3))


def _meets(X: Floats, solid: Solid, surface: int, reach: float) -> bool:
    """Whether a point (n, 3) [m] lies in a surface or within reach [m] of it."""
    points, triangles = solid.surfaces[surface].points, solid.triangles[surface]
    center = points.mean(0)
    near = ((points.min(0) - reach <= X) & (points.max(0) + reach >= X)).all(1)
    if not near.any():
        return False
    X = X[near]
    squared = igl.point_mesh_squared_distance(X - center, points - center, triangles)[0]
    if np.asarray(squared).min() <= reach**2:
        return True
    return bool(solid.bounds[surface].inside(X).any())


def _enters(X: Floats, solid: Solid, surface: int, depth: float) -> bool:
    """Whether a point (n, 3) [m] is inside a surface and farther than depth [m] from it."""
    X = X[solid.bounds[surface].inside(X)]
    if not len(X):
        return False
    points, center = solid.surfaces[surface].points, solid.surfaces[surface].points.mean(0)
    squared = igl.point_mesh_squared_distance(X - center, points - center, solid.triangles[surface])
    return bool((np.asarray(squared[0]) > depth**2).any())


def _overlap(solid: Solid, points: Sequence[Floats], a: int, b: int, reach: float) -> bool:
    """Whether two surfaces overlap: a point is in both, and deeper than `reach` [m] in one of them.

    Where that one is thin, a quarter of its mean thickness 2 V / A is enough.  points : (n, 3) [m]
    on each surface.  Points on a lattice are tested as well: of a copy at the same place no point
    of the surface is inside.
    """
    depth = [min(reach, THIN * mean_thickness(solid.surfaces[k])) for k in (a, b)]
    low = np.maximum(points[a].min(0), points[b].min(0))
    high = np.minimum(points[a].max(0), points[b].max(0))
    if (high - low).min() <= min(depth):
        return False
    ticks = np.stack(np.meshgrid(*3 * [(np.arange(PROBES) + 0.5) / PROBES], indexing="ij"), -1)
    lattice = low + ticks.reshape(-1, 3) * (high - low)
    inner = lattice[solid.bounds[a].inside(lattice)]
    return _enters(np.concatenate([points[a], inner]), solid, b, depth[1]) or _enters(
        np.concatenate([points[b], inner]), solid, a, depth[0]
    )


NEARER = 1e-7  # [1] of the distance
BORDER_TOUCHING = 1e-12  # [1] of the distance: closer than this two closest points are one


def part_weights(
    X: Floats, parts: Sequence[tuple[Floats, Ints]], width: float
) -> NDArray[np.float64]:
    """(n, K) weights of K parts of a surface at points X (n, 3) [m]; each row sums to 1.

    With p_k the nearest point of part k at the distance d_k, the plane halfway between p_k and p_j
    is at b_kj = (d_j^2 - d_k^2) / (2 |p_j - p_k|) from X, positive on the side of k.  Then w_k =
    S(1/2 + 2 min_j b_kj / width), scaled to a sum of 1, with S(t) = t^2 (3 - 2 t) on [0, 1].  Where
    the boundary runs along a flat face, 2 b is the distance from it at any depth.

    parts : points (V, 3) [m] and triangles (T, 3) of each; width : [m] of the transition.
    """
    closest = _closest(X, parts)
    squared = ((closest - X[:, None]) ** 2).sum(2)
    # A slight shift, the same for all parts, breaks ties between two faces at equal distance.
    best = closest[np.arange(len(X)), squared.argmin(1)]
    closest = _closest(X + NEARER * (best - X), parts)
    squared = ((closest - X[:, None]) ** 2).sum(2)
    out = np.ones(squared.shape)
    for k in range(len(parts)):
        others = [j for j in range(len(parts)) if j != k]
        if not others:
            continue
        apart = np.linalg.norm(closest[:, others] - closest[:, [k]], axis=2)
        more = squared[:, others] - squared[:, [k]]
        scale = np.sqrt(np.maximum(squared[:, others], squared[:, [k]]))
        one_point = apart <= BORDER_TOUCHING * scale
        beyond = np.where(one_point, 0.0, more / np.where(one_point, 1.0, 2.0 * apart)).min(1)
        out[:, k] = smoothstep(0.5 + 2.0 * beyond / width)
    return out / out.sum(1, keepdims=True)


def _closest(X: Floats, parts: Sequence[tuple[Floats, Ints]]) -> NDArray[np.float64]:
    """(n, K, 3) [m] closest points of each part to X (n, 3)."""
    found: list[Any] = [igl.point_mesh_squared_distance(X, p, faces) for p, faces in parts]
    return np.stack([np.asarray(one[2]) for one in found], 1)


def smoothstep(t: Floats) -> NDArray[np.float64]:
    """t^2 (3 - 2 t), with t clamped to 0..1."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
