"""Blend shapes on flesh: the offset in the pose of the flesh, and its velocity."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from gf_usd.core.frames.frame import Pose
from gf_usd.core.stage import BlendShapes
from gf_usd.geometry.flesh.shapes import with_shapes

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x to y
OFFSETS = np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.3]])  # of two points, by one shape each
SHAPES = BlendShapes(
    names=("A", "B"),
    offsets=csr_matrix(np.stack([(OFFSETS * (1, 1, 0)).ravel(), (OFFSETS * (0, 0, 1)).ravel()], 1)),
    weights=np.array([[0.0, 0.0], [0.5, 1.0], [1.0, 1.0]]),
)


@pytest.mark.parametrize(("frame", "rate"), [(0, (0.5, 1.0)), (1, (0.5, 0.5)), (2, (0.5, 0.0))])
def test_the_offset_is_carried_by_the_flesh(frame: int, rate: tuple[float, float]) -> None:
    """rate : change of the weights in a frame, one-sided at the ends."""
    pose = Pose(x=np.eye(3)[:2], v=np.full((2, 3), 7.0), F=np.stack([TURN, 2.0 * np.eye(3)]))
    out = with_shapes(pose, SHAPES, frame, 0.1)
    a, b = SHAPES.weights[frame]
    np.testing.assert_allclose(out.x - pose.x, [(0.0, 0.1 * a, 0.0), (0.0, 0.0, 0.6 * b)])
    speeds = np.array([(0.0, 0.1 * rate[0], 0.0), (0.0, 0.0, 0.6 * rate[1])]) / 0.1
    np.testing.assert_allclose(out.v - pose.v, speeds, atol=1e-12)
    np.testing.assert_array_equal(out.F, pose.F)
