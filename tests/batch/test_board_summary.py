"""The summary: failures first, and the command that repeats just them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from batch_jobs import job, outcome

from gf_usd.batch.board import (
    by_urgency,
    earlier_run,
    failed_in,
    not_run,
    rerun_command,
    state_counts,
    summary_line,
    write_summary,
)
from gf_usd.batch.record import write_record
from gf_usd.core.errors import UsageError

ENDS = [
    outcome("a", "done"), outcome("c", "refused"), outcome("b", "kept"), outcome("d", "crashed"),
    outcome("e", "done"), outcome("f b", "stopped"),
]  # fmt: skip


def test_what_needs_a_look_comes_first() -> None:
    assert [o.job for o in by_urgency(ENDS)] == ["d", "c", "f b", "b", "a", "e"]
    assert state_counts(ENDS) == {"done": 2, "kept": 1, "stopped": 1, "refused": 1, "crashed": 1}
    assert summary_line(ENDS) == "1 crashed, 1 refused, 1 stopped, 2 done, 1 kept"
    assert summary_line([]) == "no jobs"


def test_the_command_names_just_those() -> None:
    command = ["gf-usd", "batch", "my toys.toml"]
    assert rerun_command(command, ENDS) == (
        "gf-usd batch 'my toys.toml' --select d --select c --select 'f b'"
    )
    assert rerun_command(command, [o for o in ENDS if o.good]) == ""
    many = [outcome(f"j{i}", "failed") for i in range(21)]
    assert rerun_command(command, many) == "gf-usd batch 'my toys.toml' --failed"


def test_the_file_keeps_what_was_not_run_this_time(tmp_path: Path) -> None:
    jobs = [job(tmp_path, name) for name in ("a", "b", "c")]
    path = tmp_path / "out" / "toys.batch.json"
    path.parent.mkdir()
    write_record(jobs[1], outcome("b", "timeout"), identity="x", description={})
    entry = write_summary(
        path, [outcome("a", "done")], arguments=["gf-usd", "x"], seconds=1.5, jobs=jobs
    )
    assert json.loads(path.read_text("utf-8")) == json.loads(json.dumps(entry))
    assert [(row["job"], row["state"]) for row in entry["jobs"]] == [
        ("b", "timeout"),
        ("a", "done"),
    ]
    assert entry["repeat"] == "gf-usd x --select b"
    # c was never run: it is in no list of failures either
    assert failed_in(earlier_run(path, jobs, "--failed"), jobs) == ["b"]
    assert not_run(earlier_run(path, jobs, "--failed"), jobs) == 1


def test_failures_are_those_of_the_summary_or_of_newer_records(tmp_path: Path) -> None:
    jobs = [job(tmp_path, name) for name in ("a", "b", "c")]
    path = tmp_path / "out" / "toys.batch.json"
    path.parent.mkdir()
    with pytest.raises(UsageError, match="no earlier run is known") as caught:
        earlier_run(path, jobs, "--failed")
    assert "without --failed" in caught.value.hint
    # a task of a bundle writes records only
    write_record(jobs[1], outcome("b", "failed"), identity="x", description={})
    assert failed_in(earlier_run(path, jobs, "--failed"), jobs) == ["b"]
    # what is stopped has no record
    ends = [outcome("a", "stopped"), outcome("b", "done"), outcome("c", "done")]
    entry = write_summary(path, ends, arguments=(), seconds=1.0, jobs=jobs)
    assert failed_in(earlier_run(path, jobs, "--failed"), jobs) == ["a"]
    path.write_text(json.dumps({**entry, "finished": "2020-01-01T00:00:00Z"}), encoding="utf-8")
    assert failed_in(earlier_run(path, jobs, "--failed"), jobs) == ["a", "b"]
    path.write_text("[]", encoding="utf-8")
    assert failed_in(earlier_run(path, jobs, "--failed"), jobs) == ["b"]


def test_what_was_stopped_is_kept_by_a_run_of_other_jobs(tmp_path: Path) -> None:
    jobs = [job(tmp_path, name) for name in ("a", "b")]
    path = tmp_path / "out" / "toys.batch.json"
    path.parent.mkdir()
    write_summary(path, [outcome(n, "stopped") for n in "ab"], arguments=(), seconds=1.0, jobs=jobs)
    entry = write_summary(path, [outcome("a", "done")], arguments=(), seconds=1.0, jobs=jobs)
    assert entry["counts"] == {"done": 1, "stopped": 1}
    assert failed_in(earlier_run(path, jobs, "--failed"), jobs) == ["b"]


def test_what_another_run_did_meanwhile_is_no_longer_busy(tmp_path: Path) -> None:
    jobs = [job(tmp_path, name) for name in ("a", "b")]
    path = tmp_path / "out" / "toys.batch.json"
    path.parent.mkdir()
    write_record(jobs[0], outcome("a", "done"), identity="x", description={})
    ends = [outcome("a", "busy"), outcome("b", "busy")]
    entry = write_summary(path, ends, arguments=["gf-usd", "x"], seconds=60.0, jobs=jobs)
    assert entry["counts"] == {"done": 1, "busy": 1}
    assert entry["repeat"] == "gf-usd x --select b"
    # nor where that run has written the summary after it
    write_summary(path, [outcome("a", "done"), ends[1]], arguments=(), seconds=1.0, jobs=jobs)
    rerun_command = [outcome("a", "busy"), outcome("b", "done")]
    entry = write_summary(path, rerun_command, arguments=(), seconds=60.0, jobs=jobs)
    assert entry["counts"] == {"done": 2}
    # a record of an earlier run says nothing of this one
    text = jobs[0].record.read_text("utf-8")
    old = {**json.loads(text), "finished": "2020-01-01T00:00:00Z"}
    jobs[0].record.write_text(json.dumps(old), encoding="utf-8")
    entry = write_summary(path, ends, arguments=(), seconds=60.0, jobs=jobs)
    assert entry["counts"] == {"busy": 2}
