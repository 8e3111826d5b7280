"""Work beside the main thread: one piece at a time, and what it raises is heard."""

from __future__ import annotations

import threading

import pytest

from gf_usd.core.errors import BakeError
from gf_usd.system.background import Beside, at_work


def test_work_goes_on_while_the_caller_does() -> None:
    gate, said = threading.Event(), []
    beside = Beside()
    before = at_work()
    beside.start(lambda: said.append(gate.wait(10.0)))
    assert beside.busy
    assert at_work() == before + 1
    assert said == []
    gate.set()
    beside.settle()
    assert said == [True]
    assert not beside.busy
    assert at_work() == before
    beside.settle()  # nothing to wait for


def test_one_piece_at_a_time() -> None:
    gate = threading.Event()
    beside = Beside()
    beside.start(gate.wait)
    with pytest.raises(AssertionError, match="not waited for"):
        beside.start(gate.wait)
    gate.set()
    beside.settle()


def test_what_it_raises_is_raised_once_and_by_settle() -> None:
    def fails() -> None:
        raise BakeError("the disk is full.", "free some space")

    beside = Beside()
    beside.start(fails)
    with pytest.raises(BakeError, match="the disk is full"):
        beside.settle()
    beside.settle()
    assert at_work() == 0
    beside.start(lambda: None)
    beside.settle()
