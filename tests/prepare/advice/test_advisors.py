"""Advisors as plug-ins: found by entry point, called, and refused with a message."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from gf_usd.core.errors import BakeError, UsageError
from gf_usd.core.stage import Advice, Subject
from gf_usd.prepare.advice import Question, advisors
from gf_usd.prepare.advice.advisors import GROUP, ask_advisor, find_advisor

PLUGIN = """
from gf_usd.prepare.advice import Advice
from gf_usd.core.errors import BakeError

def one(path, **changed):
    said = {"material": "jelly", "confidence": 0.9, "reason": "x", **changed}
    return Advice(path=path, **said)

def good(question):
    return [one(s.path) for s in reversed(question.subjects)]

def unsure(question):
    return [one(s.path, confidence=0.1) for s in question.subjects]

class Odd(Exception):
    pass

def raises(question):
    raise Odd("no idea")

def leaves(question):
    raise SystemExit(0)

def says(question):
    raise BakeError("the model is out", "wake it")
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Install a distribution with these entry points, for this test alone."""

    def install(code: str, number: int = 0, **points: str) -> None:
        site = tmp_path / f"site{number}"
        info = site / f"plugged{number}-1.0.dist-info"
        info.mkdir(parents=True)
        module = f"plugged_{number}"
        (site / f"{module}.py").write_text(code, encoding="utf-8")
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: plugged{number}\nVersion: 1.0\n", encoding="utf-8"
        )
        lines = "\n".join(f"{name} = {module}:{value}" for name, value in points.items())
        (info / "entry_points.txt").write_text(f"[{GROUP}]\n{lines}\n", encoding="utf-8")
        monkeypatch.syspath_prepend(str(site))
        monkeypatch.delitem(sys.modules, module, raising=False)

    yield install
    for name in [name for name in sys.modules if name.startswith("plugged_")]:
        del sys.modules[name]


QUESTION = Question(
    file=Path("car.usda"),
    subjects=(Subject(path="/a"), Subject(path="/b")),
    presets={"rubber": "bounces", "jelly": "wobbles"},
    picture=b"",
)


def test_the_answer_comes_in_the_order_of_the_subjects_with_the_advisors_name(installed):
    installed(PLUGIN, mine="good")
    answer = {"material": "jelly", "confidence": 0.9, "reason": "x", "by": "mine"}
    assert ask_advisor("mine", QUESTION) == (
        Advice(path="/a", **answer),
        Advice(path="/b", **answer),
    )


def test_an_unsure_answer_becomes_rubber(installed):
    installed(PLUGIN, mine="unsure")
    assert [a.material for a in ask_advisor("mine", QUESTION)] == ["rubber", "rubber"]
    assert "jelly is too uncertain, 0.10 < 0.3" in ask_advisor("mine", QUESTION)[0].chosen


def test_an_unknown_name_lists_those_that_are_there(installed):
    installed(PLUGIN, mine="good", other="good")
    with pytest.raises(UsageError, match="no material advisor 'yours'") as error:
        find_advisor("yours")
    assert error.value.hint.startswith("give one of mine, other; install another (")


def test_without_advisors_the_hint_is_to_install_one():
    with pytest.raises(UsageError, match="no material advisor 'yours'") as error:
        find_advisor("yours")
    assert error.value.hint.startswith("no advisor is installed; install one (")


def test_two_advisors_of_one_name_are_refused(installed):
    installed(PLUGIN, mine="good")
    installed(PLUGIN, 1, mine="good")
    with pytest.raises(UsageError, match="2 advisors are named 'mine'"):
        find_advisor("mine")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("raises", "car.usda: the material advisor 'mine' failed: Odd: no idea"),
        ("leaves", "failed: SystemExit"),
        ("says", "failed: the model is out"),
        ("absent", "failed: AttributeError"),
    ],
)
def test_a_failing_advisor_is_an_error_in_words(installed, entry, message):
    installed(PLUGIN, mine=entry)
    with pytest.raises(BakeError) as error:
        ask_advisor("mine", QUESTION)
    assert message in error.value.message
    assert error.value.hint == "wake it" or "--material auto" in error.value.hint


WRONG = {
    "None": "answered with a NoneType",
    "['x']": "with a str in the list",
    "[one('/a')]": "did not answer for </b>",
    "[one('/a'), one('/b'), one('/c')]": "answered for </c>, which was not in the question",
    "[one('/a'), one('/a'), one('/b')]": "answered 2 times for </a>",
    "[one('/a', material='wood'), one('/b')]": "named 'wood' for </a>, which is not a preset",
    "[one('/a', confidence=1.5), one('/b')]": "is 1.5, not a number from 0 to 1",
    "[one('/a', confidence=float('nan')), one('/b')]": "is nan, not a number",
    "[one('/a', confidence='high'), one('/b')]": "is 'high', not a number",
    "[one('/a', reason=' '), one('/b')]": "gave no reason for </a>",
}


@pytest.mark.parametrize("answer", WRONG)
def test_a_wrong_answer_is_an_error_in_words(installed, answer):
    installed(f"{PLUGIN}\ndef wrong(question):\n    return {answer}\n", mine="wrong")
    with pytest.raises(BakeError, match="gave a wrong answer") as error:
        ask_advisor("mine", QUESTION)
    assert WRONG[answer] in error.value.message


def test_an_advisor_that_hangs_is_given_up(installed, monkeypatch):
    monkeypatch.setattr(advisors, "TIMEOUT", 0.05)
    gate = threading.Event()
    monkeypatch.setattr(sys, "gate_of_the_test", gate, raising=False)
    installed("import sys\ndef hang(question):\n    sys.gate_of_the_test.wait(60)\n", mine="hang")
    with pytest.raises(BakeError, match=r"gave no answer in 0\.05 s"):
        ask_advisor("mine", QUESTION)
    gate.set()
