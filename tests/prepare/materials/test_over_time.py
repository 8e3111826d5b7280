"""Material values of a stage: with time samples, of a material or of paint, and not authored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gf_usd
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.materials.keys import KEYED
from gf_usd.prepare.prepare import prepare

CORNERS = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]
FACES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
YOUNG = "float physics:youngsModulus.timeSamples = { 1: 1e6, 5: 4e6 }"


def stage(folder: Path, material: str = YOUNG, painted: str = "") -> Path:
    """A cube of 1 m of a material; 24 time codes a second."""
    path = folder / "cube.usda"
    path.write_text(f"""#usda 1.0
( metersPerUnit = 1
  upAxis = "Y"
  startTimeCode = 1
  endTimeCode = 9
  timeCodesPerSecond = 24 )
def Mesh "Cube" ( prepend apiSchemas = ["MaterialBindingAPI"] )
{{
    point3f[] points = {CORNERS}
    int[] faceVertexCounts = {[4] * 6}
    int[] faceVertexIndices = {FACES}
    rel material:binding:physics = </Flesh>
    {painted}
}}
def Material "Flesh" ( prepend apiSchemas = ["PhysicsMaterialAPI"] )
{{
    float physics:poissonsRatio = 0.4
    float physics:density = 1000
    {material}
}}
""")
    return path


def plan_of(path: Path, **options):
    plan, _ = prepare(
        path, draw=None, particles=100, output=path.parent / "out.usda", **{"frames": 9, **options}
    )
    return plan


def test_time_samples_of_a_material_are_factors_of_its_modulus(tmp_path: Path) -> None:
    plan = plan_of(stage(tmp_path))
    keys = plan.particles.keys
    np.testing.assert_array_equal(keys.times, [1.0, 5.0])
    np.testing.assert_allclose(keys.at(3.0)["youngs_modulus"], 2.5e6, rtol=1e-6)
    np.testing.assert_allclose(keys.at(3.0)["mu"], 2.5e6 / 2.8, rtol=1e-6)
    (note,) = [n for n in plan.notes if "changes with 2 time samples" in n]
    assert "/Flesh.physics:youngsModulus: from 1e+06 to 4e+06 Pa" in note


def test_paint_with_time_samples_changes_where_it_is_painted(tmp_path: Path) -> None:
    """x = 0 keeps its 1 MPa, x = 1 goes from 1 to 3 MPa; between, the factor is 1 + 2 x."""
    after = [1e6 + 2e6 * x for x, _, _ in CORNERS]
    painted = f"""float[] primvars:gaussianFlesh:youngsModulus (interpolation = "vertex")
    float[] primvars:gaussianFlesh:youngsModulus.timeSamples = {{ 1: {[1e6] * 8}, 5: {after} }}"""
    plan = plan_of(stage(tmp_path, "float physics:youngsModulus = 7e6", painted))
    factors = plan.particles.keys.at(5.0)["youngs_modulus"] / 1e6
    x = plan.particles.X[:, 0]
    # A particle has the value of the nearest point of the surface: within half the edge of it.
    assert np.abs(factors - (1.0 + 2.0 * x)).max() <= 2.0 * 0.5
    assert factors[x < 0.15].max() < 2.0 < factors[x > 0.85].min()
    assert factors.min() >= 1.0 - 1e-6  # single precision
    assert factors.max() <= 3.0 + 1e-6


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ("float physics:youngsModulus = 1e6", ""),
        ("float physics:youngsModulus.timeSamples = { 1: 1e6, 5: 1e6 }", ""),
        ("float physics:youngsModulus = 1e6\n"
         "    float physics:restitution.timeSamples = { 1: 0.5, 5: 0.9 }",
         "/Flesh.physics:restitution has time samples, and keeps the value of the rest pose"),
        ("float physics:youngsModulus = 1e6\n    float physics:dynamicFriction = 0.5\n"
         "    float physics:staticFriction.timeSamples = { 1: 0.5, 5: 0.9 }",
         "/Flesh.physics:staticFriction has time samples, and keeps the value of the rest pose"),
        ("float physics:youngsModulus = 1e6\n"
         "    float newton:mpm:youngsModulus.timeSamples = { 1: 1e6, 5: 2e6 }",
         "mpm:youngsModulus has time samples, with which Young's modulus does not change"),
        ("float physics:youngsModulus = 1e6\n"
         "    float gaussianFlesh:dampingTime.timeSamples = { 1: 0.5, 5: 0.5 }",
         "dampingTime has time samples, with which the damping time does not change"),
    ],
)  # fmt: skip
def test_what_does_not_change_has_no_keys(tmp_path: Path, material: str, message: str) -> None:
    plan = plan_of(stage(tmp_path, material))
    assert plan.particles.keys is None
    assert message in " ".join(plan.notes)


HARD = "float physics:youngsModulus = 1e6\n    "


@pytest.mark.parametrize(
    ("authored", "name", "low", "high", "message"),
    [
        ("float physics:poissonsRatio.timeSamples = { 1: 0.2, 5: 0.4 }", "poissons_ratio", 0.2, 0.4,
         "Poisson's ratio changes with 2 time samples of /Flesh.physics:poissonsRatio: from 0.2 to"
         " 0.4"),
        ("float gaussianFlesh:dampingTime.timeSamples = { 1: 0, 5: 0.02 }", "damping_time", 0, 0.02,
         "the damping time changes with 2 time samples of /Flesh.gaussianFlesh:dampingTime: from 0"
         " to 0.02 s"),
        ("float newton:mpm:elasticDamping.timeSamples = { 1: 1e4, 5: 2e4 }", "damping_time", 0.01,
         0.02, "the damping time changes with 2 time samples of /Flesh.newton:mpm:elasticDamping"),
        ("float physics:dynamicFriction.timeSamples = { 1: 0.1, 5: 0.9 }", "friction", 0.1, 0.9,
         "friction changes with 2 time samples of /Flesh.physics:dynamicFriction: from 0.1 to 0.9"),
        ("float physics:staticFriction.timeSamples = { 1: 0.1, 5: 0.9 }", "friction", 0.1, 0.9,
         "friction changes with 2 time samples of /Flesh.physics:staticFriction"),
    ],
)  # fmt: skip
def test_other_values_of_a_material_change_as_well(
    tmp_path: Path, authored: str, name: str, low: float, high: float, message: str
) -> None:
    path = stage(tmp_path, HARD + authored)
    if "poissonsRatio" in authored:
        text = path.read_text()
        path.write_text(text.replace("float physics:poissonsRatio = 0.4\n", ""))
    plan = plan_of(path)
    keys = plan.particles.keys
    for code, wanted in ((1.0, low), (3.0, 0.5 * (low + high)), (9.0, high)):
        np.testing.assert_allclose(keys.at(code)[name], wanted, rtol=1e-6, atol=1e-9)
    assert [one for one in KEYED if keys.changes(one)] == [name]
    assert message in " ".join(plan.notes)


def test_a_constant_viscosity_is_one_of_the_modulus_that_changes(tmp_path: Path) -> None:
    """Newton's elasticDamping is a viscosity: tau = elasticDamping / E, of each moment."""
    plan = plan_of(stage(tmp_path, YOUNG + "\n    float newton:mpm:elasticDamping = 1e4"))
    for code, tau in ((1.0, 1e-2), (5.0, 2.5e-3)):
        np.testing.assert_allclose(plan.particles.keys.at(code)["damping_time"], tau, rtol=1e-6)


