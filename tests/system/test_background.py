"""Work in the background: one piece at a time, and what it raises is heard."""

from __future__ import annotations

import threading

import pytest

from gf_usd.core.errors import BakeError
from gf_usd.system.background import BackgroundWriter, running_threads


def test_work_continues_while_the_caller_does() -> None:
    gate, done = threading.Event(), []
    writer = BackgroundWriter()
    before = running_threads()
    writer.start(lambda: done.append(gate.wait(10.0)))
    assert writer.busy
    assert running_threads() == before + 1
    assert done == []
    gate.set()
    writer.settle()
    assert done == [True]
    assert not writer.busy
    assert running_threads() == before
    writer.settle()  # nothing to wait for


def test_one_piece_at_a_time() -> None:
    gate = threading.Event()
    writer = BackgroundWriter()
    writer.start(gate.wait)
    with pytest.raises(AssertionError, match="not waited for"):
        writer.start(gate.wait)
    gate.set()
    writer.settle()


def test_what_it_raises_is_raised_once_and_by_settle() -> None:
    def fails() -> None:
        raise BakeError("the disk is full.", "free some space")

    writer = BackgroundWriter()
    writer.start(fails)
    with pytest.raises(BakeError, match="the disk is full"):
        writer.settle()
    writer.settle()
    assert running_threads() == 0
    writer.start(lambda: None)
    writer.settle()
