"""The box of a stage's motion."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd
from small_sources import SKINNED

from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import STATIC_MARGIN, motion_bounds, sample_times


@pytest.mark.parametrize("odd", ["double radius = -1", 'uniform token axis = "up"'])
def test_a_shape_that_cannot_be_made_adds_nothing(write, odd):
    stage = Usd.Stage.Open(str(write(f'def Cube "A" {{}}\ndef Cylinder "S" {{\n{odd}\n}}')))
    prims = list(stage.GetPseudoRoot().GetChildren())
    box = Bounds(low=(-2.0, -2.0, -2.0), high=(2.0, 2.0, 2.0))
    assert motion_bounds(prims, (), 2.0) == box


MOVING = """
def Cube "Box" {
    double size = 2
    double3 xformOp:translate.timeSamples = { 1: (0, 1, 0), 9: (0, 3, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Cube "Ground" {
    double size = 1
    double3 xformOp:translate = (0, -0.5, 0)
    float3 xformOp:scale = (100, 1, 100)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}
def Cube "FarAway" {
    double size = 1
    double3 xformOp:translate = (500, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


def test_what_stays_is_in_the_box_as_far_as_it_is_near_what_moves(write) -> None:
    stage = Usd.Stage.Open(str(write(MOVING)))
    box, ground, far = stage.GetPseudoRoot().GetChildren()
    own = motion_bounds([box], (1.0, 9.0), 1.0)
    assert own == Bounds(low=(-1.0, 0.0, -1.0), high=(1.0, 4.0, 1.0))
    reach = STATIC_MARGIN * (2.0**2 + 4.0**2 + 2.0**2) ** 0.5
    all_three = motion_bounds([box, ground, far], (1.0, 9.0), 1.0)
    assert all_three is not None
    near = max(-reach, -1.0)
    np.testing.assert_allclose(all_three.low, (-1.0 - reach, near, -1.0 - reach))
    np.testing.assert_allclose(all_three.high, (1.0 + reach, 4.0, 1.0 + reach))
    # where nothing moves all of it is shown
    static = motion_bounds([ground, far], (), 1.0)
    assert static == Bounds(low=(-50.0, -1.0, -50.0), high=(500.5, 0.5, 50.0))


def test_an_animation_outside_of_the_skel_root_moves_what_it_poses(tmp_path):
    stage = Usd.Stage.Open(str(SKINNED.asset(tmp_path).facts.path))
    assert sample_times([stage.GetPrimAtPath("/root/figure/skin")]) == [1.0, 5.0]