@pytest.mark.parametrize(
    ("material", "painted"),
    [
        ("float physics:density.timeSamples = { 1: 1000, 5: 1200 }", ""),
        ("", "float[] primvars:gaussianFlesh:density.timeSamples = { 1: [1000], 5: [1200] }"),
        ("", "float physics:mass.timeSamples = { 1: 1000, 5: 1200 }"),
        ("", "float physics:density.timeSamples = { 1: 1000, 5: 1200 }"),
    ],
)
def test_a_mass_that_changes_is_refused(tmp_path: Path, material: str, painted: str) -> None:
    path = stage(tmp_path, HARD + material, painted)
    text = path.read_text()
    if material:
        text = text.replace("float physics:density = 1000\n", "")
    if painted.startswith("float physics"):
        text = text.replace('["MaterialBindingAPI"]', '["MaterialBindingAPI", "PhysicsMassAPI"]')
    path.write_text(text)
    with pytest.raises(
        InputError, match="2 time samples, from 1000 to 1200, but the mass of"
    ) as error:
        plan_of(path)
    assert "may change" in error.value.hint
    same = tmp_path / "same.usda"  # samples that are all the same are one value
    same.write_text(text.replace("1200", "1000"))
    assert plan_of(same).particles.keys is None


def test_the_friction_of_an_obstacle_that_changes_is_named(tmp_path: Path) -> None:
    path = stage(tmp_path, HARD)
    path.write_text(
        path.read_text()
        + """def Cube "Table" ( prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"] )
{
    rel material:binding:physics = </Wood>
    double3 xformOp:translate = (0, -3, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Material "Wood" ( prepend apiSchemas = ["PhysicsMaterialAPI"] )
{
    float physics:dynamicFriction.timeSamples = { 1: 0.2, 5: 0.4 }
}
"""
    )
    assert "</Wood>: physics:dynamicFriction has time samples: obstacles keep" in " ".join(
        plan_of(path).notes
    )


