"""Pins by a painted weight, and by the joint that points follow; the floor under what they hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_stages import mesh
from planned import planner

import gf_usd
from gf_usd.core.errors import InputError
from gf_usd.core.units import length_text
from gf_usd.prepare.plan import Plan

SAMPLES = Path(__file__).parents[2] / "samples"
# A cube of a meter: the weight is on the four points of one end along x.
PAINTED = """
    float[] primvars:held = [0, 1, 0, 1, 0, 1, 0, 1] (
        interpolation = "vertex"
    )
"""


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


def test_the_faces_with_a_painted_weight_are_held(plan) -> None:
    made = plan(mesh("One", PAINTED), pins=("paint:held",))
    (pin,) = made.pins
    high = made.particles.X.max()
    assert pin.name == "paint:held"
    assert {round(float(x), 6) for x in pin.anchors[:, 0]} == {
        round(float(made.asset.surfaces[0].points[:, 0].max()), 6)
    }
    outside = np.array([[2.0 * high, 0.5, 0.5], [-1.0 * high, 0.5, 0.5]])
    assert pin.inside(outside).tolist() == [True, False], "beyond the painted end alone"


def test_a_map_of_whole_numbers_is_a_weight_too(plan) -> None:
    """As of a group of Houdini; a misspelled one is found among its kind."""
    whole = PAINTED.replace("float[]", "int[]")
    first, again = (plan(mesh("One", text), pins=("paint:held",)) for text in (PAINTED, whole))
    assert np.array_equal(first.pins[0].anchors, again.pins[0].anchors)
    with pytest.raises(InputError) as caught:
        plan(mesh("One", whole), pins=("paint:heeld",))
    assert caught.value.hint == "did you mean paint:held?"


@pytest.mark.parametrize(
    ("options", "floor"),
    [({}, None), ({"floor": 0}, 0.0), ({"floor": -1.5}, -1.5), ({"drop": 1.0}, 0.0)],
)
def test_the_default_floor_does_not_cut_through_what_is_pinned(
    options: dict[str, Any], floor: float | None
) -> None:
    """A ball about the origin that was held in a floor at height 0 blew up."""
    top = ((-1, 0.6, -1), (1, 1, 1))
    seen = gf_usd.inspect(SAMPLES / "sphere.usda", pins=[top], particles=300, **options)
    assert seen.plan is not None
    assert seen.plan.settings.floor == floor
    note = "the pinned asset reaches 1 m below height 0, so there is no floor; floor adds one"
    assert (note in seen.plan.notes) == (floor is None)


@pytest.mark.parametrize(("floor", "told"), [(0, True), (-0.5, True), (-0.95, False), (-1, False)])
def test_a_floor_that_cuts_through_what_is_held_is_reported_with_one_that_does_not(
    floor: float, told: bool
) -> None:
    """It ended at the first frame: all nodes of the grid were no longer finite."""
    top = ((-1, 0.6, -1), (1, 1, 1))
    seen = gf_usd.inspect(SAMPLES / "sphere.usda", pins=[top], particles=300, floor=floor)
    assert seen.plan is not None
    depth, spacing = floor + 1.0, seen.plan.particles.spacing
    note = (
        f"the asset begins {length_text(depth)} ({depth / spacing:.2g} spacings) below the floor,"
        " which pushes it out at once: lower floor to -1, or leave it out"
    )
    assert (note in seen.plan.notes) == told


def test_other_bodies_keep_the_floor_that_a_pinned_one_reaches_through(tmp_path: Path) -> None:
    """They fell without limit next to it."""
    path, sphere = tmp_path / "two.usda", SAMPLES / "sphere.usda"
    place = 'uniform token[] xformOpOrder = ["xformOp:translate"]\ndouble3 xformOp:translate'
    bodies = "".join(
        f'def "B{k}" (\nreferences = @{sphere}@\n)\n{{\n{place} = ({3 * k}, {y}, 0)\n}}\n'
        for k, y in enumerate((0.5, 2.0))
    )
    path.write_text(f'#usda 1.0\n(\nmetersPerUnit = 1\nupAxis = "Y"\n)\n{bodies}', "utf-8")
    seen = gf_usd.inspect(path, pins=[((-1, 1.1, -1), (1, 1.6, 1))], particles=400)
    assert seen.plan is not None
    assert seen.plan.settings.floor == 0.0


NONE = "1 mesh has no primvar of numbers named"


@pytest.mark.parametrize(
    ("written", "pin", "message", "hint"),
    [
        (PAINTED, "paint:heeld", f"{NONE} heeld on its points", "did you mean paint:held?"),
        ("", "paint:held", f"{NONE} held on its points", "interpolation vertex"),
        (
            PAINTED.replace("vertex", "uniform").replace(", 0, 1]", "]"),
            "paint:held",
            "</One> has held as float[] with the interpolation uniform",
            "interpolation vertex",
        ),
        (
            PAINTED.replace("1,", "0.25,").replace("1]", "0.4]"),
            "paint:held",
            "no face of 1 mesh has a weight of at least 0.5 at each of its points: the largest"
            " weight is 0.4",
            "paint",
        ),
        (
            PAINTED.replace("1,", "nan,"),
            "paint:held",
            "3 weights of </One> are not finite",
            "paint finite weights",
        ),
        (
            PAINTED + PAINTED.replace("held", "heldB").replace("vertex", "uniform").replace(
                ", 0, 1]", "]"
            ),
            "paint:heldB",
            "</One> has heldB as float[] with the interpolation uniform",
            "interpolation vertex",
        ),
        (
            PAINTED.replace("float[]", "string[]").replace("0,", '"a",').replace("1,", '"b",')
            .replace("1]", '"b"]'),
            "paint:held",
            "</One> has held as string[] with the interpolation vertex",
            "as a float or int primvar",
        ),
        (PAINTED, "paint:", "no primvar is named", "primvars on points are held"),
        ("", "paint: ", "no primvar is named", "such as paint:held"),
        ("", "joint:", "no joint is named", "no mesh has joints"),
        ("", "joint:hips", "1 mesh has no weights of a joint hips", "no mesh has joints"),
    ],
)  # fmt: skip
def test_a_weight_that_nobody_has_is_refused(
    plan, written: str, pin: str, message: str, hint: str
) -> None:
    with pytest.raises(InputError) as caught:
        plan(mesh("One", written), pins=(pin,))
    assert f"--pin {pin}: {message}" in caught.value.message
    assert hint in caught.value.hint


def test_an_empty_pin_is_refused(plan) -> None:
    """Of a variable of a script that is not set."""
    with pytest.raises(InputError, match="the path of a prim is empty") as caught:
        plan(mesh("One"), pins=("",))
    assert "contains /One" in caught.value.hint


@pytest.mark.slow
def test_the_faces_that_follow_a_joint_are_held(tmp_path: Path) -> None:
    from gf_usd.pipeline.prepared import prepare

    creature = Path(__file__).parents[2] / "samples" / "creature.usda"
    options = {"particles": 300, "frames": 3, "output": tmp_path / "out.usda"}
    made = prepare(creature, pins=("joint:Head",), **options).plan
    (pin,) = made.pins
    surface = made.asset.surfaces[0].points
    assert 0 < len(pin.anchors) < len(surface) / 2
    with pytest.raises(InputError) as caught:
        prepare(creature, pins=("joint:wing",), **options)
    assert "has no weights of a joint wing" in caught.value.message
    assert "joints are " in caught.value.hint
    assert "Head" in caught.value.hint
    with pytest.raises(InputError) as caught:
        prepare(creature, pins=("joint:head",), **options)
    assert caught.value.hint == "did you mean joint:Head?"
