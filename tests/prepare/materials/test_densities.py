"""A density of the stage that no solid has is a warning, since an option may change the unit."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from physics_stages import bound, head, mesh, prim
from planned import planner

from gf_usd.pipeline.health.warnings import plan_warnings
from gf_usd.prepare.plan import Plan

MASS = "PhysicsMassAPI"
# a cube of 100 units, 1 m in centimeters
LARGE = (
    "double3 xformOp:scale = (100, 100, 100)",
    'uniform token[] xformOpOrder = ["xformOp:scale"]',
)
CENTIMETERS = head(0.01)


@pytest.fixture
def plan(tmp_path) -> Callable[..., Plan]:
    return planner(tmp_path)


@pytest.mark.parametrize(
    ("stated", "probably"),
    [
        (1000, "1000 kg/m^3 was probably meant, which is 0.001 in the units of this stage"),
        (7.8, "7.8 g/cm^3 was probably meant, which is 0.0078 in the units of this stage"),
    ],
)
def test_the_number_the_prim_and_what_was_meant_are_named(plan, stated, probably) -> None:
    """A cube of a meter had a million tons, without a word."""
    made = plan(
        mesh("Duck", f"float physics:density = {stated}", *LARGE, apis=[MASS]), layer=CENTIMETERS
    )
    assert made.heavy == (
        f"</Duck> states a density of {1e6 * stated:.3g} kg/m^3 ({stated} mass units of 1 kg per"
        f" cubic unit of 0.01 m): {probably}; no solid has more than 23,000 kg/m^3"
    )
    assert made.heavy in made.notes
    (warning,) = plan_warnings(made.odd, made.heavy)
    assert warning.about == "density"


@pytest.mark.parametrize(
    ("stated", "options"),
    [
        ("float physics:density = 0.001", {}),
        ("float physics:density = 1000", {"meters_per_unit": 1.0}),
        ("float physics:density = 1000", {"material": "jelly"}),
        ("float physics:mass = 1000", {}),
    ],
    ids=["in its unit", "of another unit", "not used", "a mass"],
)
def test_sound_densities_are_no_warning(plan, stated: str, options: dict[str, object]) -> None:
    made = plan(mesh("Duck", stated, *LARGE, apis=[MASS]), layer=CENTIMETERS, **options)
    assert made.heavy == ""


def test_the_density_of_a_mass_counts(plan) -> None:
    made = plan(mesh("Duck", "float physics:mass = 1", apis=[MASS]), layer=CENTIMETERS)
    assert made.heavy.startswith(
        "</Duck> states a mass of 1 kg in 1e-06 m^3, which is a density of 1,000,000 kg/m^3"
    )


def test_the_density_of_a_bound_material_counts(plan) -> None:
    material = prim(
        "Material", "Lead", "float physics:density = 113400", apis=["PhysicsMaterialAPI"]
    )
    cubes = [
        mesh(name, bound("/Lead"), *LARGE, apis=["MaterialBindingAPI"]) for name in ("One", "Two")
    ]
    made = plan(material, *cubes)
    assert made.heavy.startswith("</Lead> states a density of 113,400 kg/m^3; no solid")
