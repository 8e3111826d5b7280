"""Open meshes that hold closed ones: a head with teeth, the body of a car with wheels.

Only closed meshes are filled, so that what an open one holds comes off.  A ground, a backdrop, a
room and a bowl are open too, but what they hold is in front of them or in them.  The winding number
of an open mesh about the center of what it holds tells them apart: a body that surrounds a volume
subtends as much with its near side as, seen from behind, with its far side.  Measured: 0 to 0.23
about buttons, wheels and teeth, 0.54 to 0.85 about furniture in rooms and fruit in a bowl, 0.4 to
0.5 about what stands on a floor or on a landscape.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import agreed, listed_paths

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Bounds, Solid

# Share of holes in the closed area: a plane has 0.5, a floor with a wall 0.485, hills 0.48 to 0.5
OPEN = 0.45
OUTSIDE = 0.35  # winding number about the center of what is held, in magnitude
LARGE = 0.8  # of the size of the open mesh: a smaller body is a part of it
TOUCH = 0.01  # of that size: what is nearer touches
MOST_POINTS = 4096  # of a mesh that is tested, about
MOST_NAMED = 2


@dataclass(frozen=True, kw_only=True)
class OpenBody:
    """An open mesh that alone holds closed ones."""

    path: str  # prim path
    held: tuple[str, ...]  # prim paths


def open_bodies(asset: Asset, solid: Solid, own: Collection[str] = ()) -> tuple[OpenBody, ...]:
    """The open meshes of an asset that alone hold closed ones, which lie on their outside.

    A mesh is held if it touches nothing as large as the open one, and the stage states neither
    physics nor a component of its own for one of them.  Where all are above the middle of the open
    one they stand on it, as on a ground or a plinth, and it holds none.

    asset, solid : without scenery and repair; own : paths of meshes with physics of their own.
    """
    from gf_usd.geometry.solid import Bounds, hole_fraction

    if not solid.embedded:
        return ()
    embedded, up = dict(solid.embedded), asset.facts.up
    closed = [(one, _size(one), _points(one)) for one in solid.surfaces]
    found = []
    for shell in asset.surfaces:
        open_ = shell.path in embedded and shell.path not in solid.walls and shell.splats is None
        triangles = shell.welded.triangles
        if not open_ or not len(triangles) or shell.signed_volume <= 0.0 or shell.path in own:
            continue
        if hole_fraction(shell.points, triangles, shell.welded.boundary) > OPEN:
            continue
        size, bounds = _size(shell), Bounds(shell.points, triangles)
        reach = TOUCH * size
        small = [(one, X) for one, length, X in closed if length < LARGE * size]
        large = [k for k, (_, length, _) in enumerate(closed) if length >= LARGE * size]
        touching = _touching(small, shell, bounds, reach)
        if not touching:
            continue
        centers = np.array([one.face_points.mean(0) for one, _ in touching])
        if (np.abs(bounds.winding_numbers(centers)) > OUTSIDE).any():
            continue
        stated = {one.path for one, _ in touching if one.component != shell.component} | {*own}
        held = [(one, X) for one, X in touching if one.path not in stated]
        for k in large:
            inside = {one.path for one, X in held if solid.bounds[k].inside(X).any()}
            meet = _touching(held, solid.surfaces[k], solid.bounds[k], reach)
            elsewhere = inside | {one.path for one, _ in meet}
            held = [(one, X) for one, X in held if one.path not in elsewhere]
        if any(_height(one, up) <= _height(shell, up) for one, _ in held):
            found.append(OpenBody(path=shell.path, held=tuple(one.path for one, _ in held)))
    return tuple(found)


def comes_off_notes(bodies: Sequence[OpenBody]) -> tuple[str, ...]:
    """Notes on what open meshes hold that are not filled."""
    return tuple(
        f"{listed_paths(one.held, MOST_NAMED)} "
        + agreed(
            len(one.held),
            f"[comes/come] off <{one.path}>, which is open and not filled, and [touches/touch]"
            f" nothing else as large; with --repair <{one.path}> is a shell one spacing thick, and"
            " one body with what touches it",
        )
        for one in bodies
    )


def _size(surface: Surface) -> float:
    """[m] diagonal of the bounding box."""
    return float(np.linalg.norm(np.ptp(surface.face_points, axis=0)))


def _points(surface: Surface) -> Floats:
    """(n, 3) [m] corners and centers of the faces, or some of them."""
    X = np.concatenate([surface.face_points, surface.points[surface.triangles].mean(1)])
    return X[:: max(1, len(X) // MOST_POINTS)]


def _height(surface: Surface, up: Floats) -> float:
    """[m] of the middle of a surface along up (3,)."""
    heights = surface.face_points @ up
    return 0.5 * float(heights.min() + heights.max())


def _touching(
    parts: Sequence[tuple[Surface, Floats]], surface: Surface, bounds: Bounds, reach: float
) -> list[tuple[Surface, Floats]]:
    """Those of some meshes, with points (n, 3) [m] of each, that have one within reach [m] of a
    surface.
    """
    low, high = bounds.low - reach, bounds.high + reach
    near = [X[((low <= X) & (high >= X)).all(1)] for _, X in parts]
    counts = [len(X) for X in near]
    if not sum(counts):
        return []
    X = np.concatenate(near)
    # one hierarchy for all: of a large surface it takes longer to build than to query
    triangles = _triangles_about(surface, X, reach)
    if not len(triangles):
        return []
    center = surface.points.mean(0)
    squared = igl.point_mesh_squared_distance(X - center, surface.points - center, triangles)[0]
    meets = np.asarray(squared) <= reach**2
    of_part = np.split(meets, np.cumsum(counts)[:-1])
    return [part for part, hits in zip(parts, of_part, strict=True) if hits.any()]


def _triangles_about(surface: Surface, X: Floats, reach: float) -> Ints:
    """(T, 3) triangles whose box comes within reach [m] of the box of points X (n, 3) [m]."""
    triangles = surface.welded.triangles.astype(np.int64)
    corners = surface.points[triangles]
    near = (corners.min(1) <= X.max(0) + reach) & (corners.max(1) >= X.min(0) - reach)
    return np.ascontiguousarray(triangles[near.all(1)])
