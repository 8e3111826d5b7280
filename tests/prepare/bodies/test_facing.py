"""Obstacles whose winding is reversed with respect to the bodies are turned, rooms are not."""

from __future__ import annotations

import pytest
from physics_stages import mesh, prim, volume
from planned import at, noted, plan_fixture  # noqa: F401

COLLISION = ("PhysicsCollisionAPI",)
INWARD = 'uniform token orientation = "leftHanded"'
ROOM = (
    "double3 xformOp:translate = (-1, -1, -1)",
    "double3 xformOp:scale = (3, 3, 3)",
    'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]',
)
BODY = mesh("Body")  # of the corners (0, 0, 0) and (1, 1, 1)


def ground(height: float, *lines: str) -> str:
    """/Ground, a sheet that faces up."""
    return prim(
        "Mesh",
        "Ground",
        "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]",
        f"point3f[] points = [(-3,{height},-3), (-3,{height},3), (3,{height},3), (3,{height},-3)]",
        *lines,
        apis=COLLISION,
    )


def up(seen) -> bool:
    """Whether the faces of the only obstacle point up."""
    (one,) = seen.contact_setup.colliders
    a, b, c = one.positions(0)[one.triangles[0]]
    return bool((c[0] - a[0]) * (b[2] - a[2]) > (b[0] - a[0]) * (c[2] - a[2]))


def test_a_closed_obstacle_that_faces_inward_is_reversed(plan) -> None:
    seen = plan(BODY, mesh("Block", at(0.0, -2.0), INWARD, apis=COLLISION))
    (block,) = seen.contact_setup.colliders
    assert volume(block) == pytest.approx(1.0)
    assert noted(seen, "the faces of the obstacle </Block> point inward, and no body is in it")


def test_one_that_a_body_touches_from_outside_is_too(plan) -> None:
    """A tenth of the body is in its wall."""
    seen = plan(BODY, mesh("Block", at(0.9), INWARD, apis=COLLISION))
    assert volume(seen.contact_setup.colliders[0]) == pytest.approx(1.0)


def test_a_room_around_a_body_is_left(plan) -> None:
    seen = plan(BODY, mesh("Room", *ROOM, INWARD, apis=COLLISION))
    assert volume(seen.contact_setup.colliders[0]) == pytest.approx(-27.0)
    assert not noted(seen, "</Room> point inward")
    assert not noted(seen, "inside the obstacle"), "it is in front of all faces"


def test_a_room_that_faces_outward_is_named(plan) -> None:
    seen = plan(BODY, mesh("Room", *ROOM, apis=COLLISION))
    assert volume(seen.contact_setup.colliders[0]) == pytest.approx(27.0)
    assert noted(seen, "reverse the faces of the obstacle if it is a room around the body")


def test_what_faces_the_bodies_is_left(plan) -> None:
    seen = plan(BODY, mesh("Block", at(0.0, -2.0), apis=COLLISION))
    assert volume(seen.contact_setup.colliders[0]) == pytest.approx(1.0)
    seen = plan(BODY, ground(-0.5))
    assert up(seen)
    assert not noted(seen, "reversed")


def test_a_sheet_with_all_bodies_behind_it_is_reversed(plan) -> None:
    seen = plan(BODY, ground(-0.5, INWARD))
    assert up(seen)
    assert noted(seen, "</Ground> is an open surface whose faces point away from all bodies")


def test_a_sheet_between_bodies_is_left(plan) -> None:
    above = mesh("Above", at(0.0, 3.0))
    seen = plan(BODY, above, ground(2.0, INWARD))
    assert not up(seen)
    assert not noted(seen, "reversed")


def test_bodies_that_pass_through_it_do_not_count(plan) -> None:
    filtered = "rel physics:filteredPairs = [</Ground>]"
    above = mesh("Above", at(0.0, 3.0), filtered, apis=["PhysicsFilteredPairsAPI"])
    seen = plan(BODY, above, ground(2.0))
    assert not up(seen), "it faced the one above, and now the one below"
