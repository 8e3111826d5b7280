"""Bone cores: regions around the bones of a skeleton whose motion the joints prescribe.

The core of a bone segment is a union of balls along its axis, whose radii are a share of the
distance to the surface.  The axis ends `CLEAR` radii before the joint, so that the flesh between
two bones can bend.  A point in several cores belongs to the one in which it is deepest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import counted
from gf_usd.core.stage import Bone, Pin
from gf_usd.core.units import length_text
from gf_usd.geometry.regions import Shape
from gf_usd.geometry.solid import Solid

POINTS = 25  # ball centers along a segment
CLEAR = 1.0  # [radii] between the joint and the end of the axis
# [cells] The last node in a core lies half a cell inside of it on average, and flesh begins 0.21
# cells before the last node (see the case `driven` of gf-usd verify).  It is also half the diagonal
# of a cell's face, so that a core contains nodes at any position in the grid.
WIDER = 0.71
MOST_CLEAR = 1.0 / 3.0  # of a segment at each end: short bones keep a third of it


@dataclass(frozen=True, kw_only=True)
class Core:
    """The core of one segment: balls along the axis, with linearly interpolated radii."""

    bone: int
    points: Floats  # (k, 3) [m] evenly along the segment, k >= 1
    radius: Floats  # (k,) [m]; 0 where the center is outside the body

    def depth(self, X: Floats) -> NDArray[np.float64]:
        """(n,) [m] depth of points (n, 3) [m] in the core; negative outside."""
        t = self._along(X)
        r = np.interp(t, np.linspace(0.0, 1.0, len(self.points)), self.radius)
        distance = np.linalg.norm(self.away(X), axis=1)
        return np.asarray(np.where(r > 0.0, r - distance, -np.inf))

    def away(self, X: Floats) -> NDArray[np.float64]:
        """(n, 3) [m] vectors to points (n, 3) [m] from the nearest points of the axis."""
        way = self.points[-1] - self.points[0]
        return np.asarray(X - self.points[0] - self._along(X)[:, None] * way)

    def _along(self, X: Floats) -> NDArray[np.float64]:
        """(n,) parameter 0..1 of the nearest points of the axis."""
        way = self.points[-1] - self.points[0]
        length2 = float(way @ way)
        if length2 == 0.0:
            return np.zeros(len(X))
        return np.asarray(np.clip((X - self.points[0]) @ way / length2, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class Cores:
    """The cores of a body."""

    cores: tuple[Core, ...]

    def owner(self, X: Floats) -> Ints:
        """(n,) the bone whose core contains each point (n, 3) [m]; -1: none."""
        best, out = np.zeros(len(X)), np.full(len(X), -1)
        for core in self.cores:
            depth = core.depth(X)
            deeper = depth > best
            best[deeper], out[deeper] = depth[deeper], core.bone
        return out

    def owns(self, bone: int, X: Floats) -> NDArray[np.bool_]:
        """(n,) whether the core of a bone contains each point (n, 3) [m]."""
        mine = [core.depth(X) > 0.0 for core in self.cores if core.bone == bone]
        inside = np.any(mine, axis=0) if mine else np.zeros(len(X), bool)
        inside[inside] = self.owner(X[inside]) == bone
        return np.asarray(inside)


def bone_cores(
    bones: Sequence[Bone], solid: Solid, share: float, cell: float
) -> tuple[Cores, tuple[str, ...]]:
    """The cores of bones in a solid, in which grid nodes are constrained, and notes.

    share : radius of a core over the distance from the bone to the surface.
    cell : [m] edge of a cell; `WIDER` cells are added to the radii.
    """
    ways = [
        (number, start, end, free)
        for number, bone in enumerate(bones)
        for (start, end), free in zip(bone.segments, bone.free, strict=True)
    ]
    whole = _radii([_along(start, end) for _, start, end, _ in ways], solid, share)
    inside = [(way, radius) for way, radius in zip(ways, whole, strict=True) if radius.any()]
    axes = []
    for (_, start, end, free), radius in inside:
        typical = float(np.median(radius[radius > 0.0])) + WIDER * cell
        length = float(np.linalg.norm(end - start))
        cut = min(CLEAR * typical / length, MOST_CLEAR) if length > 0.0 else 0.0
        axes.append(_along(start + cut * (end - start), end if free else end - cut * (end - start)))
    found: dict[int, list[tuple[Floats, Floats]]] = {}
    for (way, _), points, radius in zip(inside, axes, _radii(axes, solid, share), strict=True):
        if radius.any():
            found.setdefault(way[0], []).append((points, radius))
    cores, outside, thin = [], [], []
    for number, bone in enumerate(bones):
        if not bone.free:  # the flesh of this bone belongs to other bones
            continue
        mine = found.get(number)
        if mine is None:
            outside.append(bone.name)
            continue
        typical = float(np.median(np.concatenate([r[r > 0.0] for _, r in mine])))
        if typical + WIDER * cell >= typical / share:
            thin.append(bone.name)
        for points, radius in mine:
            wide = radius + WIDER * cell
            cores.append(Core(bone=number, points=points, radius=np.where(radius > 0.0, wide, 0.0)))
    notes = []
    if outside:
        notes.append(f"{_some(outside)}: outside the flesh, and holding nothing")
    if thin:
        notes.append(
            f"{_some(thin)}: the flesh around {'it' if len(thin) == 1 else 'them'} is too thin for"
            f" the grid, which has cells of {length_text(cell)}, and moves with the"
            f" bone{'s' * (len(thin) > 1)}; more --particles make the grid finer"
        )
    return Cores(cores=tuple(cores)), tuple(notes)


def _radii(axes: Sequence[Floats], solid: Solid, share: float) -> list[Floats]:
    """(k,) [m] of each axis of points (k, 3) [m]: a share of the distance to the surface; 0 outside
    the solid.

    All at once: each query of libigl builds a tree of the surface.
    """
    points = np.concatenate([np.zeros((0, 3)), *axes])
    skins = [Shape(s.points, t) for s, t in zip(solid.surfaces, solid.triangles, strict=True)]
    to_skin = np.min([skin.closest(points)[0] for skin in skins], axis=0)
    radii = np.where(solid.inside(points), share * to_skin, 0.0)
    return np.split(radii, np.cumsum([len(axis) for axis in axes])[:-1]) if axes else []


def bone_pins(bones: Sequence[Bone], cores: Cores) -> tuple[Pin, ...]:
    """One kinematic pin for each bone with a core."""
    there = sorted({core.bone for core in cores.cores if (core.radius > 0.0).any()})
    return tuple(_pin(bones[k], cores, k) for k in there)


def _pin(bone: Bone, cores: Cores, number: int) -> Pin:
    return Pin(
        name=bone.name,
        inside=partial(cores.owns, number),
        nearest=itself,
        anchors=bone.anchors,
        path=bone.path,
        sharp=False,
    )


def itself(X: Floats) -> Floats:
    """The points X (n, 3) themselves: `Pin.nearest` of a region without a pinned boundary.

    A function of the module, since plans with lambdas cannot be pickled.
    """
    return X


def _along(start: Floats, end: Floats) -> NDArray[np.float64]:
    return np.asarray(start + np.linspace(0.0, 1.0, POINTS)[:, None] * (end - start))


def _some(names: Sequence[str]) -> str:
    """The first three of some bones, and how many more there are: by their joints alone where these
    differ.
    """
    joints = [name.rpartition(":")[2].rpartition("/")[2] if "/" in name else name for name in names]
    named = joints if len(set(joints)) == len(joints) else names
    more = f" and {counted(len(named) - 3, 'more bone')}" if len(named) > 3 else ""
    return ", ".join(named[:3]) + more
