"""The transforms of glTF nodes, for row vectors."""

from __future__ import annotations

from typing import Any

import numpy as np

from gf_usd.assets.gltf import Gltf
from gf_usd.assets.mesh_data import REPAIR
from gf_usd.errors import InputError
from gf_usd.model import Floats


def local_matrix(gltf: Gltf, row: dict[str, Any]) -> Floats | None:
    """(4, 4) of a node for row vectors, x_parent = x S R T; None where it says nothing."""
    try:
        if "matrix" in row:
            # Column by column for column vectors is row by row for row vectors.
            matrix = np.array(row["matrix"], np.float64).reshape(4, 4)
        elif any(key in row for key in ("translation", "rotation", "scale")):
            matrix = np.eye(4)
            scale = np.array(row.get("scale", (1.0, 1.0, 1.0)), np.float64).reshape(3)
            quaternion = np.array(row.get("rotation", (0.0, 0.0, 0.0, 1.0)), np.float64).reshape(4)
            matrix[:3, :3] = scale[:, None] * _rotation(quaternion).T
            matrix[3, :3] = np.array(row.get("translation", (0.0, 0.0, 0.0)), np.float64).reshape(3)
        else:
            return None
    except (ValueError, TypeError) as error:
        raise InputError(f"{gltf.path}: the transform of a node: {error}", REPAIR) from error
    if not np.isfinite(matrix).all():
        raise InputError(f"{gltf.path}: the transform of a node is not finite", REPAIR)
    return matrix


def _rotation(q: Floats) -> Floats:
    """(3, 3) of a quaternion (x, y, z, w) for column vectors; one of length 0 turns nothing."""
    length = float(np.linalg.norm(q))
    x, y, z, w = q / length if length > 0.0 else (0.0, 0.0, 0.0, 1.0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
