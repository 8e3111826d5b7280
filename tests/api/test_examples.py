"""The examples in the docstrings of the public names run as they stand."""

from __future__ import annotations

import contextlib
import doctest
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from slow_parameters import longest_but

import gf_usd

SAMPLES = Path(__file__).parents[2] / "samples"
PUBLIC = [name for name in gf_usd.__all__ if not name.startswith("_")]


def examples(name: str) -> list[doctest.Example]:
    return doctest.DocTestParser().get_examples(getattr(gf_usd, name).__doc__ or "")


WITH_EXAMPLES = [name for name in PUBLIC if examples(name)]
FUNCTIONS = [name for name in PUBLIC if name[0].islower()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("examples")
    shutil.copy(SAMPLES / "duck.usda", made)
    return made


@pytest.fixture(scope="module")
def result(folder: Path) -> gf_usd.BakeResult:
    """What the example at the top of the package bakes."""
    known: dict[str, Any] = {}
    with contextlib.chdir(folder):
        run(gf_usd.__doc__ or "", known)
    made = known["result"]
    return replace(made, root=folder / made.root)


def scene() -> gf_usd.Scene:
    """What the example of `Scene` builds."""
    known: dict[str, Any] = {"gf_usd": gf_usd}
    run(gf_usd.Scene.__doc__ or "", known)
    return known["scene"]


def run(text: str, known: dict[str, Any]) -> None:
    test = doctest.DocTest(doctest.DocTestParser().get_examples(text), {}, "", None, None, None)
    test.globs = known
    messages: list[str] = []
    done = doctest.DocTestRunner().run(test, out=messages.append, clear_globs=False)
    assert done.failed == 0, "".join(messages)


@pytest.mark.parametrize(
    "name", longest_but(WITH_EXAMPLES, *(name for name in WITH_EXAMPLES if name != "fit"))
)
def test_the_examples_of_a_name_run(
    name: str, folder: Path, result: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    run(getattr(gf_usd, name).__doc__ or "", {"gf_usd": gf_usd, "result": result, "scene": scene()})


def test_every_function_has_an_example() -> None:
    assert [name for name in FUNCTIONS if name not in WITH_EXAMPLES] == []
