"""The share of the particles outside the meshes that show their body: faces too long to bend with
it.

The points of a mesh are embedded in its body, and a face is flat between its points: no point of a
cube with eight vertices follows a dent in one of its sides. Meshes with short edges only are not
measured, since they follow their body.

A particle is outside where the total winding number of all meshes is 0 (generalized winding number;
Jacobson, Kavan and Sorkine-Hornung 2013, by libigl) and it is more than FAR from all of them.
Particles that are outside at rest, for example in a sheet that was thickened, do not count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.frames.frame import Pose
from gf_usd.pipeline.measures.inside import WITHIN, WindingNumbers, stacked

FAR = 1.0  # [spacings] from the meshes
MOST = 3000  # particles of a measurement


@dataclass(frozen=True, kw_only=True)
class Outside:
    """The result of one measurement."""

    share: float  # of the measured particles, more than FAR outside
    depth: float  # [m] largest distance of such a particle from the meshes; 0: none


class OutsideMeasure:
    """Measures the particles outside the meshes of all bodies.

    surfaces : at rest; X : (N, 3) [m] of all particles at rest; spacing : [m] of them.
    """

    def __init__(self, surfaces: Sequence[Surface], X: Floats, spacing: float) -> None:
        self._paths = [one.path for one in surfaces]
        points, self._triangles, self._ends = stacked(surfaces)
        self._spacing = spacing
        some = np.arange(0, len(X), max(1, -(-len(X) // MOST)))
        self._rows: Ints = some[self._winding(points, X[some])]

    def measure(self, poses: Mapping[str, Pose], x: Floats) -> Outside:
        """The share of the particles outside, for the poses of the meshes and particles at x (N, 3)
        [m].

        The share is 0 where no particle was inside at rest.
        """
        if len(self._rows) == 0:
            return Outside(share=0.0, depth=0.0)
        points = np.concatenate([poses[path].x for path in self._paths])
        now = np.ascontiguousarray(x[self._rows], dtype=float)
        out = now[~self._winding(points, now)]
        if len(out) == 0:
            return Outside(share=0.0, depth=0.0)
        square = igl.point_mesh_squared_distance(
            out, np.ascontiguousarray(points, dtype=float), self._triangles
        )[0]
        away = np.sqrt(np.asarray(square).reshape(-1))
        far = away[away > FAR * self._spacing]
        return Outside(share=len(far) / len(self._rows), depth=float(far.max(initial=0.0)))

    def _winding(self, points: Floats, X: Floats) -> Ints:
        """(n,) whether points X (n, 3) [m] are inside the meshes with points (V, 3) [m]."""
        return (
            np.abs(WindingNumbers(points, self._triangles, self._ends).winding_numbers(X)) > WITHIN
        )
