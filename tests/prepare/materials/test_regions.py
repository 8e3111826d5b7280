"""Presets for what rests in boxes."""

from __future__ import annotations

import numpy as np
import pytest
from physics_stages import mesh
from planned import at, noted, plan_fixture, table  # noqa: F401

from gf_usd.core.errors import InputError, UsageError
from gf_usd.prepare.options.request import Request

HALF = "metal:-1,-1,-1,0.5,2,2"  # of the cube 0..1


def names(seen) -> np.ndarray:
    return np.array([m.name for m in table(seen)])[seen.particles.material]


@pytest.mark.slow
def test_what_rests_in_a_box_has_its_preset(plan) -> None:
    seen = plan(mesh("One"), material="jelly", particles=400, material_boxes=(HALF,))
    metal = seen.particles.X[:, 0] <= 0.5
    assert np.array_equal(names(seen), np.where(metal, "metal", "jelly"))
    assert [m.name for m in seen.materials] == ["jelly"]
    assert noted(seen, f"{metal.sum()} of {len(metal)} particles are metal, by --material-box")
    assert f"--material-box {HALF}" in seen.command


def test_a_box_goes_through_several_bodies_and_the_later_box_holds(plan) -> None:
    wide, top = "metal:-1,-1,-1,9,0.7,9", "foam:-1,0.5,-1,9,9,9"
    seen = plan(mesh("One"), mesh("Two", at(3.0)), particles=800, material_boxes=(wide, top))
    assert np.array_equal(names(seen), np.where(seen.particles.X[:, 1] >= 0.5, "foam", "metal"))
    assert seen.bodies.count == 2


def test_boxes_are_in_stage_units(plan, tmp_path) -> None:
    box = "metal:-1,-1,-1,0.5,2,2"
    seen = plan(mesh("One"), particles=400, material_boxes=(box,), meters_per_unit=0.01)
    assert np.array_equal(names(seen) == "metal", seen.particles.X[:, 0] <= 0.005)


def test_a_box_that_holds_nothing_is_refused(plan) -> None:
    with pytest.raises(InputError, match=r"contains none of the \d+ particles, which are between"):
        plan(mesh("One"), particles=200, material_boxes=("metal:5,5,5,6,6,6",))
    inner = "metal:0.2,0.2,0.2,0.8,0.8,0.8"
    with pytest.raises(InputError, match="later boxes override it for all"):
        plan(mesh("One"), particles=200, material_boxes=(inner, "foam:-1,-1,-1,2,2,2"))


@pytest.mark.parametrize(
    ("box", "message"),
    [
        ("metal:0,0,0,1,1", "is not a preset and a box"),
        ("0,0,0,1,1,1", "is not a preset and a box"),
        ("metal:0,0,0,1,1,nan", "is not a preset and a box"),
        ("metal:0,0,0,1,0,1", "has no volume"),
        ("butter:0,0,0,1,1,1", "butter"),
    ],
)
def test_what_is_no_box_is_refused_before_anything_is_read(box: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Request(material_boxes=(box,)).check()


def test_boxes_and_blending_are_refused_together() -> None:
    with pytest.raises(UsageError, match=r"--blend-width 0\.1 and --material-box"):
        Request(material_boxes=(HALF,), blend_width=0.1).check()
