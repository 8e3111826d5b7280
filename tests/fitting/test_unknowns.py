"""Unknown values of a material: coordinates, bounds, and what is refused."""

from __future__ import annotations

import pytest

from gf_usd.core.errors import UsageError
from gf_usd.core.materials.presets import find_preset, presets
from gf_usd.fitting.unknowns import starts, unknowns, value_of, values_at, with_values

RADIUS = 0.1


@pytest.mark.parametrize("name", presets())
def test_every_preset_starts_within_its_bounds(name: str) -> None:
    material = find_preset(name).material(RADIUS)
    rows = unknowns(material, RADIUS)
    assert ("yield_stress" in {row.name for row in rows}) == ("yield_stress" in material.parameters)
    for row in rows:
        assert row.low <= row.start <= row.high
        assert row.value(row.coordinate(row.start)) == pytest.approx(row.start, rel=1e-12)
        assert (row.value(0.0), row.value(1.0)) == pytest.approx((row.low, row.high))
    there = with_values(material, values_at(rows, starts(rows)))
    for row in rows:
        if value_of(material, row.name):  # a damping time of 0 begins within its bounds
            assert value_of(there, row.name) == pytest.approx(value_of(material, row.name))


def test_short_names_and_bounds() -> None:
    rubber = find_preset("rubber").material(RADIUS)
    young, poisson = unknowns(rubber, RADIUS, ["E", "nu"], {"E": (1e5, 4e5)})
    assert (young.name, young.low, young.high) == ("youngs_modulus", 1e5, 4e5)
    assert young.start == pytest.approx(2e5)  # its own 6.6e4 Pa lies outside
    assert poisson.name == "poissons_ratio"
    assert young.change == "10 %"
    assert young.value(young.change_of_z) == pytest.approx(1.1e5)


@pytest.mark.parametrize(
    ("names", "bounds", "message"),
    [
        (["youngs"], {}, "did you mean youngs_modulus"),
        (["yield_stress"], {}, "neoHookean"),
        (["E"], {"nu": (0.1, 0.2)}, "add poissons_ratio"),
        (["E"], {"E": (2.0, 1.0)}, "with the lower bound first"),
        (["E"], {"E": (0.0, 1.0)}, "above 0"),
        (["nu"], {"nu": (0.1, 0.5)}, "0.49"),
    ],
)
def test_what_makes_no_sense_is_refused(
    names: list[str], bounds: dict[str, tuple[float, float]], message: str
) -> None:
    rubber = find_preset("rubber").material(RADIUS)
    with pytest.raises(UsageError) as refused:
        unknowns(rubber, RADIUS, names, bounds)
    assert message in str(refused.value)
