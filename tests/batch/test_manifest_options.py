"""Options of a manifest against those of the command that bakes."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer.main

from gf_usd.batch.job import Job
from gf_usd.batch.manifest import KNOWN, clean, parse, result_options
from gf_usd.cli.main import program
from gf_usd.core.errors import UsageError

VALUES = {int: 3, float: 0.5, str: "x", bool: True}


def test_every_option_is_one_of_the_command() -> None:
    bake = typer.main.get_command(program()).commands["bake"]  # type: ignore[attr-defined]
    there = {word for p in bake.params for word in (*p.opts, *p.secondary_opts)}
    for name, option in KNOWN.items():
        value = ["/A", "/B"] if option.repeated else VALUES[option.kind]
        job = Job(name="a", asset=Path("a"), root=Path("a.usda"), options={name: value})
        flags = [word for word in job.arguments()[4:] if word.startswith("--")]
        assert flags, name
        assert set(flags) <= there, name
    assert {name for name, option in KNOWN.items() if option.two_way} == {"wls", "self_contact"}
    indifferent = {name for name, option in KNOWN.items() if not option.decides}
    assert indifferent == {"strict", "max_hours", "threads", "limits"}


def test_what_does_not_decide_is_left_out_of_the_identity() -> None:
    options = {"threads": 2, "strict": True, "seed": 3}
    assert result_options(options) == {"material": "rubber", "seed": 3}


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("particles", "12", 12),
        ("frames", "rest:12", "rest:12"),
        ("fps", "23.976", 23.976),
        ("wls", "false", False),
        ("drop", "3r", "3r"),
    ],
)
def test_words_become_values(name: str, text: str, value: object) -> None:
    found = parse(name, text, "--set")
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("only", ["mesh", "points"], "mesh,points"),
        ("floor", False, "none"),
        ("gravity", [0, -1.62, 0], "0,-1.62,0"),
        ("range", [1, 24], "1:24"),
        ("stress_cap", False, "none"),
    ],
)
def test_values_of_python_are_those_of_a_manifest(name: str, value: object, text: str) -> None:
    assert clean({name: value}, "here", Path()) == {name: text}


def test_a_value_that_python_does_not_take_is_refused() -> None:
    with pytest.raises(UsageError, match="here: drop is False, of type bool") as caught:
        clean({"drop": False}, "here", Path())
    assert (caught.value.hint or "").startswith("give a length such as 2.5")
    with pytest.raises(UsageError, match="here: only is 3, of type int"):
        clean({"only": [3]}, "here", Path())


def test_a_word_that_is_no_number_is_refused() -> None:
    with pytest.raises(UsageError, match="'many' is not of type int"):
        parse("particles", "many", "--set")
    with pytest.raises(UsageError, match="repair is 'yes'"):
        clean({"repair": parse("repair", "yes", "--set")}, "here", Path())


def test_the_flag_of_an_option_leads_to_its_name():
    for given, meant in (("pin", "pins"), ("material-box", "material_boxes"), ("frame", "frames")):
        with pytest.raises(UsageError) as caught:
            clean({given: "/A"}, "here", Path())
        assert (caught.value.hint or "").startswith(f"did you mean {meant}? the options are ")


def test_limits_reach_the_bake_and_do_not_decide_what_it_writes() -> None:
    options = clean({"limits": "time=60,memory=4G"}, "here", Path())
    job = Job(name="a", asset=Path("a"), root=Path("a.usda"), options=options)
    assert job.arguments()[-2:] == ["--limits", "time=60,memory=4G"]
    assert result_options(options) == {"material": "rubber"}
    with pytest.raises(UsageError, match="here: --limits 'time=0': 'time=0' is not a limit"):
        clean({"limits": "time=0"}, "here", Path())
