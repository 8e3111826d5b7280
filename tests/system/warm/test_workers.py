"""Warm processes: commands follow each other in one, and none can harm the next."""

from __future__ import annotations

import json
import os
import select
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from warm_commands import SCRIPT

from gf_usd.system.file_locks import acquire
from gf_usd.system.processes import Children, ProcessResult
from gf_usd.system.warm.workers import Workers


@pytest.fixture
def workers() -> Iterator[Workers]:
    made = Workers(Children(), [sys.executable, "-c", SCRIPT])
    yield made
    made.close()


def run(workers: Workers, *arguments: str, **how: object) -> tuple[ProcessResult, int]:
    """How a command ended, and the process that ran it."""
    reader, writer = os.pipe()
    try:
        ended = workers.run(arguments, events=writer, **how)  # type: ignore[arg-type]
    finally:
        os.close(writer)
        with os.fdopen(reader) as file:
            text = file.read()
    assert ended is not None
    return ended, json.loads(text)["process"] if text else 0


def test_commands_follow_each_other_in_one_process(workers: Workers) -> None:
    first, one = run(workers, "spin")
    second, two = run(workers, "again")
    assert one == two
    assert (first.status, second.status) == (0, 0)
    assert (first.err, second.err) == ("says spin\n", "says again\n")
    assert first.cpu_seconds > 0.2
    assert second.cpu_seconds < 0.2, "that of the command before is not counted again"
    assert second.peak_memory > 1e6


def test_a_refusal_leaves_the_worker_and_a_failure_ends_it(workers: Workers) -> None:
    _, one = run(workers, "refused", "3")
    failed, two = run(workers, "failed", "1")
    after, three = run(workers, "well")
    assert one == two != three
    assert (failed.status, after.status) == (1, 0)


def test_events_end_also_where_the_command_never_opened_them(workers: Workers) -> None:
    reader, writer = os.pipe()
    ended = workers.run(["early"], events=writer)
    os.close(writer)
    assert ended is not None
    assert ended.status == 2
    with os.fdopen(reader, "rb") as file:
        assert select.select([file], [], [], 10.0)[0], "the worker still holds its end"
        assert file.read() == b""
    assert run(workers, "well")[0].status == 0


def test_a_crash_is_reported_and_harms_no_other(workers: Workers) -> None:
    _, one = run(workers, "well")
    crashed, two = run(workers, "kill")
    after, three = run(workers, "well")
    assert one == two != three
    assert crashed.status == -11
    assert "says kill" in crashed.err
    assert after.status == 0


def test_an_error_that_nobody_expected_is_reported_with_its_traceback(workers: Workers) -> None:
    ended, _ = run(workers, "raise")
    assert ended.status == 1
    assert "KeyError: 'unforeseen'" in ended.err


def test_a_command_that_takes_too_long_is_ended(workers: Workers) -> None:
    began = time.monotonic()
    ended, _ = run(workers, "sleep", timeout=0.3)
    assert ended.timed_out
    assert not ended.stopped
    assert time.monotonic() - began < 30.0
    assert run(workers, "well")[0].status == 0


def test_a_worker_holds_the_locks_that_it_is_given(workers: Workers, tmp_path: Path) -> None:
    held = acquire(tmp_path / "a.usda")
    assert held is not None
    assert held.descriptor is not None
    ended, _ = run(workers, "locked", str(tmp_path / "a.usda"), inherit=[held.descriptor])
    assert ended.status == 0
    held.release()
    again = acquire(tmp_path / "a.usda")
    assert again is not None, "the worker let go of it"
    again.release()
    assert run(workers, "locked", str(tmp_path / "a.usda"))[0].status == 1


def test_closing_ends_the_processes_and_leaves_no_descriptor() -> None:
    before = len(os.listdir("/proc/self/fd")) if Path("/proc").is_dir() else 0
    workers = Workers(Children(), [sys.executable, "-c", SCRIPT])
    _, pid = run(workers, "well")
    assert os.kill(pid, 0) is None
    workers.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    if before:
        assert len(os.listdir("/proc/self/fd")) == before


def test_nothing_is_started_once_it_is_time_to_stop() -> None:
    children = Children()
    children.stop()
    reader, writer = os.pipe()
    assert Workers(children).run(["bake"], events=writer) is None
    os.close(reader)
    os.close(writer)
