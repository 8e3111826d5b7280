"""Node hierarchy of a glTF file, and node transforms for row vectors.

glTF 2.0, 3.5: the transform of a node is T R S for column vectors; here x_parent = x S R T.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.core.matrices import signed_polar
from gf_usd.readers.mesh.data import REPAIR
from gf_usd.readers.mesh.gltf.container import Gltf

DEEPEST = 1000  # ancestors of a node; more are taken for a cycle
SHEAR = 1e-4  # relative shear above which a matrix is not a rotation and scale


class Nodes:
    """The nodes of a file, and their parents."""

    def __init__(self, gltf: Gltf) -> None:
        self._gltf = gltf
        self.parents = {
            child: i
            for i, node in enumerate(gltf.rows("nodes"))
            for child in node.get("children", [])
        }

    def row(self, index: int) -> dict[str, Any]:
        """The JSON object of a node."""
        return self._gltf.row("nodes", index)

    def name(self, index: int) -> str:
        """The name of a node, or one made from its index."""
        return str(self.row(index).get("name") or f"node{index}")

    def chain(self, index: int) -> list[int]:
        """A node and its ancestors, up to a root.  Raises InputError for a cycle."""
        out = [index]
        while (above := self.parents.get(out[-1])) is not None:
            out.append(above)
            if len(out) > DEEPEST:
                raise InputError(f"{self._gltf.path}: node {index} is its own descendant", REPAIR)
        return out

    def local(self, index: int) -> NDArray[np.float64]:
        """(4, 4) local transform of a node, relative to its parent."""
        matrix = local_matrix(self.row(index))
        return np.eye(4) if matrix is None else matrix

    def world(self, index: int) -> NDArray[np.float64]:
        """(4, 4) transform of a node to the scene."""
        matrix = np.eye(4)
        for at in self.chain(index):
            matrix = matrix @ self.local(at)
        return matrix

    def parts(self, index: int) -> Parts:
        """Translation, rotation and scale of a node.

        Raises InputError for a matrix that cannot be decomposed into these.
        """
        row = self.row(index)
        if "matrix" not in row:
            return Parts(
                translation=np.array(row.get("translation", (0.0, 0.0, 0.0)), float),
                rotation=np.array(row.get("rotation", (0.0, 0.0, 0.0, 1.0)), float),
                scale=np.array(row.get("scale", (1.0, 1.0, 1.0)), float),
            )
        from scipy.spatial.transform import Rotation

        M = self.local(index)
        A = M[:3, :3].T
        R = signed_polar(A[None])[0]
        S = R.T @ A
        off = S - np.diag(np.diag(S))
        if np.abs(off).max() > SHEAR * np.abs(S).max():
            raise InputError(
                f"{self._gltf.path}: the matrix of node {index} ({self.name(index)}) contains a "
                f"shear, but a joint of a skeleton may only have translation, rotation and scale",
                "export it again with the translation, rotation and scale of each joint",
            )
        return Parts(
            translation=M[3, :3], rotation=Rotation.from_matrix(R).as_quat(), scale=np.diag(S)
        )


@dataclass(frozen=True, kw_only=True)
class Parts:
    """A decomposed transform."""

    translation: Floats  # (3,)
    rotation: Floats  # (4,) (x, y, z, w)
    scale: Floats  # (3,)


def local_matrix(row: dict[str, Any]) -> Floats | None:
    """(4, 4) local transform for row vectors, x_parent = x S R T; None where it is the identity."""
    if "matrix" in row:
        # Column-major for column vectors is row-major for row vectors.
        return np.array(row["matrix"], np.float64).reshape(4, 4)
    if not any(key in row for key in ("translation", "rotation", "scale")):
        return None
    matrix = np.eye(4)
    scale = np.array(row.get("scale", (1.0, 1.0, 1.0)), np.float64)
    turn = _rotation(np.array(row.get("rotation", (0.0, 0.0, 0.0, 1.0)), np.float64))
    matrix[:3, :3] = scale[:, None] * turn.T
    matrix[3, :3] = row.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _rotation(q: Floats) -> Floats:
    """(3, 3) rotation of a quaternion (x, y, z, w), for column vectors; identity for length 0."""
    length = float(np.linalg.norm(q))
    x, y, z, w = q / length if length > 0.0 else (0.0, 0.0, 0.0, 1.0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
