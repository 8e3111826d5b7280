"""Young's modulus of a stage: with time samples, of a material or of paint, and not authored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gf_usd
from gf_usd.core.errors import InputError, UsageError
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
    keys = plan.particles.stiffness
    np.testing.assert_array_equal(keys.times, [1.0, 5.0])
    np.testing.assert_allclose(keys.at(3.0), 2.5, rtol=1e-6)
    (note,) = [n for n in plan.notes if "changes with 2 time samples" in n]
    assert "/Flesh.physics:youngsModulus: from 1e+06 to 4e+06 Pa" in note


def test_paint_with_time_samples_changes_where_it_is_painted(tmp_path: Path) -> None:
    """x = 0 keeps its 1 MPa, x = 1 goes from 1 to 3 MPa; between, the factor is 1 + 2 x."""
    after = [1e6 + 2e6 * x for x, _, _ in CORNERS]
    painted = f"""float[] primvars:gaussianFlesh:youngsModulus (interpolation = "vertex")
    float[] primvars:gaussianFlesh:youngsModulus.timeSamples = {{ 1: {[1e6] * 8}, 5: {after} }}"""
    plan = plan_of(stage(tmp_path, "float physics:youngsModulus = 7e6", painted))
    factors, x = plan.particles.stiffness.at(5.0), plan.particles.X[:, 0]
    # A particle has the value of the nearest point of the surface: within half the edge of it.
    assert np.abs(factors - (1.0 + 2.0 * x)).max() <= 2.0 * 0.5
    assert factors[x < 0.15].max() < 2.0 < factors[x > 0.85].min()
    assert factors.min() >= 1.0
    assert factors.max() <= 3.0


@pytest.mark.parametrize(
    ("material", "words"),
    [
        ("float physics:youngsModulus = 1e6", ""),
        ("float physics:youngsModulus.timeSamples = { 1: 1e6, 5: 1e6 }", ""),
        ("float physics:youngsModulus = 1e6\n"
         "    float physics:dynamicFriction.timeSamples = { 1: 0.5, 5: 0.9 }",
         "/Flesh.physics:dynamicFriction has time samples, and keeps the value of the rest pose"),
    ],
)  # fmt: skip
def test_what_does_not_change_has_no_keys(tmp_path: Path, material: str, words: str) -> None:
    plan = plan_of(stage(tmp_path, material))
    assert plan.particles.stiffness is None
    assert words in " ".join(plan.notes)


def test_a_material_that_was_asked_for_does_not_change(tmp_path: Path) -> None:
    assert plan_of(stage(tmp_path), material="rubber").particles.stiffness is None


def test_keys_beyond_the_bake_are_left_out(tmp_path: Path) -> None:
    many = ", ".join(f"{code}: {1e6 + code}" for code in range(1, 100, 2))
    plan = plan_of(stage(tmp_path, f"float physics:youngsModulus.timeSamples = {{ {many} }}"))
    assert plan.particles.stiffness.times[-1] == 9.0


def test_a_value_out_of_range_at_a_key_is_refused(tmp_path: Path) -> None:
    bad = "float physics:youngsModulus.timeSamples = { 1: 1e6, 5: -4e6 }"
    with pytest.raises(InputError, match=r"<.*Flesh>.*Young's modulus"):
        plan_of(stage(tmp_path, bad))


def test_the_other_solver_refuses_it(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="youngsModulus has time samples, which --solver ul"):
        plan_of(stage(tmp_path), solver="ul")


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


@pytest.mark.parametrize("said", ["", "float physics:youngsModulus = -inf"])
@pytest.mark.parametrize("api", ["PhysicsVolumeDeformableMaterialAPI", "PhysicsMaterialAPI"])
def test_a_deformable_material_without_a_modulus_is_noted(
    tmp_path: Path, said: str, api: str
) -> None:
    """-inf, and nothing, leave the modulus to the simulator: here, to rubber."""
    path = stage(tmp_path, said)
    path.write_text(path.read_text().replace('["PhysicsMaterialAPI"]', f'["{api}"]'))
    plan = plan_of(path)
    assert plan.materials[0].name == "rubber"
    noted = [note for note in plan.notes if "no Young's modulus is stated" in note]
    assert len(noted) == (api != "PhysicsMaterialAPI")
