"""The motion of a stage as plain arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gf_usd.core.errors import InputError, UsageError
from gf_usd.delivery.deliver import deliver
from gf_usd.readers.pictures.recording import BakedMotion

# centimeters, Z up; two looks that move a square and one Gaussian differently
STAGE = """#usda 1.0
(
    customLayerData = {
        dictionary gaussianFlesh = {
            string command = "gf-usd bake it"
            dictionary looks = {
                dictionary hard = { dictionary settings = {
                    double floor = 0.25
                } }
            }
        }
    }
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Z"
    timeCodesPerSecond = 48
)
def Xform "World" (
    variants = { string gaussianFlesh = "SELECTED" }
    prepend variantSets = "gaussianFlesh"
)
{
    double3 xformOp:translate = (0, 0, 100)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "Square"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        color3f[] primvars:displayColor = [(0.2, 0.4, 0.6)]
    }
    def Mesh "Prop"
    {
        point3f[] points = [(5, 0, 0), (6, 0, 0), (6, 1, 0)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
    }
    variantSet "gaussianFlesh" = {
        "none" {}
        "hard" { HARD }
        "soft" { SOFT }
    }
}
"""
LOOK = """
    over "Square"
    {
        point3f[] points.timeSamples = {
            10: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
            12: [(0, 0, DOWN), (1, 0, DOWN), (1, 1, DOWN), (0, 1, DOWN)]
        }
    }
    def ParticleField3DGaussianSplat "Gaussians"
    {
        uniform point3f[] gaussianFlesh:restPositions = [(0, 0, 0)]
        uniform float3[] gaussianFlesh:restScales = [(1, 2, 3)]
        uniform float[] gaussianFlesh:masses = [0.5]
        rel gaussianFlesh:sourceMeshes = </World/Square>
        point3f[] positions.timeSamples = { 10: [(0.5, 0.5, 0)], 12: [(0.5, 0.5, DOWN)] }
        quatf[] orientations = [(0.70710678, 0, 0, 0.70710678)]
        float3[] scales.timeSamples = { 10: [(1, 2, 3)], 12: [(2, 2, 3)] }
        float[] opacities = [1]
        float[] gaussianFlesh:vonMisesStress.timeSamples = { 10: [0], 12: [7] }
        uniform int radiance:sphericalHarmonicsDegree = 0
        float3[] radiance:sphericalHarmonicsCoefficients = [(0, 0, 0)]
    }
"""


def write(folder: Path, selected: str = "hard", **changes: str) -> Path:
    text = STAGE.replace("SELECTED", selected)
    text = text.replace("HARD", LOOK.replace("DOWN", "-1")).replace(
        "SOFT", LOOK.replace("DOWN", "-3")
    )
    for old, new in changes.items():
        text = text.replace(old, new)
    path = folder / "it.usda"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_selected_variant_is_read_in_meters(tmp_path):
    motion = BakedMotion(write(tmp_path))
    recording = motion.recording()
    assert (motion.variants, recording.variant, recording.name) == (
        ("hard", "soft"),
        "hard",
        "World",
    )
    assert recording.up == (0.0, 0.0, 1.0)
    assert recording.ground == 0.25
    assert recording.time_codes == (10.0, 12.0)
    assert recording.seconds(12.0) == pytest.approx(2 / 48)
    assert recording.about["command"] == "gf-usd bake it"
    assert [mesh.name for mesh in recording.meshes] == ["/World/Square", "/World/Prop"]
    assert recording.baked == (True, False)
    first, last = motion.frames()
    assert first.meshes[0] == pytest.approx(recording.meshes[0].points)
    # singles in centimeters
    assert last.meshes[0][2] == pytest.approx([0.01, 0.01, 0.99], abs=1e-8)
    assert last.meshes[1] == pytest.approx(first.meshes[1])


def test_gaussians_come_with_their_rest_and_their_axes(tmp_path):
    motion = BakedMotion(write(tmp_path))
    cloud = motion.recording().gaussians
    assert cloud is not None
    assert cloud.rest_scales == pytest.approx(np.array([[0.01, 0.02, 0.03]]))
    assert cloud.masses == pytest.approx([0.5])
    (frame,) = motion.frames([12.0])
    assert frame.positions == pytest.approx(np.array([[0.005, 0.005, 0.99]]))
    # a quarter turn about Z takes x to y and y to -x
    assert frame.axes[0] == pytest.approx(
        np.array([[0, -0.02, 0], [0.02, 0, 0], [0, 0, 0.03]]), abs=1e-8
    )
    # kg / (s^2 cm) in pascals
    assert frame.measured["stress"] == pytest.approx([700.0])


def test_another_variant_is_chosen_in_the_session_only(tmp_path):
    path = write(tmp_path)
    before = path.read_bytes()
    soft = BakedMotion(path, "soft")
    assert [frame.meshes[0][0, 2] for frame in soft.frames()] == pytest.approx([1.0, 0.97])
    assert soft.recording().ground is None
    assert [f.meshes[0][0, 2] for f in BakedMotion(path).frames()] == pytest.approx([1.0, 0.99])
    assert path.read_bytes() == before
    with pytest.raises(UsageError, match="no variant 'liquid'") as caught:
        BakedMotion(path, "liquid")
    assert caught.value.hint == "it holds hard, soft"


def test_a_tilted_floor_is_left_out_with_a_note(tmp_path):
    tilt = {"double floor = 0.25": "double floor = 0.25\ndouble3 floor_normal = (0, 0.6, 0.8)"}
    recording = BakedMotion(write(tmp_path, **tilt)).recording()
    assert recording.ground is None
    assert "its floor is tilted and is not drawn" in recording.notes


def test_where_the_source_is_selected_the_first_bake_is_shown(tmp_path):
    assert BakedMotion(write(tmp_path, selected="none")).variant == "hard"


def test_a_moving_stage_that_is_no_bake_is_read(tmp_path):
    path = tmp_path / "ball.usda"
    path.write_text(
        """#usda 1.0
