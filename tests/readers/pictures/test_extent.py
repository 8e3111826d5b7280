"""The box of a stage's motion."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Sdf, Usd
from small_sources import SKINNED, Source
from small_stages import CUBE, bake

import gf_usd
from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import (
    DIRECTIONS,
    STATIC_MARGIN,
    frame_times,
    motion_bounds,
    sample_times,
    support_points,
)
from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.readers.pictures.scene import PictureStage


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


def test_a_picture_contains_all_of_an_obstacle_but_of_no_ground(write) -> None:
    """A bowl was cut off where it was more than a tenth wider than the motion."""
    tray = """
def Cube "Tray" {
    double size = 1
    double3 xformOp:translate = (1, -0.5, 0)
    float3 xformOp:scale = (7, 1, 3)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}
"""
    motion = PictureStage(write(MOVING + tray)).motion
    points = motion.framed
    np.testing.assert_allclose(points.max(axis=0), (4.5, 4.0, 1.5))
    np.testing.assert_allclose(points.min(axis=0), (-2.5, -1.0, -1.5))
    assert motion.bounds is not None
    assert motion.bounds.high[0] == 4.5


def test_what_touches_an_obstacle_is_shown_too_if_it_is_not_large(write) -> None:
    """Of a brush the head is below the bristles, and the handle beside the head."""
    part = """
def Cube "{}" {{
    double size = 1
    double3 xformOp:translate = ({})
    float3 xformOp:scale = ({})
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}}
"""
    bristles = part.format("Bristles", "0, -0.5, 0", "2, 1, 2")
    head = part.format("Head", "0, -2, 0", "2, 2, 2")
    handle = part.format("Handle", "5.5, -2, 0", "9, 1, 1")
    table = part.format("Table", "0, -4, 0", "12, 2, 12")
    brush = write(MOVING + bristles + head + handle + table)
    points = PictureStage(brush).motion.framed
    np.testing.assert_allclose(points.min(axis=0), (-1.0, -3.0, -1.0))
    np.testing.assert_allclose(points.max(axis=0), (10.0, 4.0, 1.0))


def test_a_picture_of_a_motion_is_fitted_to_its_points_and_not_to_their_box(write) -> None:
    """A body that falls along the diagonal of its box."""
    falls = MOVING.replace("1: (0, 1, 0), 9: (0, 3, 0)", "1: (0, 1, 0), 9: (20, 21, 0)")
    points = PictureStage(write(falls)).motion.framed
    across = points @ (1.0, -1.0, 0.0)
    np.testing.assert_allclose((across.min(), across.max()), (-3.0, 1.0))
    np.testing.assert_allclose((points.min(0), points.max(0)), ((-1, 0, -1), (21, 22, 1)))


@pytest.mark.parametrize("count", [7, 5000])
def test_support_points_span_almost_the_hull(count: int) -> None:
    points = np.random.default_rng(0).normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    few = support_points(points)
    assert len(few) <= DIRECTIONS
    ways = np.random.default_rng(1).normal(size=(200, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    whole, kept = ((one @ ways.T).max(axis=0) for one in (points, few))
    # no direction is farther than 0.27 rad from one of DIRECTIONS, whose cosine is 0.964
    assert (kept >= whole - 0.04).all()


HELD = "[(0, 9, 0), (1, 9, 1), (1, 10, 1)]"
SAMPLED = f".timeSamples = {{ 1: {HELD}, 9: {HELD} }}"
LINK = """
def Mesh "Link" {
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points%s
}
"""
NAMES = 'def Points "Particles" {\n rel gaussianFlesh:sourceMeshes = [</Link>]\n}'
HEALTH = """over "Box" {
    custom double gaussianFlesh:health:kineticEnergy.timeSamples = { 1: 1, 9: 0 }
}
"""


def layer_of(text: str) -> Sdf.Layer:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString("#usda 1.0\n" + text)
    return layer


@pytest.mark.parametrize(
    ("asset", "cache", "top"),
    [
        (MOVING + LINK % f" = {HELD}" + NAMES, "", 10.0),
        (MOVING + LINK % SAMPLED, "", 4.0),
        (MOVING + LINK % SAMPLED, HEALTH, 4.0),
        (MOVING + LINK % f" = {HELD}", HEALTH + LINK % SAMPLED, 10.0),
    ],
    ids=["listed", "no bake", "of the asset", "of the cache"],
)
def test_a_body_that_a_pin_holds_whole_is_in_the_box(asset: str, cache: str, top: float) -> None:
    """The first link of a chain was cut off.  Samples that are equal do not make a body: exporters
    sample everything, and a ground of 20 m made a ball a dot.
    """
    stage = Usd.Stage.Open(layer_of(""))
    kept = [layer_of(cache), layer_of(asset)]
    stage.GetRootLayer().subLayerPaths = [layer.identifier for layer in kept]
    prims = [stage.GetPrimAtPath(path) for path in ("/Box", "/Link")]
    bounds = motion_bounds(prims, (1.0, 9.0), 1.0)
    assert bounds is not None
    assert bounds.high[1] == top


def test_an_animation_outside_of_the_skel_root_moves_what_it_poses(tmp_path):
    stage = Usd.Stage.Open(str(SKINNED.asset(tmp_path).facts.path))
    assert sample_times([stage.GetPrimAtPath("/root/figure/skin")]) == [1.0, 5.0]


def test_frames_of_a_bake_are_those_that_were_simulated(tmp_path) -> None:
    """What its bodies are below is animated at other times, and for longer."""
    source = Source(
        f"""
def Xform "duck" {{
    double3 xformOp:translate.timeSamples = {{ -3: (0, 0, 0), 2.5: (1, 0, 0), 90: (9, 0, 0) }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "m" {{ {CUBE}
    }}
}}
"""
    )
    asset = source.asset(tmp_path)
    root = bake(asset, tmp_path, frames=4)[0].path
    expected = (1.0, 2.0, 3.0, 4.0)
    assert tuple(gf_usd.read(root).time_codes) == expected
    assert BakedMotion(root).recording().time_codes == expected
    assert PictureStage(root).motion.time_codes == (1.0, 2.0, 2.5, 3.0, 4.0)
    plain = Usd.Stage.Open(str(asset.facts.path))
    assert frame_times([plain.GetPrimAtPath("/duck/m")]) == [-3.0, 2.5, 90.0]
