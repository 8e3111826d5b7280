"""A bone of one affine motion."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Bone


def moved_bone(A: Floats, b: Floats) -> Bone:
    """A bone at rest in the first frame, and moved by x = A X + b in the second."""
    corners = np.vstack([np.zeros(3), np.eye(3)])
    path = np.stack([corners, corners @ A.T + b])
    return Bone(name="b", segments=np.zeros((0, 2, 3)), free=(), anchors=corners, path=path)
