"""gf-usd verify: the table, the JSON, the exit status."""

from __future__ import annotations

import json

import pytest

from gf_usd.verify import registry
from gf_usd.verify.case import Case, Measure


def figure(value: float) -> list[Measure]:
    return [Measure(name="m", value=value, target=1.0, bound=0.1, why="a test", unit="m")]


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> None:
    """A registry of a case that passes and one whose full form passes only."""
    cases = (
        Case(name="good", what="Right.", source="a book", quick=lambda device: figure(1.0)),
        Case(
            name="bad", what="Wrong.", source="another", quick=lambda device: figure(2.0),
            full=lambda device: figure(1.05),
        ),
    )  # fmt: skip
    monkeypatch.setattr(registry, "CASES", cases)


def test_a_real_case_on_production_kernels(gf_usd) -> None:
    done = gf_usd("verify", "--case", "skin-turn", "--json")
    assert done.status == 0
    out = json.loads(done.out)
    assert list(out) == ["cases"]
    assert [row["name"] for row in out["cases"]] == ["skin-turn.embed", "skin-turn.idw"]
    for row in out["cases"]:
        assert {"name", "value", "target", "error", "bound", "pass", "source", "why"} <= set(row)
        assert row["pass"] is True


@pytest.mark.usefixtures("two")
def test_the_table_shows_every_figure_and_the_verdict(gf_usd) -> None:
    done = gf_usd("verify", "--jobs", "1")
    assert done.status == 1
    assert "\x1b" not in done.out
    good, bad = (
        next(row for row in done.out.splitlines() if n in row) for n in ("good.m", "bad.m")
    )
    assert good.split() == ["good.m", "1", "m", "1", "0", "0.1", "pass", "a", "book"]
    assert bad.split() == ["bad.m", "2", "m", "1", "1", "0.1", "FAIL", "another"]
    assert "1 of 2 figures failed: bad.m" in done.err


@pytest.mark.usefixtures("two")
def test_full_takes_the_full_form(gf_usd) -> None:
    done = gf_usd("verify", "--full", "--json", "--jobs", "1")
    assert done.status == 0
    assert [row["value"] for row in json.loads(done.out)["cases"]] == [1.0, 1.05]


@pytest.mark.usefixtures("two")
def test_a_case_by_name(gf_usd) -> None:
    assert gf_usd("verify", "--case", "good").status == 0
    assert gf_usd("verify", "--case", "bad").status == 1


@pytest.mark.usefixtures("two")
def test_list_runs_nothing(gf_usd) -> None:
    done = gf_usd("verify", "--list")
    assert done.status == 0
    assert "good: Right." in done.out
    assert "source: another" in done.out
    made = json.loads(gf_usd("verify", "--list", "--json").out)["cases"]
    assert [case["full"] for case in made] == [False, True]


def test_wrong_words_are_usage_errors(gf_usd) -> None:
    done = gf_usd("verify", "--case", "free-fal")
    assert done.status == 2
    assert "did you mean free-fall?" in done.err
    assert gf_usd("verify", "--case", "free-fall", "--device", "tpu").status == 2


@pytest.mark.slow
@pytest.mark.acceptance
def test_cases_in_processes_are_what_they_are_in_one(gf_usd) -> None:
    arguments = ("verify", "--case", "thin", "--case", "inertia", "--case", "uniaxial", "--json")
    one, two = (gf_usd(*arguments, "--jobs", number) for number in ("1", "2"))
    assert one.status == two.status == 0
    figures = [
        [{k: v for k, v in row.items() if k != "seconds"} for row in json.loads(done.out)["cases"]]
        for done in (one, two)
    ]
    assert figures[0] == figures[1]
    assert [line.split()[1] for line in two.err.splitlines()[:3]] == [
        "thin:", "inertia:", "uniaxial:"
    ]  # fmt: skip
