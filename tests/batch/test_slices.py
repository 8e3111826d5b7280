"""Jobs in slices: how many, what an earlier one settled, and how a run of them ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from batch_jobs import job, outcome

from gf_usd.batch.board import Board
from gf_usd.batch.record import write_record
from gf_usd.batch.slices import (
    Part,
    exit_status,
    failing_outcomes,
    final_outcome,
    parse_part,
    slice_count,
    time_spent,
)
from gf_usd.core.errors import UsageError


@pytest.mark.parametrize(
    ("options", "clips", "runs"),
    [
        # 24 clips: the last run ends with the last of them
        ({"frames": 25, "clip_frames": 1}, 24, 1),
        ({"frames": 25, "clip_frames": 1}, 8, 3),
        ({"frames": 25, "clip_frames": 1}, 9, 3),
        # 4 clips of 6 frames and one frame more, which a run of its own writes
        ({"frames": 26, "clip_frames": 6}, 4, 2),
        ({"frames": 26, "clip_frames": 6}, 2, 3),
        ({"frames": 26, "clip_frames": 6}, 3, 2),
        # never a full clip
        ({"frames": 5, "clip_frames": 6}, 2, 1),
        # two variants, one after the other
        ({"frames": 25, "clip_frames": 6, "material": "rubber,jelly"}, 2, 4),
        # handles are written as well
        ({"frames": 25, "clip_frames": 6, "handles": 12}, 2, 4),
    ],
)
def test_a_job_takes_so_many_runs(
    tmp_path: Path, options: dict[str, Any], clips: int, runs: int
) -> None:
    assert slice_count(job(tmp_path, **options), clips) == runs


@pytest.mark.parametrize(
    ("options", "message"),
    [({"frames": 9}, "counts value clips"), ({"clip_frames": 2}, "depends on the number of frames"),
     ({"frames": 9, "clip_frames": 0}, "counts value clips")],
)  # fmt: skip
def test_what_cannot_be_counted_is_refused(
    tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=rf"^a\.rubber: .*{message}"):
        slice_count(job(tmp_path, **options), 1)


def test_parts_are_counted_from_one() -> None:
    assert parse_part(" 2/5", 4) == Part(number=2, of=5)
    assert parse_part("5/5", 4).last
    for text in ("0/2", "3/2", "2", "2/", "a/b"):
        with pytest.raises(UsageError, match="--part is"):
            parse_part(text, 4)
    with pytest.raises(UsageError, match="without --slice"):
        parse_part("1/2", None)


def test_only_the_last_part_minds_what_is_not_done() -> None:
    ends = [outcome(s, s) for s in ("done", "kept", "sliced", "failed", "refused", "crashed")]
    middle, last = Part(number=1, of=2), Part(number=2, of=2)
    assert failing_outcomes(ends, middle) == []
    assert exit_status(ends, middle) == 0
    assert [o.state for o in failing_outcomes(ends, last)] == [
        "sliced",
        "failed",
        "refused",
        "crashed",
    ]
    assert exit_status(ends, last) == 1
    # what another process may still do is to be done before the next part
    for state in ("stopped", "busy"):
        assert exit_status([*ends, outcome("x", state)], middle) == 1
    # alone, a run says whether there is more to do, or something to look at
    assert exit_status(ends[:2], None) == 0
    assert exit_status(ends[:3], None) == 5
    assert exit_status(ends, None) == 1


def test_a_slice_is_no_alarm() -> None:
    board = Board(["a"], 1)
    board.handle({"event": "started", "job": "a", "attempt": 1})
    board.handle({"event": "finished", **outcome("a", "sliced").as_json(), "job": "a"})
    assert [row.name for row in board.ended] == ["a"]
    assert board.failed == []


def test_what_an_earlier_slice_settled_is_not_begun_again(tmp_path: Path) -> None:
    sliced = job(tmp_path)
    sliced.root.parent.mkdir()

    def record(state: str) -> None:
        made = outcome(sliced.name, state, seconds=2.0, cpu_seconds=3.0)
        write_record(sliced, made, identity="x", description={})

    assert final_outcome(sliced, "x") is None
    for state in ("failed", "refused", "unsound"):
        record(state)
        final = final_outcome(sliced, "x")
        assert final is not None
        assert final.state == state
        assert final_outcome(sliced, "y") is None, "it would be another bake"
        assert final_outcome(sliced, None) is None, "it has not ended"
    record("crashed")
    assert final_outcome(sliced, "x") is None
    # a disk that was full then may have space now: there is something to resume from
    record("failed")
    checkpoint = sliced.sibling(".checkpoint.npz")
    checkpoint.touch()
    assert final_outcome(sliced, "x") is None
    assert time_spent(sliced, "x") == (0.0, 0.0)
    record("sliced")
    assert time_spent(sliced, "x") == (2.0, 3.0)
    assert time_spent(sliced, "y") == (0.0, 0.0)
    checkpoint.unlink()
    assert time_spent(sliced, "x") == (0.0, 0.0), "the next slice begins anew"
