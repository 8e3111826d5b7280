"""Yield stresses in stages: which law, what is refused, and what is painted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_stages import bound, mesh, prim
from planned import SOFT, at, planner, table

from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.materials.per_particle import spread
from gf_usd.prepare.plan import Plan

BINDING = ("MaterialBindingAPI",)
PAINTED = """
    float[] primvars:gaussianFlesh:yieldStress = [1000, 3000, 1000, 3000, 1000, 3000, 1000, 3000] (
        interpolation = "vertex"
    )
"""  # from x = 0 to x = 1


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


def material(*lines: str) -> str:
    return prim("Material", "Stuff", *lines, apis=["PhysicsMaterialAPI"])


def about_yield(made: Plan) -> list[str]:
    return [note for note in made.notes if "yield stress" in note]


@pytest.mark.parametrize("law", ["vonMises", "crushable"])
@pytest.mark.parametrize("options", [{}, {"material": "rubber"}, {"material": "silicone"}])
def test_a_law_that_flows_needs_a_yield_stress(plan, law: str, options: dict[str, Any]) -> None:
    with pytest.raises(InputError) as caught:
        plan(mesh("One"), law=law, **options)
    name = options.get("material", "rubber")
    assert f"asset.usda: </One>: the law {law} needs a yield stress, and {name}" in str(
        caught.value.message
    )
    assert "gaussianFlesh:yieldStress" in caught.value.hint


def test_a_law_of_the_stage_needs_one_too(plan) -> None:
    law = 'uniform token gaussianFlesh:law = "vonMises"'
    with pytest.raises(InputError, match="</One>: the law vonMises needs a yield stress"):
        plan(mesh("One", bound("/Stuff"), apis=BINDING) + material(SOFT, law))


def test_a_preset_that_flows_keeps_its_own_under_another_law(plan) -> None:
    (made,) = table(plan(mesh("One"), material="clay", law="crushable"))
    assert made.law == "crushable"
    assert made.parameters["yield_stress"] > 0.0


def test_a_yield_stress_of_the_stage_chooses_the_law(plan) -> None:
    stage = mesh("One", bound("/Stuff"), apis=BINDING)
    made = plan(stage + material(SOFT, "float gaussianFlesh:yieldStress = 5e3"))
    (one,) = table(made)
    assert (one.law, one.parameters) == ("vonMises", {"yield_stress": 5e3})
    assert about_yield(made) == ["</Stuff>: a yield stress is stated but no law: vonMises is used"]


def test_newtons_yield_stress_does_so_too(plan) -> None:
    stage = mesh("One", bound("/Stuff"), apis=BINDING)
    stiff = "float newton:mpm:youngsModulus = 2e5"
    made = plan(
        stage + material(stiff, "float newton:mpm:yieldStress = 1e3",
                         "float newton:mpm:tensileYieldRatio = 0.4")
    )  # fmt: skip
    (one,) = table(made)
    assert one.law == "vonMises"
    assert one.parameters == {"yield_stress": pytest.approx(3**0.5 * 1e3)}
    notes = "\n".join(about_yield(made))
    assert "no law: vonMises" in notes
    assert "</Stuff>: the yield stress is read from the attributes of Newton" in notes
    assert "tensileYieldRatio" in notes


def test_without_a_modulus_it_goes_over_the_preset(plan) -> None:
    stage = mesh("One", bound("/Stuff"), apis=BINDING)
    made = plan(stage + material("float gaussianFlesh:yieldStress = 5e3"))
    (one,) = table(made)
    assert (one.law, one.name) == ("vonMises", "rubber")
    made = plan(
        mesh("One", bound("/Stuff"), 'token gaussianFlesh:material = "styrofoam"', apis=BINDING)
        + material("float gaussianFlesh:yieldStress = 5e3")
    )
    assert table(made)[0].law == "crushable"


@pytest.mark.parametrize("by", ["stage", "command"])
def test_a_law_that_does_not_flow_leaves_it_unused_and_says_so(plan, by: str) -> None:
    authored = 'uniform token gaussianFlesh:law = "neoHookean"' if by == "stage" else ""
    options = {"law": "neoHookean"} if by == "command" else {}
    made = plan(
        mesh("One", bound("/Stuff"), apis=BINDING)
        + material(SOFT, authored, "float gaussianFlesh:yieldStress = 5e3"),
        **options,
    )
    assert table(made)[0].law == "neoHookean"
    (note,) = about_yield(made)
    assert "</One>: the yield stress is not used" in note


def test_a_painted_yield_stress_chooses_the_law_and_reaches_the_particles(plan) -> None:
    made = plan(mesh("One", PAINTED), particles=600)
    (one,) = table(made)
    assert one.law == "vonMises"
    assert about_yield(made) == ["</One>: a yield stress is painted: the law is vonMises"]
    values = spread(made.particles, table(made))["yield_stress"]
    assert (values.min(), values.max()) == (pytest.approx(1000.0), pytest.approx(3000.0))
    x = made.particles.X[:, 0]
    near = np.abs(made.particles.X[:, 1:] - 0.5).max(1) < np.abs(x - 0.5)  # of the faces x = 0, 1
    assert near.any()
    expected = np.where(x[near] < 0.5, 1000.0, 3000.0)
    assert values[near] == pytest.approx(expected)


def test_paint_on_one_of_two_bodies_is_not_enough_for_the_other(plan) -> None:
    other = mesh("Two", at(3.0))
    with pytest.raises(InputError, match="</Two>: the law vonMises needs a yield stress"):
        plan(mesh("One", PAINTED) + other, law="vonMises")


def test_a_material_file_says_what_was_chosen(plan, tmp_path: Path) -> None:
    file = tmp_path / "stuff.usda"
    file.write_text(
        "#usda 1.0\n(\nmetersPerUnit = 1\n)\n"
        + material(SOFT, "float gaussianFlesh:yieldStress = 5e3")
    )
    made = plan(mesh("One"), material=str(file))
    assert table(made)[0].law == "vonMises"
    (note,) = about_yield(made)
    assert note.endswith("</Stuff>: a yield stress is stated but no law: vonMises is used")


def test_mass_scaling_divides_the_moduli_of_what_flows_alone(plan) -> None:
    stage = mesh("One", 'token gaussianFlesh:material = "lead"') + mesh("Two", at(3.0))
    plain, scaled = (table(plan(stage, mass_scaling=f)) for f in (None, 16.0))
    for a, b in zip(plain, scaled):
        assert b.youngs_modulus == pytest.approx(
            a.youngs_modulus / (16.0 if a.name == "lead" else 1.0)
        )
        assert (b.density, b.parameters, b.poissons_ratio) == (
            a.density, a.parameters, a.poissons_ratio,
        )  # fmt: skip
    made = plan(stage, mass_scaling=16.0)
    assert made.settings.mass_scaling == 16.0
    (note,) = (note for note in made.notes if "--mass-scaling" in note)
    assert note == (
        "--mass-scaling 16: lead has a Young's modulus of 1e+09 Pa instead of 1.6e+10 Pa, and"
        " yields at an elastic strain of 1.2 % instead of 0.075 %; mass, weight and yield stress"
        " do not change"
    )


def test_mass_scaling_reaches_painted_moduli(plan) -> None:
    stiff = 'float[] primvars:gaussianFlesh:youngsModulus = [2e6] (interpolation = "constant")'
    made = plan(mesh("One", stiff, PAINTED), mass_scaling=4.0)
    values = spread(made.particles, table(made))
    assert values["youngs_modulus"] == pytest.approx(5e5)
    assert values["poissons_ratio"] == pytest.approx(table(made)[0].poissons_ratio)


def test_mass_scaling_of_an_elastic_body_is_refused(plan) -> None:
    with pytest.raises(
        UsageError, match="the bake has no material with plastic flow: rubber is neoHookean"
    ):
        plan(mesh("One"), mass_scaling=16.0)
