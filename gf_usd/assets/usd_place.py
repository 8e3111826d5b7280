"""Where a prim's points stand in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Gf

Floats = NDArray[np.float64]

# Below this fraction of its scale cubed a 3 x 3 matrix has no usable inverse in double precision.
FLAT = 1e-12

# The note on a mesh whose own animation the simulation takes the place of.
ANIMATED = "is animated: the simulation starts from its pose at the first frame"


class LeftAlone(Exception):
    """The prim is not made soft; the text says why."""


@dataclass(frozen=True)
class Placement:
    """x_world = x M (row vectors), M the 4 x 4 local-to-world matrix."""

    matrix: Floats  # (4, 4)

    @property
    def skinned(self) -> bool:
        """True where a skeleton poses the points."""
        return False

    @classmethod
    def of(cls, matrix: Gf.Matrix4d) -> Placement:
        """Raises LeftAlone for a matrix that is not finite or flattens space."""
        rows = np.array(matrix, dtype=np.float64)
        if not np.isfinite(rows).all():
            raise LeftAlone("its transform is not finite")
        scale = np.linalg.norm(rows[:3, :3], axis=1)
        det = float(np.linalg.det(rows[:3, :3]))
        if abs(det) <= FLAT * float(scale.max()) ** 3:
            raise LeftAlone(f"its transform flattens it (determinant {det:.3g})")
        return cls(rows)

    @property
    def mirrored(self) -> bool:
        """True where the placement turns the winding over."""
        return bool(np.linalg.det(self.matrix[:3, :3]) < 0.0)

    def points(self, points: Floats) -> Floats:
        """(V, 3) local to world."""
        return points @ self.matrix[:3, :3] + self.matrix[3, :3]

    def normals(self, normals: Floats, carriers: NDArray[np.int64]) -> Floats:
        """(K, 3) local to world by the inverse transpose, not normalised.

        `carriers` (K,): the point whose place each normal has; a rigid placement needs it not.
        """
        del carriers
        return normals @ np.linalg.inv(self.matrix[:3, :3]).T
