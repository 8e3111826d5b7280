"""Notes on stiff presets of which slender bodies fold in a fall."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_stages import mesh
from planned import planner

from gf_usd.core.materials.presets import find_preset
from gf_usd.core.units import rounded_text
from gf_usd.prepare.materials.checks import FOLDS, STIFF, FallingBody, folding_notes, stiff_in_fall
from gf_usd.prepare.plan import Plan

FOLDS_NOTE = " folds "


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


def long(x: float, y: float, z: float, name: str = "One", at: float = 0.0) -> str:
    """A box of these edges [m], its corner at a height of 0 and this z [m]."""
    return mesh(
        name,
        f"double3 xformOp:translate = (0, 0, {at})",
        f"double3 xformOp:scale = ({x}, {y}, {z})",
        'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]',
    )


def folding(made: Plan) -> list[str]:
    return [note for note in made.notes if FOLDS_NOTE in note]


def test_a_slender_body_of_metal_is_noted_with_a_preset_that_keeps_its_shape(plan) -> None:
    """Legs of a table of metal, which hardly bends, folded under it without a word."""
    made = plan(long(1.0, 0.08, 0.08), material="metal", drop="3r")
    (note,) = folding(made)
    fall, E = made.drop, made.variants[0].table[0].youngs_modulus
    angle = np.degrees(2.0 * np.sqrt(2.0 * 7800.0 * 9.81 * fall / E) * 1.0 / 0.08)
    assert f"bends it by about {rounded_text(float(angle))} degrees" in note
    assert "</One> of metal, which is 1 m long and mostly 8 cm thick" in note
    assert "; --material hard-rubber by 40 and --material mild-steel by 0.74" in note
    for firmer in ("hard-rubber", "mild-steel"):
        assert not folding(plan(long(1.0, 0.08, 0.08), material=firmer, drop="3r"))


@pytest.mark.parametrize(
    ("edges", "more"),
    [
        ((1.0, 1.0, 1.0), {"material": "metal"}),
        ((1.0, 0.05, 0.05), {"material": "rubber"}),  # it is meant to bend
        ((1.0, 0.05, 0.05), {"material": "dented"}),
        ((1.0, 0.05, 0.05), {"material": "metal", "floor": "none"}),
        ((1.0, 0.05, 0.05), {"material": "metal", "drop": "0"}),
        ((1.0, 0.05, 0.05), {"material": "metal", "pins": ("box:-1,-1,-1,0.2,1,1",)}),
    ],
)
def test_other_bodies_are_not_noted(
    plan, edges: tuple[float, float, float], more: dict[str, Any]
) -> None:
    assert not folding(plan(long(*edges), **more))


def test_each_body_is_judged_by_its_own_length_and_thickness(plan) -> None:
    """Plates beside a ball were taken as long as the ball."""
    cube, longer = long(0.3, 0.3, 0.3, "Cube", 5.0), long(2.0, 0.08, 0.08, "Longer", 10.0)
    made = plan(cube, long(1.0, 0.08, 0.08), longer, material="metal", drop="3r")
    (note,) = folding(made)
    assert " folds </Longer> of metal, which is 2 m long and mostly 8 cm thick: " in note
    assert not folding(plan(cube, long(0.6, 0.4, 0.4), material="metal"))


def bar(material: Any, length: float = 1.0, thick: float = 0.02) -> FallingBody:
    return FallingBody(path="/Bar", length=length, thick=thick, materials=[material])


def test_the_angle_is_that_of_the_energy_of_the_fall() -> None:
    metal, g, r = find_preset("metal").material(0.2), 9.81, 0.2
    fall, length = 3.0 * r, 1.0
    strain = np.sqrt(2.0 * metal.density * g * fall / metal.youngs_modulus)
    thick = 2.0 * strain * length / FOLDS
    assert folding_notes([bar(metal, thick=1.01 * thick)] * 2, fall, g) == ()
    assert len(folding_notes([bar(metal, thick=0.99 * thick)] * 2, fall, g)) == 1
    limit = fall * (STIFF / strain) ** 2
    assert stiff_in_fall(metal, 0.99 * limit, g)
    assert not stiff_in_fall(metal, 1.01 * limit, g)


def test_only_what_keeps_its_shape_is_advised() -> None:
    """The note ended in a semicolon, or advised what folds as well."""
    steel = find_preset("mild-steel").material(0.5)
    (note,) = folding_notes([bar(replace(steel, law="neoHookean"), 3.0, 0.0005)], 10.0, 9.81)
    assert note.endswith(" degrees")
    (note,) = folding_notes([bar(find_preset("metal").material(0.5), 1.0, 0.01)], 1.0, 9.81)
    assert re.search(r"by more than 180 degrees; --material mild-steel by \d\S*$", note)
