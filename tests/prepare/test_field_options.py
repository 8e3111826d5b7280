"""--field and files of keys for --gravity: what they say, and what is refused in which words."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_bakes import BLOCK

from gf_usd.core.errors import GfUsdError, UsageError
from gf_usd.core.frames.settings import Field
from gf_usd.prepare.options.fields import in_meters, parse_field, read_gravity_keys
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.prepare import prepare


def test_a_text_is_a_field() -> None:
    assert parse_field("wind:3,0,-1") == Field(kind="wind", vector=(3.0, 0.0, -1.0))
    found = parse_field("radial:-5:at=0,1,0:radius=0.5")
    assert found == Field(kind="radial", strength=-5.0, center=(0.0, 1.0, 0.0), radius=0.5)
    noise = in_meters(parse_field("noise:4:length=20:rate=1.5:at=0,100,0:radius=50"), 0.01)
    assert noise == Field(
        kind="noise", strength=4.0, length=0.2, rate=1.5, center=(0.0, 1.0, 0.0), radius=0.5
    )


@pytest.mark.parametrize(
    "text",
    [
        *("", "wind", "wind:1,2", "wind:nan,0,0", "wind:1e99,0,0", "gale:1,0,0"),
        *("radial:5", "radial:5:at=0,0", "noise:1", "noise:1:length=0", "noise:1:length=-1"),
        *("wind:1,0,0:radius=1", "wind:1,0,0:at", "wind:1,0,0:speed=1"),
    ],
)
def test_what_is_no_field_is_refused(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        Request.of({"fields": (text,)}).check()
    assert "--field" in caught.value.message
    assert caught.value.hint


def test_a_file_of_keys(tmp_path: Path) -> None:
    path = tmp_path / "keys.csv"
    path.write_text("# time code, gravity\n1, 9.81\n\n12.5, 0, -3, 1  # sideways\n")
    keys = read_gravity_keys(path)
    assert keys.times == (1.0, 12.5)
    assert keys.values == (9.81, (0.0, -3.0, 1.0))
    block = tmp_path / "block.usda"
    block.write_text(BLOCK)
    plan, _ = prepare(block, draw=None, particles=100, gravity=str(path), fields=("wind:1,0,0",))
    moving, wind = plan.settings.fields
    up = plan.asset.facts.up
    assert plan.settings.gravity == pytest.approx(tuple(-9.81 * up))
    assert moving.values == (pytest.approx(tuple(-9.81 * up)), (0.0, -3.0, 1.0))
    assert (moving.kind, moving.times, wind.kind) == ("gravity", (1.0, 12.5), "wind")


def test_a_negative_number_of_gravity_points_up_with_a_note(tmp_path: Path) -> None:
    block = tmp_path / "block.usda"
    block.write_text(BLOCK)
    up, _ = prepare(block, draw=None, particles=100, gravity="-9.81")
    assert up.settings.gravity == pytest.approx(tuple(9.81 * up.asset.facts.up))
    expected = "gravity of -9.81 m/s^2 points up: numbers above 0 point down"
    assert expected in up.notes
    down, _ = prepare(block, draw=None, particles=100, gravity="9.81")
    vector, _ = prepare(block, draw=None, particles=100, gravity="0,9.81,0")
    assert not [note for note in (*down.notes, *vector.notes) if "points up" in note]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no line"),
        ("1,2,3\n", "line 1 has 3 numbers"),
        ("2,9\n1,9\n", "line 2: time code 1 follows 2"),
        ("1,x\n", "line 1"),
        ("1,1e30\n", "line 1 has 1e+30"),
    ],
)
def test_a_file_that_holds_no_keys_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "keys.txt"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        Request.of({"gravity": str(path)}).check()
    assert message in caught.value.message
    assert str(path) in caught.value.message
    assert caught.value.hint


def test_a_missing_file_and_what_knows_no_fields_are_refused(tmp_path: Path) -> None:
    for options, message in (
        ({"gravity": str(tmp_path / "gone.csv")}, "cannot be read"),
        ({"fields": ("wind:1,0,0",), "rigid": ("box:0,0,0,1,1,1",)}, "cannot be combined with"),
        ({"fields": ("wind:1,0,0",), "solver": "ul"}, "--solver ul does not support --field"),
    ):
        with pytest.raises(UsageError) as caught:
            Request.of(options).check()
        assert message in caught.value.message


def test_time_samples_of_a_scene_are_keys(tmp_path: Path) -> None:
    path = tmp_path / "block.usda"
    path.write_text(
        BLOCK
        + """
def PhysicsScene "Scene"
{
    vector3f physics:gravityDirection = (0, 0, -1)
    float physics:gravityMagnitude.timeSamples = { 1: 10, 13: 2 }
}
"""
    )
    options = {"particles": 100, "output": tmp_path / "out.usda"}
    plan, _ = prepare(path, draw=None, **options)
    (field,) = plan.settings.fields
    unit = plan.asset.facts.units.length
    assert field.times == (1.0, 13.0)
    assert field.values == (
        pytest.approx((0.0, 0.0, -10.0 * unit)), pytest.approx((0.0, 0.0, -2.0 * unit)),
    )  # fmt: skip
    assert "and 2 time samples" in " ".join(plan.notes)
    plan, _ = prepare(path, draw=None, gravity="9.81", **options)
    assert not plan.settings.fields


SCENE = """
def PhysicsScene "Scene"
{
    SAID
}
"""


def test_fields_of_a_scene_count_where_no_option_is_given(tmp_path: Path) -> None:
    path = tmp_path / "block.usda"
    authored = 'string[] gaussianFlesh:fields = ["wind:3,0,0", "noise:2:length=0.5"]'
    path.write_text(BLOCK + SCENE.replace("SAID", authored))
    options = {"particles": 100, "output": tmp_path / "out.usda"}
    plan, _ = prepare(path, draw=None, **options)
    assert [field.kind for field in plan.settings.fields] == ["wind", "noise"]
    assert "fields are those of </Scene>: wind:3,0,0 noise:2:length=0.5" in plan.notes
    plan, _ = prepare(path, draw=None, fields=("radial:1:at=0,0,0",), **options)
    assert [field.kind for field in plan.settings.fields] == ["radial"]
    with pytest.raises(
        UsageError, match="has fields, which --rigid and --solver ul do not support"
    ):
        prepare(path, draw=None, solver="ul", **options)


@pytest.mark.parametrize(
    ("authored", "message"),
    [
        ('string gaussianFlesh:fields = "wind:3,0,0"', "gaussianFlesh:fields is 'wind:3,0,0'"),
        ('string[] gaussianFlesh:fields = ["gale:3"]', "a field of the PhysicsScene gale:3 is no"),
    ],
)
def test_fields_of_a_scene_that_are_none_are_refused(
    tmp_path: Path, authored: str, message: str
) -> None:
    path = tmp_path / "block.usda"
    path.write_text(BLOCK + SCENE.replace("SAID", authored))
    with pytest.raises(GfUsdError) as caught:
        prepare(path, draw=None, particles=100, output=tmp_path / "out.usda")
    assert message in caught.value.message
    assert str(path) in caught.value.message
    assert caught.value.hint
