"""The stages of the sand castle and of the snowball: valid, made by their tool, and what flows."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd, UsdValidation

import gf_usd
from tools.samples.flowing import write_sandcastle, write_snowball

SAMPLES = Path(__file__).resolve().parents[2] / "samples"


@pytest.mark.parametrize("name", ["sandcastle", "snowball"])
def test_the_stage_is_valid_and_what_the_tool_writes(tmp_path: Path, name: str) -> None:
    stage = Usd.Stage.Open(str(SAMPLES / f"{name}.usda"))
    context = UsdValidation.ValidationContext(
        UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    )
    assert [error.GetMessage() for error in context.Validate(stage)] == []
    again = tmp_path / f"{name}.usda"
    if name == "sandcastle":
        write_sandcastle(again, "./duck.usda")
    else:
        write_snowball(again)
    assert again.read_bytes() == (SAMPLES / again.name).read_bytes()


def test_the_castle_flows_and_the_duck_holds_together() -> None:
    plan = gf_usd.inspect(SAMPLES / "sandcastle.usda", particles=800).plan
    assert plan is not None
    assert plan.settings.solver == "mixed"
    assert plan.choices.flowing == tuple(f"/SandCastle/Castle/Tower{k}" for k in range(5))
    assert list(plan.points) == ["/SandCastle/Duck/Geom/Body"]


def test_the_snowball_meets_the_bowl() -> None:
    plan = gf_usd.inspect(SAMPLES / "snowball.usda", particles=300).plan
    assert plan is not None
    assert plan.settings.solver == "ul"
    assert plan.contact_setup is not None
    assert [c.path for c in plan.contact_setup.colliders] == ["/Snowball/Bowl", "/Snowball/Ground"]
