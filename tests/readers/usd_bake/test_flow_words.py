"""Yield stresses in material files: by our names and Newton's, and the law that they imply."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pxr import Sdf, Usd

from gf_usd.core.errors import InputError
from gf_usd.core.materials.laws import flowing_law
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.core.units import StageUnits
from gf_usd.layers.materials import write_materials
from gf_usd.readers.usd_bake.material_file import read_material

HEAD = '#usda 1.0\n(\nmetersPerUnit = 0.01\n)\ndef Material "Soft"\n{\n%s\n}\n'
SOUND = """float physics:youngsModulus = 1e4
float physics:poissonsRatio = 0.3
float physics:density = 0.0011
"""
REL = 1e-6  # values in a file are float32


def read(tmp_path: Path, *lines: str) -> tuple[Material, list[str]]:
    """The material of a file in centimeters (a pressure of 1 is 100 Pa), and its notes."""
    path = tmp_path / "soft.usda"
    path.write_text(HEAD % (SOUND + "\n".join(lines)))
    notes: list[str] = []
    return read_material(path, notes.append), [one.partition("</Soft>: ")[2] for one in notes]


@pytest.mark.parametrize(
    ("stated", "otherwise", "law"),
    [
        ((), "neoHookean", "neoHookean"),
        (("hardening",), "neoHookean", "neoHookean"),  # it hardens what never yields
        (("yield_stress",), "neoHookean", "vonMises"),
        (("yield_stress", "hardening", "saturation"), "corotated", "vonMises"),
        (("yield_stress", "cap_shape"), "neoHookean", "crushable"),
        (("yield_stress",), "crushable", "crushable"),
    ],
)
def test_the_law_of_what_is_stated(stated: tuple[str, ...], otherwise: str, law: str) -> None:
    assert flowing_law(stated, otherwise) == law


def test_a_yield_stress_without_a_law_flows_and_says_so(tmp_path: Path) -> None:
    made, notes = read(tmp_path, "float gaussianFlesh:yieldStress = 20")
    assert made.law == "vonMises"
    assert made.parameters == {"yield_stress": pytest.approx(2000.0, rel=REL)}
    assert notes == ["a yield stress is stated but no law: vonMises is used"]


def test_a_law_that_is_stated_stays(tmp_path: Path) -> None:
    law = 'uniform token gaussianFlesh:law = "%s"'
    made, notes = read(tmp_path, "float gaussianFlesh:yieldStress = 20", law % "neoHookean")
    assert (made.law, notes) == ("neoHookean", [])
    made, notes = read(tmp_path, "float gaussianFlesh:yieldStress = 20", law % "crushable")
    assert (made.law, notes) == ("crushable", [])


def test_newtons_words_are_read_in_its_meaning(tmp_path: Path) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:yieldStress = 20",
        "float newton:mpm:viscosity = 0.5",
        "float newton:mpm:internalFriction = 0",
        "float newton:mpm:tensileYieldRatio = 1",
        "float newton:mpm:yieldPressure = -inf",
    )
    assert made.law == "vonMises"
    assert made.parameters == {
        "yield_stress": pytest.approx(3**0.5 * 2000.0, rel=REL),  # of sqrt(J2)
        "flow_viscosity": pytest.approx(3 * 50.0, rel=REL),
    }
    assert notes == ["a yield stress is stated but no law: vonMises is used"]


def test_what_newton_says_beyond_our_laws_is_named(tmp_path: Path) -> None:
    _, notes = read(
        tmp_path,
        "float newton:mpm:yieldStress = 20",
        "float newton:mpm:tensileYieldRatio = 0.1",
        "float newton:mpm:hardening = 5",
    )
    assert notes[0].startswith(
        "the yield stress is read from the attributes of Newton, except for "
        "newton:mpm:tensileYieldRatio,"
        " newton:mpm:hardening"
    )


def test_newtons_internal_friction_is_that_of_grains(tmp_path: Path) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:internalFriction = 0.5",
        "float newton:mpm:yieldStress = 20",
        "float newton:mpm:tensileYieldRatio = 0",
        "float newton:mpm:yieldPressure = -inf",
    )
    assert made.law == "druckerPrager"
    assert made.parameters == {
        "internal_friction": pytest.approx(0.5, rel=REL),
        "cohesion": pytest.approx(2000.0, rel=REL),  # both bound sqrt(J2)
    }
    assert notes == ["an internal friction is stated but no law: druckerPrager is used"]


def test_what_newton_says_beyond_grains_is_named(tmp_path: Path) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:internalFriction = 0.5",
        "float newton:mpm:tensileYieldRatio = 0.1",
        "float newton:mpm:yieldPressure = 1e6",
    )
    assert made.law == "druckerPrager"
    assert notes[0].startswith(
        "the internal friction is read from the attributes of Newton, except for "
        "newton:mpm:tensileYieldRatio,"
        " newton:mpm:yieldPressure"
    )


def test_internal_friction_of_a_metal_is_named(tmp_path: Path) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:yieldStress = 20",
        "float newton:mpm:internalFriction = 0.5",
        'uniform token gaussianFlesh:law = "vonMises"',
    )
    assert made.parameters == {"yield_stress": pytest.approx(3**0.5 * 2000.0, rel=REL)}
    assert "except for newton:mpm:internalFriction" in notes[0]


def in_newtons_words(material: Material) -> list[str]:
    """What a bake writes of a material's flow in Newton's namespace, as lines of a stage."""
    stage = Usd.Stage.CreateInMemory()
    units = StageUnits(meters_per_unit=0.01)
    (path,) = write_materials(stage, Sdf.Path("/Materials"), [material], "one", units)
    return [
        f"float {one.GetName()} = {one.Get()}"
        for one in stage.GetPrimAtPath(path).GetAttributes()
        if one.GetName().startswith("newton:mpm:") and "Modulus" not in one.GetName()
    ]


@pytest.mark.parametrize("name", ["dry-sand", "wet-sand"])
def test_grains_come_back_by_newtons_words_alone(tmp_path: Path, name: str) -> None:
    made, _ = read(tmp_path, *in_newtons_words(PHYSICAL[name].material(1.0)))
    assert made.law == "druckerPrager"
    own = {name: value for name, value in PHYSICAL[name].parameters.items() if value}
    assert made.parameters == {name: pytest.approx(value, rel=REL) for name, value in own.items()}


@pytest.mark.parametrize("tension", [1.0, 0.3])
def test_foam_comes_back_by_newtons_words_alone(tmp_path: Path, tension: float) -> None:
    foam = PHYSICAL["polyurethane-foam"].material(1.0)
    foam = replace(foam, parameters={**foam.parameters, "tensile_yield_ratio": tension})
    made, _ = read(tmp_path, *in_newtons_words(foam))
    assert made.law == "crushable"
    assert made.parameters == {
        name: pytest.approx(value, rel=REL) for name, value in foam.parameters.items()
    }


def test_a_yield_pressure_of_newtons_makes_a_crushable_material(tmp_path: Path) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:yieldStress = 20",
        "float newton:mpm:yieldPressure = 40",
        "float newton:mpm:tensileYieldRatio = 0.2",
        "float newton:mpm:viscosity = 3",
    )
    alpha = 3**0.5 * 20 / 40
    assert made.law == "crushable"
    assert made.parameters == {
        "yield_stress": pytest.approx(3**0.5 * 2000.0 / (1.0 + alpha**2 / 9.0) ** 0.5, rel=REL),
        "cap_shape": pytest.approx(alpha, rel=REL),
        "tensile_yield_ratio": pytest.approx(0.2, rel=REL),
    }
    assert any("except for newton:mpm:viscosity:" in line for line in notes)


@pytest.mark.parametrize("pressure", [2000.0, 5.0])
def test_a_yield_pressure_beyond_the_cap_is_named(tmp_path: Path, pressure: float) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:yieldStress = 20",
        f"float newton:mpm:yieldPressure = {pressure}",
    )
    assert made.law == "vonMises"
    assert "except for newton:mpm:yieldPressure:" in notes[0]


def test_a_tensile_yield_ratio_of_nothing_is_named(tmp_path: Path) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:yieldStress = 20",
        "float newton:mpm:yieldPressure = 40",
        "float newton:mpm:tensileYieldRatio = 0",
    )
    assert "tensile_yield_ratio" not in made.parameters
    assert any("except for newton:mpm:tensileYieldRatio:" in line for line in notes)


def test_newtons_hardening_is_that_of_lost_volume(tmp_path: Path) -> None:
    made, notes = read(
        tmp_path,
        "float newton:mpm:yieldStress = 20",
        "float newton:mpm:hardening = 5",
        'uniform token gaussianFlesh:law = "crushable"',
    )
    assert made.parameters["hardening"] == pytest.approx(5 * 3**0.5 * 2000.0, rel=REL)
    assert notes == []


def test_our_names_go_before_newtons(tmp_path: Path) -> None:
    made, _ = read(
        tmp_path, "float newton:mpm:yieldStress = 20", "float gaussianFlesh:yieldStress = 7"
    )
    assert made.parameters == {"yield_stress": pytest.approx(700.0, rel=REL)}


@pytest.mark.parametrize("value", ["0", "-inf"])
def test_newtons_fallbacks_say_nothing(tmp_path: Path, value: str) -> None:
    made, notes = read(
        tmp_path, f"float newton:mpm:yieldStress = {value}", "float newton:mpm:hardening = 5"
    )
    assert (made.law, made.parameters, notes) == ("neoHookean", {}, [])


def test_a_yield_stress_of_newtons_below_zero_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="newton:mpm:yieldStress is -"):
        read(tmp_path, "float newton:mpm:yieldStress = -3")


@pytest.mark.parametrize("name", ["modelling-clay", "polyurethane-foam", "lead"])
def test_what_a_bake_writes_is_read_back(tmp_path: Path, name: str) -> None:
    material = PHYSICAL[name].material(1.0)
    path = tmp_path / "baked.usda"
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetMetadata("metersPerUnit", 0.01)
    units = StageUnits(meters_per_unit=0.01)
    write_materials(stage, Sdf.Path("/Materials"), [material], name, units)
    stage.Save()
    notes: list[str] = []
    made = read_material(path, notes.append)
    assert notes == []
    assert made.law == material.law
    for parameter, value in material.values.items():
        if parameter not in ("name", "law"):
            assert made.values[parameter] == pytest.approx(value, rel=REL), parameter


def test_newton_gets_the_attributes_of_flow_by_its_own_names(tmp_path: Path) -> None:
    """A stage with Newton's words alone, as it would write them, is the same material."""
    clay = PHYSICAL["modelling-clay"].material(1.0)
    stage = Usd.Stage.CreateInMemory()
    stage.SetMetadata("metersPerUnit", 0.01)
    (prim_path,) = write_materials(
        stage, Sdf.Path("/Materials"), [clay], "clay", StageUnits(meters_per_unit=0.01)
    )
    prim = stage.GetPrimAtPath(prim_path)
    assert prim.GetAttribute("newton:mpm:internalFriction").Get() == 0.0
    for attribute in prim.GetAttributes():
        if attribute.GetName().startswith("gaussianFlesh:"):
            prim.RemoveProperty(attribute.GetName())
    stage.Export(str(tmp_path / "theirs.usda"))
    made = read_material(tmp_path / "theirs.usda")
    assert made.law == "vonMises"
    for name in ("yield_stress", "flow_viscosity"):
        assert made.parameters[name] == pytest.approx(clay.parameters[name], rel=REL)
