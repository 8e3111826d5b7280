"""What every part of every body is made of, by the stage and by the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from physics_stages import bound, mesh, prim
from planned import SOFT, at, cubes, mass, noted, plan_fixture, table  # noqa: F401

from gf_usd.core.errors import InputError
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.materials.material import Material
from gf_usd.prepare.materials.checks import FLAT, SPREADS, require_standing

MASS = "PhysicsMassAPI"
JELLY, METAL = ('token gaussianFlesh:material = "jelly"', 'token gaussianFlesh:material = "metal"')


def material(name: str = "Soft", *lines: str) -> str:
    return prim("Material", name, *lines or [SOFT], apis=["PhysicsMaterialAPI"])


@pytest.mark.slow
def test_without_a_word_all_is_rubber_of_each_body_s_size(plan) -> None:
    big = "double3 xformOp:scale = (3, 3, 3)\ndouble3 xformOp:translate = (4, 0, 0)"
    order = 'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]'
    seen = plan(mesh("One"), mesh("Two", big, order), particles=800)
    assert [m.name for m in seen.materials] == ["rubber"]
    one, two = table(seen)
    # Moduli of a look go with the radius; 10 %: the small one's volume is that of 29 strata.
    assert two.youngs_modulus == pytest.approx(3.0 * one.youngs_modulus, rel=0.1)
    index = seen.particles.material
    assert np.array_equal(index[seen.particles.body == 0] == index[0], [True] * (index == 0).sum())


def test_each_body_has_the_material_that_it_asks_for(plan) -> None:
    seen = plan(material(), cubes(bound("/Soft")), mesh("Three", JELLY, at(6.0)))
    assert [m.name for m in seen.materials] == ["authored"]
    made = table(seen)
    of = [made[seen.particles.material[seen.particles.body == k][0]] for k in range(3)]
    assert of[0].youngs_modulus == pytest.approx(2e5)
    assert of[0].density == pytest.approx(900)
    assert [m.name for m in of[1:]] == ["rubber", "jelly"]
    assert [m.law for m in of[1:]] == [DIMENSIONLESS["rubber"].law, DIMENSIONLESS["jelly"].law]


def test_options_override_the_values_of_the_stage(plan) -> None:
    """They were ignored where the stage had a value of its own."""
    own = [
        SOFT, "float physics:dynamicFriction = 0.8", "float physics:restitution = 0.3",
        "uniform float gaussianFlesh:dampingTime = 1.0",
    ]  # fmt: skip
    seen = plan(
        material("Soft", *own), cubes(bound("/Soft")),
        damping_time=0.002, friction=0.1, restitution=0.6,
    )  # fmt: skip
    made = table(seen)
    assert {(one.damping_time, one.friction, one.restitution) for one in made} == {
        (0.002, 0.1, 0.6)
    }
    assert made[0].youngs_modulus == pytest.approx(2e5)


def test_one_name_for_all_names_the_variant(plan) -> None:
    both = mesh("One", JELLY) + mesh("Two", JELLY, at(3.0))
    assert [m.name for m in plan(both).materials] == ["jelly"]


def test_faces_of_a_body_have_materials_of_their_own(plan) -> None:
    # The face at x = 1, counter-clockwise from outside: the last.
    side = prim(
        "GeomSubset", "side", 'uniform token elementType = "face"', "int[] indices = [5]",
        'uniform token familyName = "materialBind"', bound("/Hard"), apis=["MaterialBindingAPI"],
    )  # fmt: skip
    hard = material("Hard", SOFT.replace("2e5", "4e6"))
    seen = plan(material(), hard, mesh("One", bound("/Soft"), side), particles=400)
    moduli = np.array([m.youngs_modulus for m in table(seen)])[seen.particles.material]
    assert set(moduli.round()) == {2e5, 4e6}
    X = seen.particles.X - 0.5
    # The faces at x = 0 and 1 and four others: what is nearest to the last is a pyramid.
    nearest = (np.abs(X).argmax(1) == 0) & (X[:, 0] > 0)
    # Particles on the planes between the pyramids are as near to two faces.
    least, most = np.sort(np.abs(X), axis=1)[:, 1:].T
    clear = most - least > 1e-9
    assert clear.mean() > 0.5
    assert np.array_equal(moduli[clear] > 1e6, nearest[clear])


def test_a_stated_mass_is_had_and_moduli_stay(plan) -> None:
    seen = plan(material(), cubes(bound("/Soft"), "float physics:mass = 50", apis=(MASS,)))
    assert mass(seen, 0) == pytest.approx(50.0)
    moduli = [m.youngs_modulus for m in table(seen)]
    assert pytest.approx(2e5) in moduli


def test_a_mass_above_is_that_of_all_below_together(plan) -> None:
    car = prim(
        "Xform", "Car", cubes(), "float physics:mass = 80", apis=[MASS, "PhysicsRigidBodyAPI"]
    )
    assert mass(plan(car), 0) == pytest.approx(80.0)


def test_a_stated_density_applies_to_a_preset_with_its_moduli(plan) -> None:
    seen = plan(cubes("float physics:density = 500", apis=(MASS,)))
    light, other = (
        table(seen)[seen.particles.material[seen.particles.body == k][0]] for k in (0, 1)
    )
    assert light.density == pytest.approx(500.0)
    assert light.youngs_modulus / other.youngs_modulus == pytest.approx(
        500.0 / other.density, rel=0.02
    )


def test_material_on_the_command_line_goes_before_the_stage(plan) -> None:
    layer = material() + cubes(bound("/Soft"), METAL, "float physics:mass = 50", apis=(MASS,))
    seen = plan(layer, material="jelly")
    assert {m.name for m in table(seen)} == {"jelly"}
    assert mass(seen, 0) == pytest.approx(DIMENSIONLESS["jelly"].density, rel=0.02)
    both = plan(layer, material="jelly,metal")
    assert [m.name for m in both.materials] == ["jelly", "metal"]


def test_numbers_of_the_command_line_go_over_the_stage_s(plan) -> None:
    made = table(plan(cubes(), friction=0.25, restitution=0.5, damping_time=0.01))
    assert {(m.friction, m.restitution, m.damping_time) for m in made} == {(0.25, 0.5, 0.01)}
    made = table(plan(cubes(JELLY), law="neoHookean"))
    assert {m.law for m in made} == {"neoHookean"}


def test_a_broken_material_matters_only_where_it_is_used(plan) -> None:
    broken = material("Soft", SOFT.replace("0.3", "0.9")) + cubes(bound("/Soft"))
    with pytest.raises(InputError, match="/Soft"):
        plan(broken)
    assert {m.name for m in table(plan(broken, material="rubber"))} == {"rubber"}


def test_spacing_and_particles_of_the_stage_hold_unless_asked(plan) -> None:
    layer = cubes("float gaussianFlesh:spacing = 0.1") + mesh(
        "Three", at(6.0), "int gaussianFlesh:particles = 64"
    )
    seen = plan(layer, particles=None)
    # At .1 all cells are full.  At .2 a cube has 27 cells of which 26 are cut, to .42 to .75 of a
    # full one: 4 particles in each for its 1 m^3 / (.2 m)^3 = 125.
    assert seen.particles.spacing == pytest.approx(0.1, rel=0.02)
    assert noted(seen, "a bake has one spacing: the 10 cm of </One> is used for all bodies")
    assert plan(layer, particles=None, spacing=0.2).particles.spacing == pytest.approx(
        (1.0 / (26 * 4 + 8)) ** (1.0 / 3.0), rel=1e-6
    )
    # Three cubes of 2.03 cells along each edge: a full cell in the middle and half a one on six
    # sides and twelve edges; an eighth of one in the corners goes to the edges.
    assert len(plan(layer).particles) == 3 * (8 + 18 * 4)


def side(faces: str, bound_to: str) -> str:
    return prim(
        "GeomSubset", "side", 'uniform token elementType = "face"', f"int[] indices = [{faces}]",
        'uniform token familyName = "materialBind"', bound(bound_to), apis=["MaterialBindingAPI"],
    )  # fmt: skip


def test_materials_of_subsets_name_the_variant(plan) -> None:
    # All six faces of the cube, or one and five of rubber.
    seen = plan(material(), mesh("One", side("0, 1, 2, 3, 4, 5", "/Soft")))
    assert [m.name for m in seen.materials] == ["Soft"]
    seen = plan(material(), mesh("One", side("5", "/Soft")))
    assert [m.name for m in seen.materials] == ["authored"]


def test_a_material_that_cannot_carry_its_height_is_advised_and_beyond_that_refused() -> None:
    path, g, height = Path("tower.usda"), 9.81, 2.0
    soft = Material(
        name="mud", law="neoHookean", density=1000.0, youngs_modulus=1.0, poissons_ratio=0.3
    )

    def notes(ratio: float) -> tuple[str, ...]:
        """Of a tower that weighs `ratio` times its Young's modulus at the foot."""
        E = 1000.0 * g * height / ratio
        return require_standing(path, [replace(soft, youngs_modulus=E)] * 2, height, g)

    assert notes(0.99 * SPREADS) == ()
    (line,) = notes(1.01 * SPREADS)
    assert line.startswith(
        "mud cannot carry its own weight: 2 m of it weigh 1.96e+04 Pa, 3.03 times"
    )
    assert "a Young's modulus of 2e+04 Pa would keep its shape" in line
    with pytest.raises(InputError) as caught:
        notes(1.01 * FLAT)
    assert caught.value.message.startswith("tower.usda: mud cannot carry its own weight")
    assert "a Young's modulus of 2e+04 Pa or more" in caught.value.hint
    assert require_standing(path, [replace(soft, youngs_modulus=1.0)], height, 0.0) == ()


@pytest.mark.parametrize("name", sorted(DIMENSIONLESS))
@pytest.mark.parametrize("radius", [0.01, 1.0, 30.0])
def test_presets_that_grow_with_the_body_stand_at_any_size(name: str, radius: float) -> None:
    made = DIMENSIONLESS[name].material(radius)
    assert require_standing(Path("ball.usda"), [made], 2.0 * radius, 9.81) == ()
