"""Error classes, and numbers with their nouns in messages."""

from __future__ import annotations

import copy
import pickle

import pytest

from gf_usd.core import errors
from gf_usd.core.errors import (
    GfUsdError,
    agreed,
    counted,
    did_you_mean,
    listed,
    listed_paths,
    meant,
    similar,
)

RAISED = [
    *(kind("it is wrong", "mend it") for kind in (GfUsdError, errors.UsageError, errors.BakeError)),
    errors.Unfinished("a slice is done", "go on", variant="rubber", done=3, frames=9),
    errors.OutOfResources("no space is left", "free some", frame=4, particle=7),
    errors.UnhealthyError("it has warnings", "heed them", warnings=("energy",), result=None),
]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((0, "error"), "0 errors"),
        ((1, "error"), "1 error"),
        ((2, "error"), "2 errors"),
        ((1, "mesh", "meshes"), "1 mesh"),
        ((3, "mesh", "meshes"), "3 meshes"),
    ],
)
def test_a_noun_agrees_with_its_number(arguments: tuple[int, str], text: str) -> None:
    assert counted(*arguments) == text


@pytest.mark.parametrize("error", RAISED, ids=[type(error).__name__ for error in RAISED])
def test_an_error_passes_between_processes(error: GfUsdError) -> None:
    """As the pools of `multiprocessing` and `concurrent.futures` pass it, with all its fields."""
    for same in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(same) is type(error)
        assert vars(same) == vars(error)
        assert (str(same), same.args) == (str(error), error.args)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("ruber", "did you mean rubber? "),
        ("RUBBER", "did you mean rubber? "),
        ("/ball/low", "did you mean /Ball/Low? "),
        ("granite", ""),
    ],
)
def test_hints_name_what_is_similar(name: str, hint: str) -> None:
    """Fourteen places compared names differently, some with regard to case."""
    assert did_you_mean(name, ["rubber", "metal", "/Ball/Low"]) == hint


def test_several_similar_names_are_nearest_first() -> None:
    found = similar("ball", ["Balls", "Ball", "bell", "cube"], most=3)
    assert found == ["Ball", "Balls", "bell"]
    assert meant(found[:2]) == "did you mean Ball or Balls? "
    assert meant([]) == ""


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "they are open, as are meshes"), (1, "it is open, as is a mesh"),
     (2, "they are open, as are meshes")],
)  # fmt: skip
def test_agreed_chooses_the_singular_or_the_plural(count: int, text: str) -> None:
    assert agreed(count, "[it is/they are] open, as [is a mesh/are meshes]") == text


def test_long_lists_are_cut() -> None:
    assert listed([]) == ""
    assert listed(["a", "b"], 2) == "a, b"
    assert listed(["a", "b", "c"], 2) == "a, b and 1 more"
    assert listed(["a", "b", "c"], 1, "; ") == "a; and 2 more"
    assert listed_paths(["/A", "/B"], 1) == "</A> and 1 more"
