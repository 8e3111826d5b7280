"""The transforms of glTF nodes, for row vectors."""

from __future__ import annotations

from typing import Any

import numpy as np

from gf_usd.model import Floats


def local_matrix(row: dict[str, Any]) -> Floats | None:
    """(4, 4) of a node for row vectors, x_parent = x S R T; None where it says nothing."""
    if "matrix" in row:
        # Column by column for column vectors is row by row for row vectors.
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
