"""Tessellation of implicit shapes (UsdGeomSphere, Cube, ...) into closed, outward-facing meshes.

Round shapes are stacks of rings about Z.  Ring k from a pole has 6 k points, so that faces near the
pole are as regular as those at the rim (a fixed number of segments would make slivers).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import AXES, Floats, Ints
from gf_usd.readers.usd.stage import SkippedPrim

Polygons = tuple[Floats, Ints, Ints]  # points (V, 3), counts (P,), indices (C,)
Rings = list[tuple[int, float, float]]  # points on the ring, radius, height

RINGS = 12  # from a pole to the rim: 72 segments around, chords within 0.1 % of the radius
MAX_ROWS = 64  # of quads along a long cylinder
CUBE_CELLS = 12  # along an edge


def tessellate(prim: Usd.Prim, time: Usd.TimeCode) -> Polygons:
    """Points (V, 3) in the prim's own space and stage units, face counts (P,) and indices (C,).

    Raises SkippedPrim for a shape without volume, and for an axis token that is not X, Y or Z.
    """
    return IMPLICIT[str(prim.GetTypeName())](prim, time)


def _size(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float:
    value = prim.GetAttribute(name).Get(time)
    if not isinstance(value, float | int):  # a file may author any type
        raise SkippedPrim(f"its {name} is not a number")
    if not np.isfinite(value) or value < 0.0:
        raise SkippedPrim(f"its {name} is {value:g}")
    return float(value)


def _positive(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float:
    value = _size(prim, name, time)
    if value == 0.0:
        raise SkippedPrim(f"its {name} is 0")
    return value


def _cube(prim: Usd.Prim, time: Usd.TimeCode) -> Polygons:
    """A grid of quads on each side, with shared points on edges and corners."""
    n, half = CUBE_CELLS, _positive(prim, "size", time) / 2.0
    grid = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    on_skin = np.any((grid == 0) | (grid == n), axis=1)
    index = np.full(len(grid), -1)
    index[on_skin] = np.arange(on_skin.sum())
    index = index.reshape(n + 1, n + 1, n + 1)
    quads = []
    for axis in range(3):
        # With the axis first, the other two follow in cyclic order: low x high points outward.
        sides = np.moveaxis(index, [axis, (axis + 1) % 3, (axis + 2) % 3], [0, 1, 2])
        for side, outward in ((sides[n], True), (sides[0], False)):
            ring = [side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]]
            quads.append(np.stack(ring[:: 1 if outward else -1], axis=-1).reshape(-1, 4))
    faces = np.concatenate(quads)
    points = (2.0 * grid[on_skin] / n - 1.0) * half
    return points, np.full(len(faces), 4), faces.reshape(-1)


def _sphere(prim: Usd.Prim, time: Usd.TimeCode) -> Polygons:
    bowl = _bowl(_positive(prim, "radius", time), 0.0)
    return _stack(bowl + _flip(bowl)[1:], "Z")


def _capsule(prim: Usd.Prim, time: Usd.TimeCode) -> Polygons:
    bottom, top = _two_radii(prim, time)
    half = _size(prim, "height", time) / 2.0
    rings = _bowl(bottom, -half) + _wall(bottom, top, half)[1:-1]
    if half == 0.0 and bottom == top:
        rings.pop()  # the rims of the two half spheres coincide
    return _stack(rings + _flip(_bowl(top, -half)), _axis(prim, time))


def _cylinder(prim: Usd.Prim, time: Usd.TimeCode) -> Polygons:
    bottom, top = _two_radii(prim, time)
    half = _positive(prim, "height", time) / 2.0
    rings = _disc(bottom, -half) + _wall(bottom, top, half)[1:-1] + _flip(_disc(top, -half))
    return _stack(rings, _axis(prim, time))


def _cone(prim: Usd.Prim, time: Usd.TimeCode) -> Polygons:
    radius, half = _positive(prim, "radius", time), _positive(prim, "height", time) / 2.0
    side = [(n, r, 2.0 * half * r / radius - half) for n, r, _ in _disc(radius, 0.0)[:-1]]
    return _stack(_disc(radius, -half) + _flip(side), _axis(prim, time))


SIZES = ("size", "radius", "radiusTop", "radiusBottom", "height")  # attributes of these shapes
IMPLICIT: dict[str, Callable[[Usd.Prim, Usd.TimeCode], Polygons]] = {
    "Sphere": _sphere,
    "Cube": _cube,
    "Capsule": _capsule,
    "Capsule_1": _capsule,
    "Cone": _cone,
    "Cylinder": _cylinder,
    "Cylinder_1": _cylinder,
}


def _two_radii(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[float, float]:
    """Radii at the bottom and the top of the axis."""
    if str(prim.GetTypeName()).endswith("_1"):
        return _positive(prim, "radiusBottom", time), _positive(prim, "radiusTop", time)
    radius = _positive(prim, "radius", time)
    return radius, radius


def _axis(prim: Usd.Prim, time: Usd.TimeCode) -> str:
    axis = str(prim.GetAttribute(UsdGeom.Tokens.axis).Get(time))
    if axis not in AXES:
        raise SkippedPrim(f"its axis is {axis!r}, which is not X, Y or Z")
    return axis


def _around(k: int) -> int:
    return max(1, 6 * k)


def _disc(radius: float, height: float) -> Rings:
    """From the center to the rim."""
    return [(_around(k), radius * k / RINGS, height) for k in range(RINGS + 1)]


def _bowl(radius: float, height: float) -> Rings:
    """From the lowest point of a half sphere, centered at `height`, to its rim."""
    angle = 0.5 * np.pi * np.arange(RINGS + 1) / RINGS
    return [
        (_around(k), radius * float(np.sin(a)), height - radius * float(np.cos(a)))
        for k, a in enumerate(angle)
    ]


def _wall(bottom: float, top: float, half: float) -> Rings:
    """Rings of the rim's size from -half to half, with about square faces between them."""
    across = 2.0 * np.pi * max(bottom, top) / _around(RINGS)
    rows = int(np.clip(round(2.0 * half / across), 1, MAX_ROWS))
    return [
        (_around(RINGS), bottom + (top - bottom) * t, half * (2.0 * t - 1.0))
        for t in np.linspace(0.0, 1.0, rows + 1).tolist()
    ]


