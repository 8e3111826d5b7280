"""A mesh that looks like the ground of a scene is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from gf_usd import inspect
from gf_usd.pipeline.inspect import Inspection
from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.bodies.grounds import SCENERY, WALL

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


@pytest.mark.slow
def test_a_plate_under_everything_is_named(tmp_path: Path) -> None:
    (note,) = notes(tmp_path / "a.usda")
    assert note == (
        "</World/Plate> is flat and lies under everything else, as a ground does, but it is soft"
        " and falls: apply PhysicsCollisionAPI to it to make it an obstacle, or bake the others"
        " alone (prims) on a floor at its height (floor=4)"
    )


@pytest.mark.slow
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


def with_sheet(path: Path, size: float = 100.0, y: float = 4.0, wall: float = 0.0) -> Inspection:
    """The ball over a sheet, of which one end goes up by `wall`."""
    sheet = """def Mesh "Plate"
    {
        int[] faceVertexCounts = [4, 4]
        int[] faceVertexIndices = [0, 1, 2, 3, 3, 2, 4, 5]
        point3f[] points = [(-SIZE, Y, SIZE), (SIZE, Y, SIZE), (SIZE, Y, -SIZE), (-SIZE, Y, -SIZE),
            (SIZE, TOP, -SIZE), (-SIZE, TOP, -SIZE)]
    }
}
"""
    for name, value in (("SIZE", size / 2.0), ("TOP", y + wall), ("Y", y)):
        sheet = sheet.replace(name, f"{value:g}")
    path.write_text(SCENE[: SCENE.index("def Cube")] + sheet, encoding="utf-8")
    return inspect(path, particles=300)


@pytest.mark.parametrize("wall", [0.0, 60.0], ids=["ground", "backdrop"])
def test_a_sheet_that_reaches_far_beyond_the_bodies_stays(tmp_path: Path, wall: float) -> None:
    """A backdrop of 2 m went up and down with a ball of 20 cm, and folded."""
    seen = with_sheet(tmp_path / "a.usda", 200.0, wall=wall)
    assert seen.fill_of("/World/Plate") == ("stays", SCENERY)
    assert [mesh["fill"] for mesh in seen.as_json()["meshes"]] == ["filled", "stays"]
    assert seen.plan is not None
    assert [s.path for s in seen.plan.asset.surfaces] == ["/World/Ball"]
    floor, note = (note for note in seen.notes if "/World/Plate" in note)
    assert floor.endswith("</World/Plate> is at a height of 4: floor=4 puts the floor there")
    assert note.startswith("</World/Plate> is not baked: it encloses no volume, lies under the")
    assert note.endswith("does not follow what is baked: apply PhysicsCollisionAPI to make it an"
                         " obstacle")  # fmt: skip


@pytest.mark.parametrize(
    ("size", "y", "wall", "flat"),
    [
        (40.0, 4.0, 0.0, True),  # a saucer
        (200.0, 24.0, 0.0, False),  # on top of it
        (200.0, 14.0, 60.0, False),  # through its middle
    ],
)
def test_another_sheet_moves_with_the_nearest_body(
    tmp_path: Path, size: float, y: float, wall: float, flat: bool
) -> None:
    seen = with_sheet(tmp_path / "a.usda", size, y, wall)
    assert seen.fill_of("/World/Plate")[0] == "rides along"
    grounds = [note for note in seen.notes if "as a ground does" in note]
    assert len(grounds) == flat
    assert all("but it moves with the nearest body: " in note for note in grounds)


@pytest.mark.slow
@pytest.mark.parametrize(("y", "options"), [(0.5, {}), (4.0, {"floor": 4.0})])
def test_scenery_at_the_floor_has_no_note_on_it(tmp_path: Path, y: float, options: dict) -> None:
    path = tmp_path / "a.usda"
    with_sheet(path, 200.0, y)
    notes = inspect(path, particles=300, **options).notes
    assert [note for note in notes if "puts the floor there" in note] == []


@pytest.mark.slow
def test_it_stays_at_a_coarser_resolution_too(tmp_path: Path) -> None:
    """In the coarse runs of --certify it followed the nearest body."""
    path = tmp_path / "a.usda"
    with_sheet(path, 200.0)
    prepared = prepare(path, particles=4096, certify=True, output=tmp_path / "b.usda")
    assert prepared.refill is not None
    coarse = prepared.refill(2.0 * prepared.plan.particles.spacing)
    assert [s.path for s in coarse.asset.surfaces] == ["/World/Ball"]


WALL_MESH = """def Mesh "Plate"
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [({x}, 0, {z}), ({x}, {height}, {z}), ({x}, {height}, -{z}),
            ({x}, 0, -{z})]
    }}
}}
"""


def with_wall(path: Path, x: float, *, size: float = 200.0) -> Inspection:
    """The ball, from 4 to 24 cm high and from x = -5 to 15 cm, next to a wall."""
    wall = WALL_MESH.format(x=x, z=0.5 * size, height=size)
    path.write_text(SCENE[: SCENE.index("def Cube")] + wall, encoding="utf-8")
    return inspect(path, particles=300)


@pytest.mark.parametrize("x", [-30.0, 15.0], ids=["behind", "touching"])
def test_a_wall_far_larger_than_the_bodies_stays(tmp_path: Path, x: float) -> None:
    """A wall of 8 m behind a table was folded and thrown about by it."""
    seen = with_wall(tmp_path / "a.usda", x)
    assert seen.fill_of("/World/Plate") == ("stays", WALL)
    (note,) = (note for note in seen.notes if "/World/Plate" in note)
    assert note.endswith("apply PhysicsCollisionAPI to make it an obstacle")


@pytest.mark.parametrize(("x", "size"), [(5.0, 200.0), (-30.0, 40.0)], ids=["through", "small"])
def test_another_wall_moves_with_the_body(tmp_path: Path, x: float, size: float) -> None:
    assert with_wall(tmp_path / "a.usda", x, size=size).fill_of("/World/Plate")[0] == "rides along"
