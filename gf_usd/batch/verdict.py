"""Derives a job's outcome from the exit status and the events of a bake."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gf_usd.batch.job import Job, Outcome
from gf_usd.core.errors import counted
from gf_usd.prepare.outputs.outputs import RESUME
from gf_usd.system.processes import KILLED, ProcessResult, signal_name

LOG = 4000  # characters of stderr that are kept of a bake that failed
MESSAGE_LENGTH = 600  # characters of a message
# health values that the table of a batch shows
HEALTH = (
    "rollbacks", "inverted_particle_frames", "deepest_penetration_spacings",
    "energy_gain_max_share", "restitution", "min_J", "max_J", "plastic_dissipation_J", "substeps",
)  # fmt: skip
CONTINUE = "run the same command to continue"
INTERRUPTED = (128 + signal.SIGINT, 128 + signal.SIGTERM)
# exit statuses of bake
STATUS = {1: "failed", 2: "refused", 3: "refused", 4: "unsound", 5: "sliced"}


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """The outcome and the files of an attempt."""

    outcome: Outcome
    files: tuple[Path, ...] = ()  # of a complete bake


def attempt_outcome(
    job: Job, ended: ProcessResult, events: Mapping[str, Mapping[str, Any]]
) -> Attempt:
    """The outcome of an attempt: done, failed, or ended from outside.

    events : the last event of each kind, by name; see `gf-usd bake --events`.
    """
    outcome = Outcome(
        job=job.name, state="done", root=str(job.root), command=job.command,
        status=ended.status, peak_memory=ended.peak_memory,
    )  # fmt: skip
    error = events.get("error", {})
    if "finished" in events and ended.status in (0, 4):
        return _complete(outcome, ended, events["finished"], error)
    # a batch resumes by itself
    message, hint = error.get("message", ""), error.get("hint", "").replace(RESUME, CONTINUE)
    state = STATUS.get(ended.status, "crashed")
    if ended.stopped:
        state, message, hint = "stopped", "interrupted before it ended", ""
    elif ended.timed_out:
        state, message, hint = (
            "timeout",
            f"not finished after {ended.seconds:.0f} s",
            "raise --timeout",
        )
    elif state == "sliced":
        message, hint = "a slice is done", CONTINUE
        if (slice := events.get("sliced")) is not None:
            message = "{variant}: {done} of {frames} frames are done".format_map(slice)
    elif ended.status == 0:
        state, message, hint = "crashed", "the bake ended without a result", ""
    elif ended.status < 0 or ended.status in INTERRUPTED:
        state, message, hint = "crashed", f"the bake was ended by {signal_name(ended.status)}", ""
        if ended.status == -signal.SIGKILL:
            hint = f"{KILLED}: run fewer jobs at once (--jobs)"
    elif not message:
        # Python's message of an unexpected exception
        state, message = "crashed", (ended.err.strip().splitlines() or ["no output"])[-1]
    return Attempt(
        outcome=replace(
            outcome, state=state, message=message[:MESSAGE_LENGTH], hint=hint, log=ended.err[-LOG:]
        )
    )


def _complete(
    outcome: Outcome, ended: ProcessResult, result: Mapping[str, Any], error: Mapping[str, Any]
) -> Attempt:
    """The outcome with all files written; the check or --strict may still fail it.

    result : the event `finished`; error : that of --strict.
    """
    warnings = tuple(result["warnings"])
    findings = tuple(result["check"])
    health = result["bakes"][0]["health"]
    outcome = replace(
        outcome,
        frames=sum(bake["frames"] for bake in result["bakes"]),
        health={key: health[key] for key in HEALTH if key in health},
        warnings=warnings,
        findings=findings,
        bake_notes=tuple(result.get("notes", ())),
    )
    if findings:
        first, more = findings[0], "; the first is" if len(findings) > 1 else ":"
        outcome = replace(
            outcome, state="unsound",
            message=f"the check found {counted(len(findings), 'error')}{more} {first['rule']}"
            f" <{first['prim']}>: {first['message']}"[:MESSAGE_LENGTH],
            hint=first["fix"],
        )  # fmt: skip
    elif ended.status == 4:
        message, hint = error.get("message", "")[:MESSAGE_LENGTH], error.get("hint", "")
        outcome = replace(outcome, state="unsound", message=message, hint=hint)
    return Attempt(outcome=outcome, files=tuple(Path(path) for path in result["outputs"]))