def _flip(rings: Rings) -> Rings:
    """The rings mirrored in height, ordered from bottom to top."""
    return [(count, radius, -height) for count, radius, height in reversed(rings)]


def _stack(rings: Rings, axis: str) -> Polygons:
    """Rings from bottom to top, connected by quads, or by triangles where the count changes."""
    points, faces, first = [], [], 0
    for i, (count, radius, height) in enumerate(rings):
        angle = 2.0 * np.pi * np.arange(count) / count
        flat = [radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)]
        points.append(np.stack(flat, axis=1))
        if i + 1 < len(rings):
            faces += _join(first, count, first + count, rings[i + 1][0])
        first += count
    # A cyclic permutation of the axes is a rotation, which preserves the winding.
    cloud = np.roll(np.concatenate(points), AXES[axis] + 1, axis=1)
    counts = np.concatenate([np.full(len(f), f.shape[1]) for f in faces])
    return cloud, counts, np.concatenate([f.reshape(-1) for f in faces])


def _join(low: int, below: int, high: int, above: int) -> list[Ints]:
    """Faces between the ring of `below` points from index `low` and that of `above` from `high`."""
    if below == above:
        j = np.arange(below)
        k = (j + 1) % below
        return [np.stack([low + j, low + k, high + k, high + j], axis=1)]
    # Each of six sectors has one point more on the larger ring.
    few, many = sorted((below, above))
    n = (many // 6) - 1
    sector, j = (grid.reshape(-1) for grid in np.meshgrid(np.arange(6), np.arange(n + 1)))
    small, large = (low, high) if below < above else (high, low)
    wide = [large + (sector * (n + 1) + j + step) % many for step in (0, 1)]
    narrow = [small + (sector * n + j + step) % few for step in (0, 1)]
    tips = np.stack([narrow[0], wide[1], wide[0]], axis=1)
    gaps = np.stack([narrow[0], narrow[1], wide[1]], axis=1)[j < n]
    if below > above:
        tips, gaps = tips[:, ::-1], gaps[:, ::-1]
    return [tips, gaps]
