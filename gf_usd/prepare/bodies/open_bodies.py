"""Open meshes that hold closed ones: the shell of a controller with buttons, a head with teeth.

Only closed meshes are filled, so that what an open one holds comes off.  A ground, a backdrop, a
room and a bowl are open too, but what they hold is in front of them or in them.  The winding number
of an open mesh about the center of what it holds tells them apart: a body that surrounds a volume
subtends as much with its near side as, seen from behind, with its far side.  Measured: 0 to 0.23
about buttons, wheels and teeth, 0.54 to 0.85 about furniture in rooms and fruit in a bowl, 0.4 to
0.5 about what stands on a floor or on a landscape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import igl
import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import listed_paths

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
    largest: bool  # no closed mesh is as large


def open_bodies(asset: Asset, solid: Solid) -> tuple[OpenBody, ...]:
    """The open meshes of an asset that alone hold closed ones, which lie on their outside.

    A mesh is held if it touches nothing as large as the open one.

    solid : of the asset, without repair.
    """
    from gf_usd.geometry.solid import Bounds, hole_fraction

    if not solid.embedded:
        return ()
    embedded = dict(solid.embedded)
    closed = [(one, _size(one), _points(one)) for one in solid.surfaces]
    found = []
    for shell in asset.surfaces:
        open_ = shell.path in embedded and shell.path not in solid.walls and shell.splats is None
        triangles = shell.welded.triangles
        if not open_ or not len(triangles) or shell.signed_volume <= 0.0:
            continue
        if hole_fraction(shell.points, triangles, shell.welded.boundary) > OPEN:
            continue
        size, bounds = _size(shell), Bounds(shell.points, triangles)
        reach = TOUCH * size
        small = [(one, X) for one, length, X in closed if length < LARGE * size]
        large = [k for k, (_, length, _) in enumerate(closed) if length >= LARGE * size]
        touching = [(one, X) for one, X in small if _touches(X, shell, bounds, reach)]
        if not touching:
            continue
        centers = np.array([one.face_points.mean(0) for one, _ in touching])
        if (np.abs(bounds.winding_numbers(centers)) > OUTSIDE).any():
            continue
        held = [
            one.path
            for one, X in touching
            if not any(
                solid.bounds[k].inside(X).any()
                or _touches(X, solid.surfaces[k], solid.bounds[k], reach)
                for k in large
            )
        ]
        if held:
            found.append(OpenBody(path=shell.path, held=tuple(held), largest=not large))
    return tuple(found)


def repaired_note(bodies: Sequence[OpenBody]) -> str:
    """A note on open meshes for which an asset is repaired."""
    held = [path for one in bodies for path in one.held]
    is_open, alone = ("is", "it alone holds") if len(bodies) == 1 else ("are", "they alone hold")
    return (
        f"{listed_paths([one.path for one in bodies], MOST_NAMED)} {is_open} open, but {alone}"
        f" {listed_paths(held, MOST_NAMED)}: the asset is baked with --repair; --prim bakes some of"
        " its meshes without"
    )


def comes_off_notes(bodies: Sequence[OpenBody]) -> tuple[str, ...]:
    """Notes on what open meshes hold that are not filled."""
    return tuple(
        f"{listed_paths(one.held, MOST_NAMED)} {'comes' if len(one.held) == 1 else 'come'} off"
        f" <{one.path}>, which is open and not filled, and touch{'es' * (len(one.held) == 1)}"
        " nothing else as large; --repair fills it"
        for one in bodies
    )


def _size(surface: Surface) -> float:
    """[m] diagonal of the bounding box."""
    return float(np.linalg.norm(np.ptp(surface.face_points, axis=0)))


def _points(surface: Surface) -> Floats:
    """(n, 3) [m] corners and centers of the faces, or some of them."""
    X = np.concatenate([surface.face_points, surface.points[surface.triangles].mean(1)])
    return X[:: max(1, len(X) // MOST_POINTS)]


def _touches(X: Floats, surface: Surface, bounds: Bounds, reach: float) -> bool:
    """Whether a point X (n, 3) [m] is within reach [m] of a surface."""
    low, high = bounds.low - reach, bounds.high + reach
    X = X[((low <= X) & (high >= X)).all(1)]
    if not len(X):
        return False
    center = surface.points.mean(0)
    triangles = surface.welded.triangles.astype(np.int64)
    squared = igl.point_mesh_squared_distance(X - center, surface.points - center, triangles)[0]
    return float(np.min(squared)) <= reach**2