(
    metersPerUnit = 1
)
def Sphere "Ball"
{
    double3 xformOp:translate.timeSamples = { 1: (0, 2, 0), 2: (0, 1, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
""",
        encoding="utf-8",
    )
    motion = BakedMotion(path)
    recording = motion.recording()
    assert (recording.variant, recording.ground, recording.gaussians) == ("", None, None)
    assert recording.name == "ball"
    drop = [frame.meshes[0][:, 1].mean() for frame in motion.frames()]
    assert drop == pytest.approx([2.0, 1.0])
    with pytest.raises(UsageError, match="no variant") as caught:
        BakedMotion(path, "hard")
    assert "holds no bake" in caught.value.hint


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"(0.5, 0.5, -1)": "(0.5, 0.5, nan)"}, "1 positions"),
        ({"12: [(2, 2, 3)]": "12: [(2, 2, 3), (1, 1, 1)]"}, "2 scales"),
        ({", (0, 1, -1)]": "]"}, "3 points"),
    ],
)
def test_broken_frames_are_refused_with_their_place(tmp_path, change, message):
    motion = BakedMotion(write(tmp_path, **change))
    with pytest.raises(InputError, match=message) as caught:
        list(motion.frames())
    assert "12" in caught.value.message
    assert "/World/" in caught.value.message


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("still.usda", '#usda 1.0\ndef Sphere "Ball" {}\n', "nothing in this file moves"),
        ("no.usda", "hello", "not a USD file"),
        ("gone.usda", None, "does not exist"),
    ],
)
def test_what_is_no_motion_is_refused(tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        BakedMotion(tmp_path / name)


CHANGING = """#usda 1.0
( upAxis = "Y"
  metersPerUnit = 0.01
  timeCodesPerSecond = 24 )
def Mesh "Surface"
{
    point3f[] points.timeSamples = {
        1: [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        2: [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)],
        3: [],
    }
    int[] faceVertexCounts.timeSamples = { 1: [3], 2: [3, 3], 3: [] }
    int[] faceVertexIndices.timeSamples = { 1: [0, 1, 2], 2: [0, 1, 2, 0, 2, 3], 3: [] }
    color3f[] primvars:displayColor.timeSamples = {
        1: [(1, 0, 0), (1, 0, 0), (1, 0, 0)],
        2: [(0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 1, 0)],
        3: [],
    }
    color3f[] primvars:displayColor ( interpolation = "vertex" )
}
"""


def test_a_mesh_whose_faces_change_is_read_whole_in_every_frame(tmp_path: Path) -> None:
    path = tmp_path / "changing.usda"
    path.write_text(CHANGING, encoding="utf-8")
    motion = BakedMotion(path)
    recording = motion.recording()
    assert (recording.meshes, recording.flows) == ((), ("/Surface",))
    assert recording.notes == ()
    one, two, none = motion.frames()
    assert none.flows == ()
    assert [len(frame.flows[0].triangles) for frame in (one, two)] == [1, 2]
    np.testing.assert_allclose(two.flows[0].points[2], (0.02, 0.02, 0.0))
    np.testing.assert_allclose(two.flows[0].colors[0], np.tile([0.0, 1.0, 0.0], (3, 1)))


def test_what_changes_its_faces_is_not_delivered(tmp_path: Path) -> None:
    path = tmp_path / "changing.usda"
    path.write_text(CHANGING, encoding="utf-8")
    with pytest.raises(InputError, match="the faces of </Surface> change") as caught:
        deliver(path, tmp_path / "changing.glb")
    assert "--splats only" in caught.value.hint
