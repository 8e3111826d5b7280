"""The board: where jobs stand, and how long the rest may take."""

from __future__ import annotations

from typing import Any

import pytest

from gf_usd.batch.board import Board
from gf_usd.cli.batch.console import openjd_lines, plain_lines


class Clock:
    """Time that passes only where a test advances it."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def ended(job: str, state: str, seconds: float, message: str = "") -> dict[str, Any]:
    return {
        "event": "finished", "job": job, "state": state, "seconds": seconds, "message": message,
        "frames_per_second": 2.0,
    }  # fmt: skip


def test_it_follows_a_job_and_foresees_the_end() -> None:
    clock = Clock()
    board = Board(["a", "b", "c", "d", "e"], at_once=2, clock=clock)
    assert board.left is None
    for name in "ab":
        board.handle({"event": "started", "job": name, "attempt": 1})
    clock.now = 10.0
    board.handle({"event": "frame", "job": "a", "done": 1, "total": 4, "frames_per_second": 0.5})
    assert board.rows["a"].left == pytest.approx(6.0)
    assert board.share == pytest.approx(0.25 / 5)
    board.handle(ended("b", "done", 10.0))
    # a has had its ten seconds, the other three take ten each, two at a time
    assert board.left == pytest.approx(15.0)
    board.handle(ended("c", "kept", 0.0))
    assert board.left == pytest.approx(10.0)
    assert [row.name for row in board.ended] == ["b", "c"]
    assert board.failed == []
    board.handle(ended("a", "failed", 12.0, "why\nand more"))
    assert [row.name for row in board.failed] == ["a"]
    assert board.seconds == pytest.approx(10.0)


def test_what_comes_late_changes_no_end() -> None:
    board = Board(["a"], at_once=1)
    board.handle(ended("a", "done", 1.0))
    board.handle({"event": "frame", "job": "a", "done": 1, "total": 4, "frames_per_second": 0.5})
    board.handle({"event": "started", "job": "a", "attempt": 2})
    assert board.rows["a"].state == "done"


def test_lines_say_ends_and_new_attempts() -> None:
    board = Board(["a", "b"], at_once=1)
    retry = {"event": "retry", "job": "a", "attempt": 1, "why": "the bake was ended by SIGKILL"}
    assert plain_lines(board, retry, board.handle(retry)) == [
        "a: trying again: the bake was ended by SIGKILL"
    ]
    fault = ended("a", "refused", 2.0, "it is damaged\nat line 3")
    assert plain_lines(board, fault, board.handle(fault)) == [
        "[1/2] a: refused: it is damaged, about 2 s left"
    ]
    kept = ended("b", "kept", 0.0)
    assert plain_lines(board, kept, board.handle(kept)) == ["[2/2] b: kept"]


def test_openjd_lines_are_those_of_its_specification() -> None:
    board = Board(["a", "b"], at_once=1)
    started = {"event": "started", "job": "a", "attempt": 1}
    frame = {"event": "frame", "job": "a", "done": 2, "total": 4, "frames_per_second": 1.0}
    end = ended("a", "done", 2.0)
    printed = [openjd_lines(board, event, board.handle(event)) for event in (started, frame, end)]
    assert printed == [
        ["openjd_progress: 0.0", "openjd_status: 0 of 2 done; a: running"],
        ["openjd_progress: 25.0", "openjd_status: 0 of 2 done; a: frame 2 of 4"],
        ["openjd_progress: 50.0", "openjd_status: 1 of 2 done; a: done"],
    ]
