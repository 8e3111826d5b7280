"""From --material, --law, --preset paper and --material-sweep to the presets of a bake."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gf_usd.core.errors import UsageError
from gf_usd.core.materials.presets import Fixed, find_preset
from gf_usd.prepare.advice import Auto
from gf_usd.prepare.options.parse import material_names, parse_request

SWEEP = {"material_sweep": "youngs=1e4:1e5:2"}
FELT = replace(find_preset("rubber").material(0.1), name="felt", density=250.0)
FILE = """#usda 1.0
(
    metersPerUnit = 1
)
def Material "Cork" (
    prepend apiSchemas = ["PhysicsMaterialAPI"]
)
{
    float physics:density = 180
    float physics:youngsModulus = 2e7
    float physics:poissonsRatio = 0.1
}
"""


def refusal(*arguments) -> tuple[str, str]:
    """Message and hint of the UsageError of `parse_request`."""
    with pytest.raises(UsageError) as caught:
        parse_request(*arguments)
    return caught.value.message, caught.value.hint


def test_materials_are_named_with_commas_or_one_by_one() -> None:
    for given in ("jelly, rubber", ("jelly", "rubber")):
        request, presets = parse_request(given, None, {"frames": 3})
        assert presets == [find_preset("jelly"), find_preset("rubber")]
        assert request.frames == 3


@pytest.mark.parametrize("material", [None, "", ()])
def test_without_a_name_the_stage_has_the_materials(material) -> None:
    assert parse_request(material, None, {})[1] == []


def test_a_material_given_by_value_has_a_note() -> None:
    _, (preset,) = parse_request((FELT,), None, {})
    assert isinstance(preset, Fixed)
    assert (preset.name, preset.material(0.3)) == ("felt", FELT)
    (note,) = preset.notes
    assert note.startswith("the values of the material felt were given by the caller")


def test_a_material_of_a_file_is_called_after_its_prim(tmp_path: Path) -> None:
    file = tmp_path / "cork.usda"
    file.write_text(FILE, encoding="utf-8")
    _, presets = parse_request(f"jelly,{file}", None, {})
    assert [one.name for one in presets] == ["jelly", "Cork"]
    assert presets[1].material(0.3).youngs_modulus == 2e7


def test_names_include_materials_given_by_value() -> None:
    assert material_names(("jelly", FELT)) == "jelly,felt"
    assert material_names("jelly,rubber") == "jelly,rubber"
    assert material_names(None) is None


def test_names_and_laws_that_do_not_exist_are_refused_before_a_file_is_read() -> None:
    message, hint = refusal("rubbber", None, {})
    assert message == "there is no material 'rubbber'"
    assert "rubber" in hint
    with pytest.raises(UsageError, match="hookean"):
        parse_request("rubber", "hookean", {})
    with pytest.raises(UsageError, match="--frames is 0"):
        parse_request("rubber", None, {"frames": 0})


def test_the_paper_has_rubber_and_every_solid_corotated() -> None:
    assert [one.name for one in parse_request(None, None, {"preset": "paper"})[1]] == ["rubber"]
    _, presets = parse_request("rubber,jelly", None, {"preset": "paper"})
    assert [one.law for one in presets] == ["corotated", "corotated"]
    _, presets = parse_request("rubber,jelly", None, {})
    assert {one.law for one in presets} != {"corotated"}


def test_auto_is_alone() -> None:
    assert parse_request("auto", None, {})[1] == [Auto("")]
    assert refusal("auto", None, SWEEP) == (
        "--material-sweep cannot be combined with --material auto",
        "name the material to vary",
    )
    assert refusal("jelly,auto", None, {})[0] == (
        "--material jelly,auto: auto is in a list, but it chooses the material itself"
    )
    assert refusal(("auto", FELT), None, {})[0].startswith("--material auto,felt: auto is in a")


def test_a_sweep_varies_rubber_where_no_material_is_named() -> None:
    _, presets = parse_request(None, None, SWEEP)
    assert [one.name for one in presets] == ["rubber_youngs_10000", "rubber_youngs_100000"]
    _, presets = parse_request((FELT,), None, SWEEP)
    assert [one.name for one in presets] == ["felt_youngs_10000", "felt_youngs_100000"]
    assert [one.material(0.1).density for one in presets] == [250.0, 250.0]


def test_a_sweep_varies_one_material() -> None:
    assert refusal("rubber,jelly", None, SWEEP) == (
        "--material-sweep varies one material, and 2 were given",
        "give one",
    )
