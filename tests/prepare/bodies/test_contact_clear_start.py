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
