"""How much of the bodies is outside the meshes that show them: faces too long to bend with them.

The points of a mesh are embedded in its body, and a face is flat between them: of a cube of eight
points none lies where a side is pressed in.  Meshes whose edges are all short follow the body and
are not looked at.

A particle is outside where the meshes of all bodies together do not wind around it (generalized
winding number; Jacobson, Kavan and Sorkine-Hornung 2013, by libigl) and where it is FAR from all of
them.  What is outside at rest, as in a sheet that was thickened, has no mesh around it anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.frames import Pose
from gf_usd.core.mesh import areas
from gf_usd.pipeline.measures.inside import WITHIN, WoundSurfaces, stacked

LONG = 4.0  # [spacings] of an edge: those of shorter ones show every bend of the grid, two wide
SHARE = 0.01  # of the area of all meshes, in faces with a long edge: less is a detail
FAR = 1.0  # [spacings] from the meshes
MOST = 3000  # particles of a look


@dataclass(frozen=True, kw_only=True)
class Outside:
    """What was found at one time."""

    share: float  # of the particles looked at, FAR outside
    depth: float  # [m] from the meshes to the farthest of them; 0: none


class OutsideMeasure:
    """The meshes of all bodies, and the particles in them.

    surfaces : at rest; X : (N, 3) [m] of all particles at rest; spacing : [m] of them.
    """

    def __init__(self, surfaces: Sequence[Surface], X: Floats, spacing: float) -> None:
        self._paths = [one.path for one in surfaces]
        points, self._triangles, self._ends = stacked(surfaces)
        self._spacing = spacing
        some = np.arange(0, len(X), max(1, -(-len(X) // MOST)))
        self._rows: Ints = some[self._wound(points, X[some])]

    def measure(self, poses: Mapping[str, Pose], x: Floats) -> Outside:
        """What is outside where the meshes have these poses and the particles are at x (N, 3) [m].

        It is none where none was inside at rest.
        """
        if len(self._rows) == 0:
            return Outside(share=0.0, depth=0.0)
        points = np.concatenate([poses[path].x for path in self._paths])
        now = np.ascontiguousarray(x[self._rows], dtype=float)
        out = now[~self._wound(points, now)]
        if len(out) == 0:
            return Outside(share=0.0, depth=0.0)
        square = igl.point_mesh_squared_distance(
            out, np.ascontiguousarray(points, dtype=float), self._triangles
        )[0]
        away = np.sqrt(np.asarray(square).reshape(-1))
        far = away[away > FAR * self._spacing]
        return Outside(share=len(far) / len(self._rows), depth=float(far.max(initial=0.0)))

    def _wound(self, points: Floats, X: Floats) -> Ints:
        """(n,) whether the meshes, with points (V, 3) [m], wind around X (n, 3) [m]."""
        return np.abs(WoundSurfaces(points, self._triangles, self._ends).turns(X)) > WITHIN


def coarse(surfaces: Sequence[Surface], spacing: float) -> dict[str, float]:
    """The longest edge [m] of meshes with many long faces, by path, longest first.

    surfaces : at rest; spacing : [m] of the particles.
    """
    found: dict[str, float] = {}
    for one in surfaces:
        corners = np.asarray(one.points, float)[one.triangles]
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(1)
        area = areas(one.points, one.triangles)
        if area[edges > LONG * spacing].sum() > SHARE * area.sum():
            found[one.path] = float(edges.max())
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def named(meshes: Mapping[str, float], spacing: float) -> str:
    """The meshes of `coarse` in words."""
    path, edge = next(iter(meshes.items()))
    more = f" and {len(meshes) - 1} more" if len(meshes) > 1 else ""
    return f"<{path}>{more} (edges up to {edge / spacing:.2g} spacings of {spacing:.3g} m)"
