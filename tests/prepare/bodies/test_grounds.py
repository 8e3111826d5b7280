"""A mesh that looks like the ground of a scene is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from gf_usd import inspect

# Y up, centimeters; the ground is closed, and 4 cm high
SCENE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "World"
{
    def Sphere "Ball"
    {
        double radius = 10
        double3 xformOp:translate = (5, 14, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Cube "Plate" %s
    {
        double size = 1
        double3 xformOp:translate = (0, %g, 0)
        float3 xformOp:scale = (%g, %g, 100)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }
}
"""
COLLIDER = '(prepend apiSchemas = ["PhysicsCollisionAPI"])'


def notes(path: Path, *, api: str = "", y: float = 2.0, x: float = 100.0, height: float = 4.0):
    path.write_text(SCENE % (api, y, x, height), encoding="utf-8")
    seen = inspect(path, particles=300)
    return [note for note in seen.notes if "as a ground does" in note]


def test_a_plate_under_everything_is_named(tmp_path: Path) -> None:
    (note,) = notes(tmp_path / "a.usda")
    assert note == (
        "</World/Plate> is flat and lies under everything else, as a ground does, but it is soft"
        " and falls: apply PhysicsCollisionAPI to it to make it an obstacle, or bake the others"
        " alone (prims) on a floor at its height (floor=4)"
    )


@pytest.mark.parametrize(
    "other",
    [
        {"api": COLLIDER},  # it is an obstacle
        {"y": 12.0},  # it is not below
        {"height": 20.0, "y": -6.0},  # not flat
        {"x": 20.0},  # the ball reaches beyond it
    ],
)
def test_another_plate_is_not(tmp_path: Path, other: dict) -> None:
    assert notes(tmp_path / "a.usda", **other) == []


def test_a_sheet_moves_with_the_nearest_body(tmp_path: Path) -> None:
    sheet = """def Mesh "Plate"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-50, 4, 50), (50, 4, 50), (50, 4, -50), (-50, 4, -50)]
    }
}
"""
    head = SCENE[: SCENE.index("def Cube")]
    (tmp_path / "a.usda").write_text(head + sheet, encoding="utf-8")
    assert any(
        note.startswith("</World/Plate> is flat and lies under everything else, as a ground does,")
        and "but it moves with the nearest body: " in note
        for note in inspect(tmp_path / "a.usda", particles=300).notes
    )
