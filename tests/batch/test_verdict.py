"""From the end of a process to what it means for its job."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from batch_jobs import job

from gf_usd.batch.verdict import attempt_outcome
from gf_usd.prepare.outputs.outputs import RESUME
from gf_usd.system.processes import ProcessResult

RESULT = {
    "outputs": ["a.usda", "a.cache.usdc"],
    "warnings": [],
    "check": [],
    "bakes": [{"frames": 4, "health": {"rollbacks": 1, "min_J": 0.9}}, {"frames": 4, "health": {}}],
}
DAMAGED = "/x.usda is damaged: 12:3\nin two lines"
FINISHED = {"finished": {"event": "finished", **RESULT}}
SLICED = {"sliced": {"event": "sliced", "variant": "rubber", "done": 3, "frames": 5}}
GOES_ON = "run the same command to continue"
ERROR = {"error": {"event": "error", "status": 3, "message": DAMAGED, "hint": "export it again"}}
STDERR = f"note: centimeters\nerror: {DAMAGED}\n\nhint: export it again\n"


def ended(status: int, err: str = "", **more: Any) -> ProcessResult:
    kwargs = {"timed_out": False, "stopped": False, **more}
    return ProcessResult(
        status=status, out="", err=err, seconds=2.0, cpu_seconds=1.0, peak_memory=5, **kwargs
    )


def test_a_whole_result_is_done(tmp_path: Path) -> None:
    flowed = {"rollbacks": 1, "min_J": 0.9, "plastic_dissipation_J": 2.5}
    job_flows = {"finished": {**RESULT, "bakes": [{"frames": 8, "health": flowed}]}}
    assert attempt_outcome(job(tmp_path), ended(0), job_flows).outcome.health == flowed
    bake = attempt_outcome(job(tmp_path), ended(0), FINISHED)
    assert bake.outcome.state == "done"
    assert bake.outcome.frames == 8
    assert bake.outcome.health == {"rollbacks": 1, "min_J": 0.9}
    assert bake.files == (Path("a.usda"), Path("a.cache.usdc"))


@pytest.mark.parametrize(
    ("process", "events", "state", "message", "hint"),
    [
        (ended(1, STDERR), ERROR, "failed", DAMAGED, "export it again"),
        (ended(2, STDERR), ERROR, "refused", DAMAGED, "export it again"),
        (ended(3, STDERR), ERROR, "refused", DAMAGED, "export it again"),
        (ended(0), {}, "crashed", "the bake ended without a result", ""),
        (ended(-11), {}, "crashed", "the bake was ended by SIGSEGV", ""),
        (ended(-11), FINISHED, "crashed", "the bake was ended by SIGSEGV", ""),
        (ended(143), {}, "crashed", "the bake was ended by SIGTERM", ""),
        (ended(143), ERROR, "crashed", "the bake was ended by SIGTERM", ""),
        (ended(143, stopped=True), {}, "stopped", "interrupted before it ended", ""),
        (ended(143, timed_out=True), {}, "timeout", "not finished after 2 s", "raise --timeout"),
        (ended(1, "Traceback\n  line\nMemoryError: 3\n"), {}, "crashed", "MemoryError: 3", ""),
        (ended(1), {}, "crashed", "no output", ""),
        (ended(5), SLICED, "sliced", "rubber: 3 of 5 frames are done", GOES_ON),
        (ended(5, stopped=True), {}, "stopped", "interrupted before it ended", ""),
        # words on stderr decide nothing
        (ended(1, STDERR), {}, "crashed", "hint: export it again", ""),
    ],
)  # fmt: skip
def test_every_other_end_has_its_name(
    tmp_path: Path, process: ProcessResult, events: Any, state: str, message: str, hint: str
) -> None:
    bake = attempt_outcome(job(tmp_path), process, events)
    assert (bake.outcome.state, bake.outcome.message, bake.outcome.hint) == (state, message, hint)
    assert bake.outcome.log == process.err
    assert not bake.files
    assert not bake.outcome.good


def test_a_full_disk_says_how_a_batch_continues_and_names_no_option_of_a_bake(
    tmp_path: Path,
) -> None:
    full = {"error": {"event": "error", "message": "full", "hint": f"free some space; {RESUME}"}}
    bake = attempt_outcome(job(tmp_path), ended(1), full)
    assert bake.outcome.hint == f"free some space; {GOES_ON}"


def test_a_kill_that_may_be_the_systems_hints_at_memory(tmp_path: Path) -> None:
    assert "--jobs" in attempt_outcome(job(tmp_path), ended(-signal.SIGKILL), {}).outcome.hint


def test_a_result_with_faults_is_complete_but_not_sound(tmp_path: Path) -> None:
    finding = {"rule": "finite", "prim": "/A", "message": "NaN", "fix": "bake again"}
    bake = attempt_outcome(job(tmp_path), ended(0), {"finished": {**RESULT, "check": [finding]}})
    assert bake.outcome.state == "unsound"
    assert "finite </A>: NaN" in bake.outcome.message
    assert bake.files
    warning = {"look": "rubber", "about": "energy", "message": "it rose", "hint": "drop it lower"}
    warned = {"finished": {**RESULT, "warnings": [warning]}}
    strict = attempt_outcome(job(tmp_path), ended(4), {**warned, **ERROR})
    assert (strict.outcome.message, strict.outcome.hint) == (DAMAGED, "export it again")
    assert strict.outcome.state == "unsound"
    assert strict.outcome.warnings == (warning,)
    # without --strict a warning is no fault
    assert attempt_outcome(job(tmp_path), ended(0), warned).outcome.good
