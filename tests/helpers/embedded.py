"""Poses of embedded points by displacements and velocities in arrays of their own."""

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.frame import Pose
from gf_usd.physics.grid.embedding import SplineRows, embedded_pose
from gf_usd.physics.grid.reference.stencil import Rows


def pose(rows: Rows | SplineRows, u: Floats, v: Floats, offset: Floats) -> Pose:
    """`embedded_pose` of u [m] and v [m/s], (M, 3) each."""
    return embedded_pose(rows, np.concatenate([u, v], 1), offset)
