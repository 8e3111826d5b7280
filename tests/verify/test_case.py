"""Measures, cases and the running of them, without a solver."""

from __future__ import annotations

import json
import math
import re

import pytest

from gf_usd.core.errors import InputError, SolverError, UsageError
from gf_usd.verify.case import AT_LEAST, RELATIVE, Case, Curve, Measure, Result, rows
from gf_usd.verify.registry import CASES, run_case, select


def measure(value: float, target: float, bound: float, **more: str) -> Measure:
    return Measure(name="m", value=value, target=target, bound=bound, why="a test", **more)


def case(run, **more) -> Case:
    return Case(name="c", what="w", source="s", quick=run, **more)


@pytest.mark.parametrize(
    ("made", "error", "passed"),
    [
        (measure(1.5, 1.0, 0.5), 0.5, True),
        (measure(1.5, 1.0, 0.49), 0.5, False),
        (measure(-1.5, -2.0, 0.25, kind=RELATIVE), 0.25, True),
        (measure(-1.4, -2.0, 0.25, kind=RELATIVE), 0.3, False),
        (measure(2.5, 2.0, 0.0, kind=AT_LEAST), 0.0, True),
        (measure(1.8, 2.0, 0.1, kind=AT_LEAST), 0.2, False),
    ],
)
def test_the_error_is_what_the_kind_says(made: Measure, error: float, passed: bool) -> None:
    assert made.error == pytest.approx(error, rel=1e-12)
    assert made.passed is passed


@pytest.mark.parametrize("kind", ["absolute", RELATIVE, AT_LEAST])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_fails(kind: str, value: float) -> None:
    made = measure(value, 1.0, 1e300, kind=kind)
    # An infinite figure is more than any least, and beyond every other bound.
    assert made.passed is (kind == AT_LEAST and value == math.inf)
    result = Result(case=case(None), measures=(made,), seconds=0.0)
    (row,) = json.loads(json.dumps(rows(result), allow_nan=False))
    assert row["value"] is None


def test_rows_have_the_documented_keys() -> None:
    curve = Curve(title="t", x_label="x", y_label="y", x=(1.0, 2.0), y=(3.0, 4.0))
    made = Measure(name="m", value=1.0, target=1.0, bound=0.1, why="because", curve=curve)
    (row,) = rows(Result(case=case(None), measures=(made,), seconds=1.5))
    assert {"name", "value", "target", "error", "bound", "pass"} < set(row)
    assert row["name"] == "c.m"
    assert row["pass"] is True
    assert row["why"] == "because"
    assert json.loads(json.dumps(row))["curve"]["y"] == [3.0, 4.0]


def test_full_runs_the_full_form_where_there_is_one() -> None:
    both = case(lambda d: [measure(1.0, 1.0, 0.0)], full=lambda d: [measure(2.0, 2.0, 0.0)])
    assert run_case(both).measures[0].value == 1.0
    assert run_case(both, full=True).measures[0].value == 2.0
    assert run_case(case(both.quick), full=True).measures[0].value == 1.0


def test_the_device_reaches_the_case() -> None:
    seen = []
    run_case(case(lambda device: seen.append(device) or []), device="cuda")
    assert seen == ["cuda"]


def test_a_solver_that_gives_up_is_a_figure_that_fails() -> None:
    def run(device: str):
        yield measure(1.0, 1.0, 0.0)
        raise SolverError("frame 3: energy rose", "less", frame=3)

    result = run_case(case(run))
    assert not result.passed
    assert "energy rose" in result.measures[-1].why


def test_other_errors_are_not_swallowed() -> None:
    def run(device: str):
        raise InputError("wrong", "right")

    with pytest.raises(InputError):
        run_case(case(run))


def test_cases_are_chosen_by_name() -> None:
    assert select() == CASES
    assert [c.name for c in select(["patch", "free-fall"])] == ["free-fall", "patch"]
    with pytest.raises(UsageError) as error:
        select(["free-fal"])
    assert "did you mean free-fall?" in error.value.hint


def test_the_registry_covers_what_was_asked_for() -> None:
    names = [c.name for c in CASES]
    assert len(set(names)) == len(names)
    assert {
        "free-fall", "momentum", "spin", "spin-apic", "patch", "patch-f64", "skin-turn", "bar",
        "vertical", "cantilever", "locking", "manufactured", "bounce", "penetration", "drop",
        "solvers", "law-corotated", "law-neoHookean",
    } <= set(names)  # fmt: skip
    assert all(c.what.endswith(".") and c.source for c in CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_numbers_in_texts_have_a_digit_before_the_point(case: Case) -> None:
    assert not re.search(r"(?<![\w.])\.\d", f"{case.what} {case.source}")
