"""Pins: which points of a body a region holds, and where its boundary is.

A volume (a box, the inside of meshes) holds what lies in it.  A patch of a surface holds nothing
inside the body: the body is held at the patch itself, so a point is held if the patch is the part
of the surface nearest to it and it does not lie within the body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.stage import Pin, Region
from gf_usd.geometry.solid import INSIDE, Solid

BOX = "box:"
ON_SURFACE = 1e-6  # of the body's size: nearer than this a point lies on the patch
# Corners are numbered x + 2 y + 4 z; triangles look outward.
BOX_CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
BOX_TRIANGLES = np.array(
    [
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],
    ]
)  # fmt: skip


def parse_box(text: str, unit: float, option: str = "--pin") -> tuple[Floats, Floats]:
    """Low and high corner [m] of "box:x0,y0,z0,x1,y1,z1" in stage units of `unit` [m].

    option : that names it, for messages.  Raises UsageError for anything else.
    """
    words = text.removeprefix(BOX).split(",")
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.full(6, np.nan)
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise UsageError(
            f"{option} {text} is not a box",
            f"give two corners in stage units: {option} box:-1,0,-1,1,0.2,1",
        )
    low, high = np.minimum(numbers[:3], numbers[3:]), np.maximum(numbers[:3], numbers[3:])
    if (high - low).min() <= 0.0:
        raise UsageError(
            f"{option} {text} has no volume: its sides are {(high - low).tolist()}",
            "give two opposite corners that differ along every axis",
        )
    return low * unit, high * unit


def box_region(
    text: str, unit: float, surfaces: Floats, path: Floats, option: str = "--pin"
) -> Region:
    """The region of a box; the points (V, 3) of the body move along path (F, V, 3), and it with
    those that lie in it (or, where none does, with the nearest ones).
    """
    low, high = parse_box(text, unit, option)
    corners = low + (high - low) * BOX_CORNERS
    if len(path) == 1:
        return Region(
            name=text, kind="volume", points=corners, triangles=BOX_TRIANGLES, path=corners[None]
        )
    inside = ((surfaces >= low) & (surfaces <= high)).all(1)
    chosen = np.flatnonzero(inside) if inside.sum() >= 3 else np.arange(len(surfaces))
    points = np.concatenate([corners, surfaces[chosen]])
    return Region(
        name=text,
        kind="volume",
        points=points,
        triangles=BOX_TRIANGLES,
        path=np.concatenate([np.broadcast_to(corners, (len(path), 8, 3)), path[:, chosen]], axis=1),
    )


def make_pin(region: Region, solid: Solid, option: str = "--pin") -> Pin:
    """The pin of a region.  Raises InputError for a patch of something that is not filled."""
    if region.kind == "patch" and region.body not in {s.path for s in solid.surfaces}:
        raise InputError(
            f"{option} {region.name} is part of <{region.body}>, which is not filled",
            "name a part of a mesh that is filled, or a box",
        )
    used = np.unique(region.triangles)
    anchors, path = region.points, region.path
    if region.name.startswith(BOX):
        used = np.arange(8, len(anchors)) if len(anchors) > 8 else used
        anchors, path = anchors[used], path[:, used]
    shape = Shape(region.points, region.triangles)
    inside = shape.encloses if region.kind == "volume" else _Patch(shape, region, solid).holds
    return Pin(name=region.name, inside=inside, nearest=shape.nearest, anchors=anchors, path=path)


def make_rigid(region: Region, solid: Solid) -> Pin:
    """A rigid region: what a volume encloses, or all that is nearest to a patch of the surface.

    Raises InputError for a patch of something that is not filled.
    """
    pin = make_pin(region, solid, "--rigid")
    inside = _nearest_to(region, solid) if region.kind == "patch" else pin.inside
    still = region.points[None]
    return replace(pin, inside=inside, anchors=still[0], path=still, sharp=False, rigid=True)


def _nearest_to(region: Region, solid: Solid) -> Callable[[Floats], Floats]:
    """Whether points X (n, 3) [m] are nearer to a patch than to the rest of its surface."""
    at = [s.path for s in solid.surfaces].index(region.body)
    patch = Shape(region.points, region.triangles)
    whole = Shape(solid.surfaces[at].points, solid.triangles[at])
    slack = ON_SURFACE * float(np.linalg.norm(solid.high - solid.low))
    return lambda X: np.asarray(patch.closest(X)[0] <= whole.closest(X)[0] + slack)


class Shape:
    """Triangles to ask for distances; centered, so that far from the origin no digits are lost."""

    def __init__(self, points: Floats, triangles: Ints) -> None:
        self.center = points.mean(0)
        self._points = np.ascontiguousarray(points - self.center, dtype=float)
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int64)

    def closest(self, X: Floats) -> tuple[Floats, Floats]:
        """Distance (n,) [m] to the triangles and the closest points (n, 3) [m]."""
        if len(X) == 0:
            return np.zeros(0), np.zeros((0, 3))
        squared, _, nearest = igl.point_mesh_squared_distance(
            np.ascontiguousarray(X - self.center), self._points, self._triangles
        )
        return np.sqrt(np.asarray(squared).reshape(-1)), np.asarray(nearest) + self.center

    def nearest(self, X: Floats) -> Floats:
        """(n, 3) [m] on the triangles."""
        return self.closest(X)[1]

    def encloses(self, X: Floats) -> Floats:
        """(n,) inside, by the winding number."""
        if len(X) == 0:
            return np.zeros(0, bool)
        w = igl.fast_winding_number(self._points, self._triangles, X - self.center)
        return np.abs(np.asarray(w).reshape(-1)) > INSIDE


class _Patch:
    """What a part of a filled surface holds."""

    def __init__(self, shape: Shape, region: Region, solid: Solid) -> None:
        at = [s.path for s in solid.surfaces].index(region.body)
        self._patch = shape
        self._whole = Shape(solid.surfaces[at].points, solid.triangles[at])
        self._solid = solid
        self._tolerance = ON_SURFACE * float(np.linalg.norm(solid.high - solid.low))

    def holds(self, X: Floats) -> Floats:
        """(n,) on the patch, or outside the body with the patch nearest."""
        own = self._patch.closest(X)[0]
        out = own <= self._tolerance
        rest = np.flatnonzero(~out)
        whole = self._whole.closest(X[rest])[0]
        near = rest[own[rest] <= whole + self._tolerance]
        out[near] = ~self._solid.inside(X[near])
        return out
