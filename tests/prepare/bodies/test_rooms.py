"""A closed mesh that faces inward around everything else stays, as a room or a sky does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from solids import asset, cube, sphere, surface

from gf_usd import inspect
from gf_usd.core.asset import Surface
from gf_usd.prepare.bodies.grounds import ROOM, SCENERY, without_room_parts, without_rooms

# the floor of the room is at the height 0
STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{
    def Mesh "Room" %s
    {
        uniform token orientation = "leftHanded"
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5,
            7, 3]
        point3f[] points = [(-25, 0, -25), (-25, 0, 25), (-25, 3, -25), (-25, 3, 25), (25, 0, -25),
            (25, 0, 25), (25, 3, -25), (25, 3, 25)]
    }
    def Sphere "Ball"
    {
        double radius = 0.3
        double3 xformOp:translate = (0, 0.8, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""


def inward(one: Surface) -> Surface:
    return replace(one, triangles=one.triangles[:, ::-1])


def stay(*surfaces: Surface, repair: bool = False, bodies: tuple[str, ...] = ()) -> list[str]:
    """Paths of the surfaces that stay."""
    left = without_rooms(asset(*surfaces), repair=repair, bodies=bodies)
    assert all(reason == ROOM for _, reason in left.skipped)
    paths = [path for path, _ in left.skipped]
    assert [s.path for s in left.surfaces] == [s.path for s in surfaces if s.path not in paths]
    return paths


BALL = sphere(0.3, (0.0, 1.0, 0.0), path="/Ball")
ROOM_WALLS = inward(cube((-2.0, 0.0, -2.0), (4.0, 3.0, 4.0), path="/Room"))
SKY = inward(sphere(50.0, path="/Sky"))
SHEET = surface(
    0.5 * BALL.points[:3] + (0.0, 1.5, 0.0), np.array([[0, 1, 2]]), path="/Sheet"
)  # open


def test_a_room_and_a_sky_stay() -> None:
    chair = cube((1.0, 0.0, 0.0), 0.5, path="/Chair")
    assert stay(BALL, ROOM_WALLS, chair) == ["/Room"]
    assert stay(BALL, SKY, ROOM_WALLS, chair) == ["/Sky", "/Room"]


def test_a_picture_in_the_wall_may_reach_into_it() -> None:
    picture = cube((-2.01, 1.0, 0.0), (0.04, 1.0, 1.0), path="/Picture")
    outside = cube((-2.3, 1.0, 0.0), (0.04, 1.0, 1.0), path="/Sign")
    assert stay(BALL, ROOM_WALLS, picture) == ["/Room"]
    assert stay(BALL, ROOM_WALLS, outside) == []


@pytest.mark.parametrize("repair", [False, True])
def test_what_is_inside_out_by_mistake_is_filled(repair: bool) -> None:
    shell, yolk = sphere(1.0, path="/Shell"), sphere(0.4, path="/Yolk")
    large = sphere(0.85, path="/White")
    for surfaces in [(inward(yolk),), (inward(shell), inward(yolk)), (inward(shell), large)]:
        assert stay(*surfaces, repair=repair) == []


def test_a_body_with_limbs_that_is_inside_out_is_filled() -> None:
    """Its eye faces outward in it."""
    away = sphere(1.0, path="/Jack")
    far = np.abs(away.points).max(1, keepdims=True) ** 16
    jack = inward(replace(away, points=away.points * (0.3 + 0.7 * far)))
    eye = sphere(0.1, path="/Eye")
    assert stay(jack, eye) == []
    assert stay(inward(away), eye) == ["/Jack"]


def test_a_case_that_faces_outward_is_filled() -> None:
    assert stay(BALL, inward(ROOM_WALLS), inward(SKY)) == []


def test_a_room_in_several_meshes_stays() -> None:
    """Its walls, floor and ceiling enclose a volume together, which was filled."""
    whole = sorted(range(12), key=lambda k: ROOM_WALLS.points[ROOM_WALLS.triangles[k]].mean(0)[1])
    parts = [
        replace(
            ROOM_WALLS, path=f"/Room/{name}", triangles=ROOM_WALLS.triangles[rows],
            triangle_corners=ROOM_WALLS.triangle_corners[rows],
        )
        for name, rows in (("Floor", whole[:2]), ("Walls", whole[2:10]), ("Ceiling", whole[10:]))
    ]  # fmt: skip
    made = asset(BALL, *parts)
    left = without_room_parts(made, repair=False)
    assert [s.path for s in left.surfaces] == ["/Ball"]
    assert {path for path, _ in left.skipped} == {part.path for part in parts}
    outward = asset(BALL, *(inward(part) for part in parts))
    assert without_room_parts(outward, repair=False) is outward


def test_a_physics_body_is_baked() -> None:
    assert stay(BALL, ROOM_WALLS, bodies=("/Room",)) == []


def test_a_room_with_nothing_else_to_fill_is_baked() -> None:
    assert stay(SHEET, ROOM_WALLS) == []
    assert stay(SHEET, ROOM_WALLS, repair=True) == ["/Room"]


@pytest.mark.parametrize("repair", [False, True])
def test_the_room_of_a_stage_is_noted_and_not_filled(tmp_path: Path, repair: bool) -> None:
    """It was a body of 7500 m^3 with the ball in it."""
    path = tmp_path / "room.usda"
    path.write_text(STAGE % "", encoding="utf-8")
    seen = inspect(path, particles=300, repair=repair)
    assert [one.path for one in seen.repairs] == (["/World/Ball"] if repair else [])
    assert seen.fill_of("/World/Room") == ("stays", ROOM)
    assert seen.plan is not None
    assert seen.plan.particles.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.3**3, rel=0.05)
    (note,) = (note for note in seen.notes if "/World/Room" in note)
    assert note.startswith("</World/Room> is not baked: it faces inward around all other meshes")
    assert "collide with the floor of the bake, not with it: apply PhysicsCollisionAPI" in note
    assert seen.warnings == ()  # none on a width of 50 m


@pytest.mark.slow
def test_a_physics_body_of_a_stage_is_no_room(tmp_path: Path) -> None:
    path = tmp_path / "room.usda"
    path.write_text(STAGE % '(prepend apiSchemas = ["PhysicsRigidBodyAPI"])', encoding="utf-8")
    assert inspect(path, particles=300).fill_of("/World/Room")[0] == "filled"


def test_the_ground_under_a_sky_stays_too(tmp_path: Path) -> None:
    ground = """    def Mesh "Ground"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-40, 0, 40), (40, 0, 40), (40, 0, -40), (-40, 0, -40)]
    }
"""
    path = tmp_path / "sky.usda"
    text = STAGE % ""
    path.write_text(text[: text.rindex("}")] + ground + "}\n", encoding="utf-8")
    seen = inspect(path, particles=300)
    assert [seen.fill_of(f"/World/{name}") for name in ("Room", "Ground", "Ball")] == [
        ("stays", ROOM),
        ("stays", SCENERY),
        ("filled", ""),
    ]
