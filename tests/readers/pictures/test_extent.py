"""The box of a stage's motion."""

from __future__ import annotations

import pytest
from pxr import Usd
from small_sources import SKINNED

from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import motion_bounds, sample_times


@pytest.mark.parametrize("odd", ["double radius = -1", 'uniform token axis = "up"'])
def test_a_shape_that_cannot_be_made_adds_nothing(write, odd):
    stage = Usd.Stage.Open(str(write(f'def Cube "A" {{}}\ndef Cylinder "S" {{\n{odd}\n}}')))
    prims = list(stage.GetPseudoRoot().GetChildren())
    box = Bounds(low=(-2.0, -2.0, -2.0), high=(2.0, 2.0, 2.0))
    assert motion_bounds(prims, (), 2.0) == box


def test_an_animation_outside_of_the_skel_root_moves_what_it_poses(tmp_path):
    stage = Usd.Stage.Open(str(SKINNED.asset(tmp_path).facts.path))
    assert sample_times([stage.GetPrimAtPath("/root/figure/skin")]) == [1.0, 5.0]
