"""Strays of a capture do not push the object out of the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from captures import ball, define
from pxr import Usd, UsdGeom

from gf_usd.core.scene import RenderSplats, Scene, to_frame
from gf_usd.readers.pictures.extent import motion_bounds
from gf_usd.view.render.packing import extent_points


def with_strays(count: int = 8):
    """A ball of radius 0.5, some of whose Gaussians lie 40 away on all sides."""
    rest = ball(800)
    positions = np.array(rest.positions)
    positions[:count] *= 80.0
    return replace(rest, positions=positions)


def test_strays_and_faint_ones_are_left_out_and_what_sticks_out_is_not():
    rest = with_strays()
    opacities = np.ones(800)
    opacities[-5:] = 0.05
    positions = np.array(rest.positions)
    positions[100] = [0.9, 0.0, 0.0]  # a horn of one Gaussian, 0.8 of the radius high
    held = to_frame(positions, opacities)
    assert not held[:8].any()
    assert not held[-5:].any()
    assert held[8:-5].all()


@pytest.mark.parametrize("opacity", [0.0, 1.0])
def test_a_clean_or_an_unseen_capture_is_held_whole(opacity):
    assert to_frame(ball(100).positions, np.full(100, opacity)).all()


def test_the_box_of_the_motion_and_of_a_picture(tmp_path):
    rest = with_strays()
    stage = Usd.Stage.CreateNew(str(tmp_path / "ball.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    box = motion_bounds([define(stage, "/ball", rest)], (), 1.0)
    # half a side, and two standard deviations of a disc of 0.04
    assert box is not None
    assert max(np.abs([box.low, box.high]).ravel()) < 0.6
    cloud = RenderSplats(
        name="/ball",
        positions=rest.positions,
        axes=rest.axes,
        colors=rest.colors,
        opacities=rest.opacities,
    )
    assert np.abs(extent_points(Scene(up=(0.0, 1.0, 0.0), splats=(cloud,)))).max() < 0.6
    # particles of a bake are all of the body
    lit = Scene(up=(0.0, 1.0, 0.0), splats=(replace(cloud, lit=True),))
    assert np.abs(extent_points(lit)).max() > 30
