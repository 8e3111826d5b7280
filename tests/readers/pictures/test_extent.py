"""The box of a stage's motion."""

from __future__ import annotations

import pytest
from pxr import Usd

from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import motion_bounds


@pytest.mark.parametrize("odd", ["double radius = -1", 'uniform token axis = "up"'])
def test_a_shape_that_cannot_be_made_adds_nothing(write, odd):
    stage = Usd.Stage.Open(str(write(f'def Cube "A" {{}}\ndef Cylinder "S" {{\n{odd}\n}}')))
    prims = list(stage.GetPseudoRoot().GetChildren())
    box = Bounds(low=(-2.0, -2.0, -2.0), high=(2.0, 2.0, 2.0))
    assert motion_bounds(prims, (), 2.0) == box
