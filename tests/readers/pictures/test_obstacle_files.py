"""Obstacles of other files that a bake had are in its pictures, and not in its result."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf

from gf_usd.core.errors import InputError
from gf_usd.readers.pictures import obstacles as module
from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.readers.pictures.scene import PictureStage
from gf_usd.readers.usd_physics.obstacle_files import ObstacleFile, read_obstacle_file
from gf_usd.view.report.moments import scene_of

# a bake in centimeters, Y up, with a cube of 2 cm whose path is that of the first obstacle
BAKE = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 2
    customLayerData = {
        dictionary gaussianFlesh = {
            string[] colliders = ["../sets/plate.usda"]
            string[] colliderHashes = ["%s"]
        }
    }
)
def Xform "ObstacleFiles" {
    def Cube "box" {
        double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (0, 1, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
# in millimeters, Z up: a triangle of 10, 20 and 0 mm
PLATE = """#usda 1.0
(
    metersPerUnit = 0.001
    upAxis = "Z"
)
def Mesh "Plate" {
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 30), (10, 0, 30), (0, 20, 30)]
    color3f[] primvars:displayColor = [(0.1, 0.2, 0.3)]
}
"""


@pytest.fixture
def bake(tmp_path: Path) -> Path:
    """A bake in a folder of its own, whose obstacle is in another."""
    (tmp_path / "sets").mkdir()
    (tmp_path / "sets" / "plate.usda").write_text(PLATE)
    root = tmp_path / "out" / "box.usda"
    root.parent.mkdir()
    root.write_text(BAKE % hashlib.sha256(PLATE.encode()).hexdigest())
    return root


def test_they_are_drawn_where_the_solver_had_them(bake: Path) -> None:
    picture = PictureStage(bake, "mesh")
    seen = picture.scene()
    (plate,) = (mesh for mesh in seen.meshes if mesh.name.endswith("plate_Plate"))
    # USD's Z is up there, Y here: (x, y, z) -> (x, z, -y), and 1 mm is 1e-3 m
    expected = 1e-3 * np.array([[0.0, 30.0, 0.0], [10.0, 30.0, 0.0], [0.0, 30.0, -20.0]])
    np.testing.assert_allclose(plate.points, expected, atol=1e-9)
    np.testing.assert_allclose(plate.colors.reshape(-1, 3), [[0.1, 0.2, 0.3]] * 3, rtol=1e-6)
    assert seen.notes == ()
    # its prim has another path than that of the bake
    assert plate.name.startswith("/ObstacleFiles_2/")
    assert plate.name in picture.bodies_and_obstacles()[1]


def test_the_layers_of_the_bake_do_not_change(bake: Path) -> None:
    layer = Sdf.Layer.FindOrOpen(str(bake))
    before = layer.ExportToString()
    PictureStage(bake, "mesh").scene()
    BakedMotion(bake, displayed=True).recording()
    assert not layer.dirty
    assert layer.ExportToString() == before


def test_recordings_have_them_only_where_they_are_asked_for(bake: Path) -> None:
    names = [mesh.name for mesh in BakedMotion(bake).recording().meshes]
    assert names == ["/ObstacleFiles/box"]
    with_files = BakedMotion(bake, displayed=True).recording()
    assert [mesh.name for mesh in with_files.meshes] == [*names, "/ObstacleFiles_2/plate_Plate"]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "does not exist"),
        ("#usda 1.0\n", "no mesh was found"),
        ("solid", "is not a USD file"),
    ],
)
def test_one_that_cannot_be_read_is_named(bake: Path, content: str | None, reason: str) -> None:
    plate = bake.parents[1] / "sets" / "plate.usda"
    plate.unlink() if content is None else plate.write_text(content)
    seen = PictureStage(bake, "mesh").scene()
    assert [mesh.name for mesh in seen.meshes] == ["/ObstacleFiles/box"]
    (note,) = seen.notes
    assert note.startswith("plate.usda, an obstacle of the bake, is not drawn: ")
    assert reason in note


def test_one_that_has_changed_is_named(bake: Path) -> None:
    plate = bake.parents[1] / "sets" / "plate.usda"
    plate.write_text(PLATE.replace("30)", "40)"))
    seen = PictureStage(bake, "mesh").scene()
    assert len(seen.meshes) == 2
    assert seen.notes == (
        "plate.usda, an obstacle of the bake, has changed since, and is drawn as it is now",
    )


def test_files_are_read_once_for_all_variants(bake: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def counted(*given: Any) -> ObstacleFile:
        made.append(given)
        return read_obstacle_file(*given)

    monkeypatch.setattr(module, "read_obstacle_file", counted)
    obstacles: module.Read = {}
    for _ in range(2):
        motion = BakedMotion(bake, displayed=True, obstacles=obstacles)
        assert len(motion.recording().meshes) == 2
    assert len(made) == 1


def test_obstacles_are_no_bodies(bake: Path) -> None:
    assert BakedMotion(bake, displayed=True).recording().baked == (True, False)


def test_a_stage_of_which_nothing_else_can_be_drawn_is_refused(bake: Path) -> None:
    text = bake.read_text()
    a = text.index("def Xform")
    bake.write_text(text[:a] + 'def Xform "Duck" (references = @gone.usda@) {}\n')
    with pytest.raises(InputError, match="does not compose"):
        PictureStage(bake)


# particles that rise above a static plate
CLOUD = """
def ParticleField3DGaussianSplat "Sand" {
    point3f[] positions.timeSamples = { 1: [(0, 0, 0), (1, 0, 0)], 2: [(0, 9, 0), (1, 9, 0)] }
    quatf[] orientations = [(1, 0, 0, 0), (1, 0, 0, 0)]
    float3[] scales = [(0.1, 0.1, 0.1), (0.1, 0.1, 0.1)]
    float[] opacities = [1, 1]
}
"""


def test_pages_frame_gaussians_and_draw_them_with_obstacles(bake: Path) -> None:
    text = bake.read_text()
    a = text.index("def Xform")
    bake.write_text(text[:a] + CLOUD)
    source = BakedMotion(bake, displayed=True)
    recording = source.recording()
    assert (len(recording.meshes), recording.baked) == (1, (False,))
    assert recording.framed is not None
    assert recording.framed.high[1] == pytest.approx(0.09, abs=0.003)
    (frame,) = source.frames([2.0])
    seen = scene_of(recording, frame)
    assert (len(seen.meshes), len(seen.ellipsoids)) == (1, 1)
