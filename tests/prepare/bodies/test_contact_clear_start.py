"""Bodies that are lifted or lowered to their height are not put into obstacles."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from physics_stages import mesh
from planned import noted, planner

from gf_usd.core.errors import InputError
from gf_usd.prepare.plan import Plan

# a wall of 2 x 1 x 2 around the place under a cube at a height of 3
WALL = """
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0,2,3,1, 4,5,7,6, 0,1,5,4, 2,6,7,3, 0,4,6,2, 1,3,7,5]
    point3f[] points = [
        (-1,0,-1), (2,0,-1), (-1,1.5,-1), (2,1.5,-1), (-1,0,2), (2,0,2), (-1,1.5,2), (2,1.5,2)
    ]
"""
ABOVE = """
    double3 xformOp:translate = (0, 3, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
"""


def obstacle() -> str:
    return (
        'def Mesh "Block" (\nprepend apiSchemas = ["PhysicsCollisionAPI"]\n)\n{\n' + WALL + "\n}\n"
    )


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


def test_a_body_that_is_lowered_into_an_obstacle_is_refused_with_its_name(plan) -> None:
    stage = mesh("One", ABOVE) + obstacle()
    with pytest.raises(InputError, match="start inside the obstacle </Block>") as refused:
        plan(stage, floor="0", drop="0")
    assert "--drop" in refused.value.hint


@pytest.mark.parametrize("more", [{}, {"floor": "0", "drop": "3"}, {"floor": "0", "drop": "1.5"}])
def test_one_that_clears_it_is_not(plan, more: dict[str, Any]) -> None:
    assert plan(mesh("One", ABOVE) + obstacle(), **more).contact_setup.colliders


def test_what_stands_in_an_obstacle_from_the_start_is_left_there(plan) -> None:
    inside = ABOVE.replace("(0, 3, 0)", "(0, 0.25, 0)")
    assert plan(mesh("One", inside) + obstacle(), floor="0", drop="0.2").settings.lift[1] < 0.0


def test_the_note_on_what_starts_in_an_obstacle_names_a_drop_that_clears_it(plan) -> None:
    stage = mesh("One", ABOVE.replace("(0, 3, 0)", "(0, 1.25, 0)")) + obstacle()
    seen = plan(stage)
    (note,) = (note for note in seen.notes if "inside the obstacle </Block>" in note)
    found = re.search(r"or use --drop ([\d.]+) to start above it$", note)
    assert found, note
    above = plan(stage, drop=found[1])
    assert above.settings.lift[1] == float(found[1])
    assert not noted(above, "inside the obstacle")
    assert float(found[1]) < 2.0, "as little as clears it"
    floor = plan(stage, floor="-5", drop="6.25")
    assert noted(floor, "inside the obstacle </Block>")
    assert not noted(floor, "or use --drop"), "with a floor, the drop is from there"


def bodies_below(count: int) -> str:
    """A plane at a height of 0.5 and cubes: the first is half below it, and all others whole."""
    at = (
        "double3 xformOp:translate = ({}, {}, 0)\n"
        'uniform token[] xformOpOrder = ["xformOp:translate"]'
    )
    ground = (
        'def Plane "Ground" (\nprepend apiSchemas = ["PhysicsCollisionAPI"]\n)\n{\n'
        f'uniform token axis = "Y"\n{at.format(0, 0.5)}\n}}\n'
    )
    cubes = [mesh(f"B{k}", at.format(3 * k, 0 if k == 0 else -3)) for k in range(count)]
    return "".join(cubes) + ground


def test_bodies_in_one_obstacle_share_a_note(plan) -> None:
    """A robot at the origin of a stage with a ground had a line for each of its limbs."""
    seen = plan(bodies_below(5), particles=2000)
    (note,) = (note for note in seen.notes if "inside the obstacle" in note)
    assert note.startswith("</B0> starts with ")
    assert "inside the obstacle </Ground> and keeps this overlap" in note
    assert "and so do 4 more bodies; move them apart in the asset, or use --drop" in note
    few = plan(bodies_below(2), particles=2000)
    assert sum("inside the obstacle" in note for note in few.notes) == 2


def test_a_drop_lifts_all_bodies_above_a_plane(plan) -> None:
    """A plane is no room, whatever is behind it."""
    seen = plan(bodies_below(2), particles=2000)
    notes = [note for note in seen.notes if "inside the obstacle" in note]
    assert not any("room" in note for note in notes)
    found = re.search(r"or use --drop ([\d.]+) to start above it$", notes[0])
    assert found, notes[0]
    assert 3.5 < float(found[1]) < 4.0, "the lowest is 3.5 below it"
    assert not noted(plan(bodies_below(2), particles=2000, drop=found[1]), "inside the obstacle")
