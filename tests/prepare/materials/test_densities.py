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
    (warning,) = plan_warnings(made.odd, made.heavy, made.stated_heavy)
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
        "</Duck> states a mass of 1 kg in 1 cm³, which is a density of 1,000,000 kg/m^3"
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


RUBBER = 'uniform token gaussianFlesh:material = "rubber"'
LEAD = prim("Material", "Lead", "float physics:density = 113400", apis=["PhysicsMaterialAPI"])
WATER = prim("Material", "Water", "float physics:density = 1000", apis=["PhysicsMaterialAPI"])


def subset(name: str, faces: str, material: str) -> str:
    return prim(
        "GeomSubset",
        name,
        f'int[] indices = [{faces}]\nuniform token elementType = "face"',
        'uniform token familyName = "materialBind"',
        bound(material),
        apis=["MaterialBindingAPI"],
    )


def test_a_preset_goes_before_the_density_of_the_prim(plan) -> None:
    """The bake used 1100 kg/m^3, and the warning named 1e+09."""
    duck = mesh("Duck", "float physics:density = 1000", RUBBER, *LARGE, apis=[MASS])
    made = plan(duck, layer=CENTIMETERS)
    assert made.materials[0].density == pytest.approx(1100.0)
    assert made.heavy == ""


@pytest.mark.parametrize(("faces", "warned"), [("0, 1, 2, 3, 4, 5", False), ("0, 1", True)])
def test_a_material_counts_where_faces_have_it(plan, faces: str, warned: bool) -> None:
    cube = mesh("One", bound("/Lead"), subset("All", faces, "/Water"), apis=["MaterialBindingAPI"])
    assert plan(LEAD, WATER, cube).heavy.startswith("</Lead> states") == warned


def test_a_material_of_a_subset_counts(plan) -> None:
    cube = mesh(
        "One", bound("/Water"), subset("Some", "0, 1", "/Lead"), apis=["MaterialBindingAPI"]
    )
    assert plan(LEAD, WATER, cube).heavy.startswith("</Lead> states a density of 113,400")


@pytest.mark.parametrize(
    ("line", "by", "lines"),
    [
        ("float physics:density = 1000", "density", LARGE),
        ("float physics:mass = 1", "mass", ()),
        ("float omniphysics:mass = 1", "mass", ()),
    ],
)
def test_the_warning_names_what_is_stated(plan, line: str, by: str, lines: tuple[str, ...]) -> None:
    made = plan(mesh("Duck", line, *lines, apis=[MASS]), layer=CENTIMETERS)
    (warning,) = plan_warnings("", made.heavy, made.stated_heavy)
    assert f"states a {by} of" in warning.message
    assert warning.hint.startswith(f"correct {line.split()[1]} of </Duck> in the file, or")


def test_painted_densities_go_before_that_of_the_prim(plan) -> None:
    painted = 'float[] primvars:gaussianFlesh:density = [0.001] (interpolation = "constant")'
    duck = mesh("Duck", "float physics:density = 1000", painted, *LARGE, apis=[MASS])
    made = plan(duck, layer=CENTIMETERS)
    assert made.particles.own["density"] == pytest.approx(1000.0)
    assert made.heavy == ""
