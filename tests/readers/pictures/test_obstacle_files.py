"""Obstacles of other files that a bake had are in its pictures, and not in its result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.readers.pictures.scene import PictureStage

# a bake in centimeters, Y up, with a cube of 2 cm whose path is that of the first obstacle
BAKE = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 2
    customLayerData = { dictionary gaussianFlesh = { string[] colliders = [%s] } }
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
    root.write_text(BAKE % '"../sets/plate.usda"')
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
    assert plate.name.startswith("/ObstacleFiles_1/")
    assert plate.name in picture.bodies_and_obstacles()[1]


def test_pictures_leave_the_file_of_the_bake_as_it_is(bake: Path) -> None:
    before = bake.read_bytes()
    PictureStage(bake, "mesh").scene()
    assert bake.read_bytes() == before


def test_recordings_have_them_only_where_they_are_asked_for(bake: Path) -> None:
    names = [mesh.name for mesh in BakedMotion(bake).recording().meshes]
    assert names == ["/ObstacleFiles/box"]
    with_files = BakedMotion(bake, displayed=True).recording()
    assert [mesh.name for mesh in with_files.meshes] == [*names, "/ObstacleFiles_1/plate_Plate"]


@pytest.mark.parametrize(
    ("content", "reason"), [(None, "does not exist"), ("#usda 1.0\n", "no mesh"), ("solid", "")]
)
def test_one_that_cannot_be_read_is_named(bake: Path, content: str | None, reason: str) -> None:
    plate = bake.parents[1] / "sets" / "plate.usda"
    plate.unlink() if content is None else plate.write_text(content)
    seen = PictureStage(bake, "mesh").scene()
    assert [mesh.name for mesh in seen.meshes] == ["/ObstacleFiles/box"]
    (note,) = seen.notes
    assert note.startswith("plate.usda, an obstacle of the bake, is not drawn: ")
    assert reason in note
