"""Presets: dimensionless ones follow the size of the body, physical ones do not."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path

import pytest

from gf_usd.core.errors import UsageError
from gf_usd.core.materials.dimensionless import DIMENSIONLESS, time_scale
from gf_usd.core.materials.laws import LAWS, check_law, law_parameters
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.physical import PHYSICAL, PhysicalPreset
from gf_usd.core.materials.presets import Fixed, find_preset, presets

G0 = 9.81
CHOICES = (
    "rubber, metal, jelly, dented, clay, styrofoam, water, gelatin, soft-silicone, silicone,"
    " neoprene, natural-rubber, hard-rubber, foam, polyurethane-foam, aluminium, mild-steel,"
    " copper, lead, modelling-clay, wet-clay, dough, dry-sand, wet-sand, gravel, powder-snow,"
    " wet-snow, toothpaste, mud, cream, honey, wax"
)
OTHERWISE = f"choose one of {CHOICES} (gf-usd materials shows them), or a USD file with a material"
each_look = pytest.mark.parametrize(
    "preset", DIMENSIONLESS.values(), ids=lambda preset: preset.name
)
each_preset = pytest.mark.parametrize("preset", presets().values(), ids=lambda p: p.name)


@each_look
@pytest.mark.parametrize("radius", [0.025, 1.0, 5.0])
def test_a_preset_is_its_numbers_times_rho_g0_r(preset, radius: float) -> None:
    made = preset.material(radius)
    unit = preset.density * G0 * radius
    # E and nu are made of mu and lam, and read back: rounding of a few operations.
    assert made.mu == pytest.approx(preset.mu * unit, rel=1e-12)
    assert made.lam == pytest.approx(preset.lam * unit, rel=1e-12)
    assert made.damping_time == pytest.approx(preset.damping * math.sqrt(radius / G0), rel=1e-12)
    assert (made.name, made.density, made.law) == (preset.name, preset.density, preset.law)
    assert (made.friction, made.restitution) == (preset.friction, preset.restitution)
    assert made.parameters.keys() == preset.parameters.keys()
    if "yield_stress" in preset.parameters:
        stress = preset.parameters["yield_stress"] * unit
        assert made.parameters["yield_stress"] == pytest.approx(stress, rel=1e-12)
    if "flow_viscosity" in preset.parameters:
        viscous = preset.parameters["flow_viscosity"] * unit * math.sqrt(radius / G0)
        assert made.parameters["flow_viscosity"] == pytest.approx(viscous, rel=1e-12)


@each_look
def test_a_wave_crosses_the_body_in_the_same_part_of_its_time(preset) -> None:
    # c T / r is free of dimensions: that is what makes every size squash alike.
    ratios = [preset.material(r).wave_speed * time_scale(r) / r for r in (0.025, 1.0, 5.0)]
    assert ratios == pytest.approx([math.sqrt(preset.lam + 2.0 * preset.mu)] * 3, rel=1e-12)


def test_presets_in_known_numbers() -> None:
    # docs/physics.md: rubber's nu comes out as .17; mu = 26.1 of rho g0 r = 10791 Pa at one meter.
    rubber = DIMENSIONLESS["rubber"].material(1.0)
    assert rubber.poissons_ratio == pytest.approx(0.167, abs=0.0005)
    assert rubber.mu == pytest.approx(26.1 * 1100.0 * 9.81)
    assert DIMENSIONLESS["metal"].material(1.0).mu > 7.0 * rubber.mu
    assert DIMENSIONLESS["jelly"].material(1.0).mu < rubber.mu / 30.0


@pytest.mark.parametrize(("young", "nu"), [(1e6, 0.0), (2e5, 0.3), (1e4, 0.47), (1.0, -0.2)])
def test_moduli_and_lame_are_one_another(young: float, nu: float) -> None:
    m = Material(name="m", law="neoHookean", density=1e3, youngs_modulus=young, poissons_ratio=nu)
    assert m.mu * (3.0 * m.lam + 2.0 * m.mu) / (m.lam + m.mu) == pytest.approx(young, rel=1e-12)
    assert m.lam / (2.0 * (m.lam + m.mu)) == pytest.approx(nu, abs=1e-12)
    # bulk modulus, by its other formula
    assert m.lam + 2.0 * m.mu / 3.0 == pytest.approx(young / (3.0 * (1.0 - 2.0 * nu)), rel=1e-12)
    assert m.wave_speed == pytest.approx(math.sqrt((m.lam + 2.0 * m.mu) / 1e3))


@pytest.mark.parametrize("preset", PHYSICAL.values(), ids=lambda p: p.name)
def test_a_physical_preset_is_the_same_at_every_size(preset) -> None:
    small, large = preset.material(0.01), preset.material(10.0)
    assert small == large
    assert small.youngs_modulus == preset.youngs_modulus
    values = asdict(preset)
    own = {p.name: values["parameters"].get(p.name, p.default) for p in law_parameters([small.law])}
    assert small.values.items() <= {**values, **own, "parameters": None}.items()
    assert preset.source


@each_preset
def test_presets_are_sound(preset) -> None:
    made = preset.material(1.0)
    assert made.law in LAWS
    assert made.density > 0.0
    assert made.youngs_modulus > 0.0
    assert -1.0 < made.poissons_ratio < 0.5
    assert made.damping_time >= 0.0
    assert 0.0 <= made.restitution <= 1.0


@each_preset
@pytest.mark.parametrize("law", LAWS)
def test_a_law_replaces_the_preset_s_own_and_nothing_else(preset, law: str) -> None:
    own, other = asdict(preset.material(0.5)), asdict(preset.material(0.5, law))
    assert other.pop("law") == law
    own.pop("law")
    kept, left = other.pop("parameters"), own.pop("parameters")
    assert own == other
    # A law's own parameters go with it, but for those that the other law has too.
    known = {p.name for p in law_parameters([law])}
    assert kept == {name: value for name, value in left.items() if name in known}


def test_a_material_that_is_given_stays_as_it_is() -> None:
    given = DIMENSIONLESS["jelly"].material(1.0)
    assert Fixed(given).name == "jelly"
    assert Fixed(given).material(7.0) == given
    assert Fixed(given).material(7.0, "corotated").law == "corotated"


def test_names_lead_to_presets_dimensionless_ones_first() -> None:
    assert list(presets()) == CHOICES.split(", ")
    assert all(find_preset(name).name == name for name in presets())


def test_every_preset_has_a_name_of_its_own() -> None:
    assert not DIMENSIONLESS.keys() & PHYSICAL.keys()


def test_a_name_stands_for_the_same_parameter_in_every_law() -> None:
    """The schema has one attribute of each name, with one default and one range."""
    every = {p for law in LAWS.values() for p in law.parameters}
    assert len({p.name for p in every}) == len({p.attribute for p in every}) == len(every)


@pytest.mark.parametrize(
    ("name", "guess"),
    [
        ("ruber", "did you mean rubber? "),
        ("sand", "did you mean dry-sand or wet-sand? "),
        ("Snow", "did you mean powder-snow or wet-snow? "),
        ("Metal", "did you mean metal? "),
        ("silicon", "did you mean silicone? "),
        ("xyz", ""),
        ("", ""),
    ],
)
def test_an_unknown_material_is_refused_with_the_nearest_name(name: str, guess: str) -> None:
    with pytest.raises(UsageError) as caught:
        find_preset(name)
    assert caught.value.message == f"there is no material {name!r}"
    assert caught.value.hint == guess + OTHERWISE


def test_an_unknown_law_is_refused() -> None:
    assert [check_law(token) for token in LAWS] == list(LAWS)
    with pytest.raises(UsageError) as caught:
        check_law("stvk")
    assert caught.value.message == "there is no law 'stvk'"
    assert caught.value.hint == f"choose one of {', '.join(LAWS)}"
    with pytest.raises(UsageError) as caught:
        check_law("neohookean")
    assert caught.value.hint.startswith("did you mean neoHookean? choose one of corotated")


@pytest.mark.parametrize("name", [n for n, p in presets().items() if LAWS[p.law].flows])
def test_the_document_of_materials_has_every_preset_that_flows(name: str) -> None:
    text = (Path(__file__).parents[2] / "docs" / "materials.md").read_text("utf-8")
    (row,) = (line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
    cells = [cell.strip() for cell in row.split("|")[1:-1]]
    made = presets()[name]
    keys = ("yield_stress", "hardening", "flow_viscosity")
    if made.law == "druckerPrager":
        keys = ("internal_friction", "cohesion")
    if made.law == "paste":
        keys = ("yield_stress", "flow_viscosity", "flow_exponent")
    if made.law == "snow":
        keys = ("critical_compression", "critical_stretch", "hardening_coefficient")
    if made.law == "fluid":
        keys = ("viscosity", "cavitation")
    own = [made.parameters.get(key, 0.0) for key in keys]
    if isinstance(made, PhysicalPreset):
        numbers = [made.density, made.youngs_modulus, made.poissons_ratio, *own]
        numbers.append(made.material(1.0).wave_speed)
        shown = [float(cell.replace(",", "") or 0) for cell in cells[1 : 1 + len(numbers)]]
        assert shown == pytest.approx(numbers, rel=5e-3)
        assert f"- `{name}`: {made.source}." in " ".join(text.split())
    else:
        assert cells[1] == f"`{made.law}`"
        assert [float(cell or 0) for cell in cells[2 : 2 + len(own)]] == own
        assert cells[2 + len(own)] == made.note
