"""Blend shapes on simulated flesh: their offsets from the rest shape, carried by its deformation.

With the deformation gradient F of a point of the flesh and D the offset that its blend shapes have
at a frame, in the rest pose, the surface is at

    x = x_0 + F D

which is the skinned and blended pose where the flesh is at its skinned pose.  The flesh itself does
not feel the offset.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.frames.differences import velocity_at
from gf_usd.core.frames.frame import Pose
from gf_usd.core.stage import BlendShapes


def with_shapes(pose: Pose, shapes: BlendShapes, frame: int, frame_time: float) -> Pose:
    """The pose of a surface at a frame, with its blend shapes; frame_time : [s] of one frame.

    The velocity of the offset D is that of `velocity_at`, without the change of F.
    """
    D = _offsets(shapes, frame)
    rate = velocity_at(partial(_offsets, shapes), frame, frame_time, len(shapes.weights) - 1)
    x, v = (np.einsum("nab,nb->na", pose.F, each) for each in (D, rate))
    return Pose(x=pose.x + x, v=pose.v + v, F=pose.F)


def _offsets(shapes: BlendShapes, frame: int) -> NDArray[np.float64]:
    """(V, 3) [m] at a frame, of the first or last at most."""
    k = int(np.clip(frame, 0, len(shapes.weights) - 1))
    return np.asarray(shapes.offsets @ shapes.weights[k]).reshape(-1, 3)
