"""Jobs side by side: none is lost, whatever happens around its bake."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from batch_jobs import job

from gf_usd.batch import run as resources
from gf_usd.batch import task
from gf_usd.batch.record import read_record
from gf_usd.batch.run import collect_outcomes, run_locally
from gf_usd.batch.task import Limits
from gf_usd.core.errors import UsageError
from gf_usd.system.file_locks import acquire
from gf_usd.system.processes import Children, ProcessResult

RESULT = {"warnings": [], "check": [], "bakes": [{"frames": 2, "health": {}}]}
KILLED = (-9, {}, "")
NO_SOLID = {"event": "error", "status": 3, "message": "no solid", "hint": "close it"}
FULL = {"event": "error", "status": 1, "message": "full", "hint": "make room"}


class Bakes(Children):
    """Stands in for processes: each bake ends as the script of its job says, in turn."""

    def __init__(self, script: dict[str, list[tuple[int, dict[str, Any], str]]]) -> None:
        super().__init__()
        self.script, self.locked = script, list[bool]()
        self.before: Callable[[str], None] = lambda name: None

    def run(
        self, command: Sequence[str], on_line: Callable[[str], None], **how: Any
    ) -> ProcessResult | None:
        if "inputs" in command:
            return super().run(command, on_line, **how)
        assert list(command[:4]) == [sys.executable, "-m", "gf_usd", "bake"]
        root = Path(command[command.index("--output") + 1])
        name = root.stem
        self.before(name)
        self.locked.append(acquire(root) is None)
        status, last, err = self.script[name].pop(0)
        events = [last] if last else []
        if status == 0:
            root.write_text("#usda 1.0\n", encoding="utf-8")
            events = [{"event": "frame", "done": k, "total": 2, "particles": 120} for k in (1, 2)]
            events.append({"event": "finished", **RESULT, "outputs": [str(root)]})
        writer = int(command[command.index("--events") + 1])
        assert writer in how["inherit"]
        for event in events:
            os.write(writer, json.dumps(event).encode() + b"\n")
        if status < 0:
            os.write(writer, b'{"event": "fini')  # cut short
        return ProcessResult(
            status=status, out="", err=err, seconds=1.0, cpu_seconds=1.0, peak_memory=1,
            timed_out=False, stopped=False,
        )  # fmt: skip


def ran(
    children: Children, jobs: Sequence[Any], **limits: Any
) -> tuple[dict[str, str], list[dict]]:
    events: list[dict] = []
    ends = collect_outcomes(
        run_locally(jobs, Limits(**limits), at_once=2, children=children, warm=False),
        lambda event: events.append(event) if event else None,
    )
    return {end.job: end.state for end in ends}, events


def test_each_job_ends_in_its_own_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Children, "pause", lambda self, seconds: None)
    names = ("good", "twice", "dead", "bad")
    jobs = [job(tmp_path, name) for name in names]
    children = Bakes({
        "good": [(0, {}, "")],
        "twice": [KILLED, (0, {}, "")],
        "dead": [KILLED, KILLED, (0, {}, "")],
        "bad": [(3, NO_SOLID, "error: no solid\n"), (0, {}, "")],
    })  # fmt: skip
    states, events = ran(children, jobs, retries=1)
    assert states == {"good": "done", "twice": "done", "dead": "crashed", "bad": "refused"}
    assert all(children.locked), "every bake runs under its lock"
    tries = {e["job"]: e["attempts"] for e in events if e["event"] == "finished"}
    assert tries == {"good": 1, "twice": 2, "dead": 2, "bad": 1}
    assert [e["done"] for e in events if e["event"] == "frame" and e["job"] == "good"] == [1, 2]
    record = read_record(jobs[3])
    assert record is not None
    assert record["outcome"]["message"] == "no solid"
    # a second run: what is done is kept, without a bake; what failed is tried again
    states, events = ran(children, jobs, retries=1)
    assert states == {"good": "kept", "twice": "kept", "dead": "done", "bad": "done"}
    assert sorted({e["job"] for e in events if e["event"] == "started"}) == ["bad", "dead"]
    children.script["good"] = [(0, {}, "")]
    states, _ = ran(children, jobs[:1], overwrite=True)
    assert states == {"good": "done"}


@pytest.mark.slow
def test_an_asset_that_changes_under_the_bake_is_not_done(tmp_path: Path) -> None:
    jobs = [job(tmp_path, "good")]
    children = Bakes({"good": [(0, {}, "")] * 3})
    children.before = lambda name: jobs[0].asset.write_text("#usda 1.0\n# other\n")
    states, _ = ran(children, jobs)
    assert states == {"good": "failed"}
    children.before = lambda name: None
    assert ran(children, jobs)[0] == {"good": "done"}
    assert ran(children, jobs)[0] == {"good": "kept"}


def test_a_system_without_processes_of_posix_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    resources.require_processes()
    monkeypatch.setattr(resources, "PROCESSES", False)
    with pytest.raises(UsageError, match="needs POSIX processes"):
        resources.require_processes()


def test_what_is_held_is_left_and_what_is_stopped_does_not_begin(tmp_path: Path) -> None:
    jobs = [job(tmp_path, "a"), job(tmp_path, "b")]
    held = acquire(jobs[0].root)
    assert held is not None
    children = Bakes({"b": [(0, {}, "")]})
    assert ran(children, jobs)[0] == {"a": "busy", "b": "done"}
    held.release()
    children.stop()
    states, events = ran(children, jobs)
    assert states == {"a": "stopped", "b": "stopped"}
    assert not [e for e in events if e["event"] == "started"]


def test_a_fault_outside_the_bake_ends_one_job_not_the_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs = [job(tmp_path, name) for name in "abc"]
    children = Bakes({name: [(0, {}, "")] for name in "abc"})

    def short(name: str) -> None:
        if name == "b":
            raise OSError(12, "Cannot allocate memory")

    children.before = short
    states, events = ran(children, jobs)
    assert states == {"a": "done", "b": "crashed", "c": "done"}
    (end,) = [e for e in events if e["event"] == "finished" and e["job"] == "b"]
    assert "Cannot allocate memory" in end["message"]
    free = acquire(jobs[1].root)
    assert free is not None, "its lock is free again"
    free.release()


def test_a_disk_that_takes_no_record_fails_the_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gf_usd.core.errors import BakeError

    def full(*args: object, **kwargs: object) -> None:
        raise BakeError("no space left", "make room")

    monkeypatch.setattr(task, "write_record", full)
    children = Bakes({"a": [(0, {}, "")], "b": [(1, FULL, "error: full\n")]})
    jobs = [job(tmp_path, name) for name in "ab"]
    states, events = ran(children, jobs)
    assert states == {"a": "failed", "b": "failed"}
    ends = {e["job"]: e for e in events if e["event"] == "finished"}
    assert ends["a"]["message"] == "no space left"
    assert ends["b"]["message"] == "full"
    assert ends["b"]["notes"] == ("no space left",)


def test_processes_fit_into_cores_and_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resources, "cores", lambda: 8)
    monkeypatch.setattr(resources, "free_memory", lambda: 4e9)
    small = [job(tmp_path, f"a{i}", particles=1000) for i in range(20)]
    assert resources.process_count(small) == int(4e9 / resources.memory_of({"particles": 1000}))
    assert resources.process_count(small, memory=1.5e9) == 2
    assert resources.process_count(small, memory=9e9) == 1
    assert resources.process_count(small[:1], memory=1e6) == 1
    assert resources.process_count(small, memory=1e6) == 8
    large = [*small, job(tmp_path, "big", particles=100_000)]
    assert resources.process_count(large) < resources.process_count(small)
    assert resources.threads_per_bake(small, 4) == 1
    assert resources.threads_per_bake(large, 4) == 2