def test_a_material_that_was_asked_for_does_not_change(tmp_path: Path) -> None:
    assert plan_of(stage(tmp_path), material="rubber").particles.keys is None


def test_keys_beyond_the_bake_are_left_out(tmp_path: Path) -> None:
    many = ", ".join(f"{code}: {1e6 + code}" for code in range(1, 100, 2))
    plan = plan_of(stage(tmp_path, f"float physics:youngsModulus.timeSamples = {{ {many} }}"))
    assert plan.particles.keys.times[-1] == 9.0


def test_a_value_out_of_range_at_a_key_is_refused(tmp_path: Path) -> None:
    bad = "float physics:youngsModulus.timeSamples = { 1: 1e6, 5: -4e6 }"
    with pytest.raises(InputError, match=r"<.*Flesh>.*Young's modulus"):
        plan_of(stage(tmp_path, bad))


def test_the_other_solver_refuses_it(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="youngsModulus has time samples, which --solver ul"):
        plan_of(stage(tmp_path), solver="ul")


@pytest.mark.slow
def test_a_bake_says_what_stiffening_did(tmp_path: Path) -> None:
    """A cube that stands on the floor, pressed flat by its weight, and is stiffened: work of its
    strain energy, no warning of energy out of nothing."""
    soft = "float physics:youngsModulus.timeSamples = { 1: 1e5, 4: 1e5, 5: 4e5 }"
    result = gf_usd.bake(
        stage(tmp_path, soft), particles=100, frames=9, drop=0.0, output=tmp_path / "out.usda"
    )
    (bake,) = result.bakes
    assert bake.health["work_of_pins_J"] > 0.0
    assert not [w for w in result.warnings if "energy" in str(w)]


@pytest.mark.parametrize("authored", ["", "float physics:youngsModulus = -inf"])
@pytest.mark.parametrize("api", ["PhysicsVolumeDeformableMaterialAPI", "PhysicsMaterialAPI"])
def test_a_deformable_material_without_a_modulus_is_noted(
    tmp_path: Path, authored: str, api: str
) -> None:
    """-inf, and nothing, leave the modulus to the simulator: here, to rubber."""
    path = stage(tmp_path, authored)
    path.write_text(path.read_text().replace('["PhysicsMaterialAPI"]', f'["{api}"]'))
    plan = plan_of(path)
    assert plan.materials[0].name == "rubber"
    noted = [note for note in plan.notes if "no Young's modulus is stated" in note]
    assert len(noted) == (api != "PhysicsMaterialAPI")
