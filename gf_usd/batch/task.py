"""Runs one job, from its lock to its record, locally, on a cluster or on a farm."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.record import (
    InputTable,
    describe,
    file_stamps,
    finished,
    identity,
    input_paths,
    write_record,
)
from gf_usd.batch.slices import final_outcome, resumable, time_spent
from gf_usd.batch.verdict import Attempt, attempt_outcome
from gf_usd.core.errors import GfUsdError
from gf_usd.prepare.outputs.outputs import outputs
from gf_usd.system.file_locks import Held, acquire
from gf_usd.system.processes import ProcessResult
from gf_usd.system.warm.workers import Commands, listening

Emit = Callable[[dict[str, Any]], None]  # an event, see docs/farm.md

EVENTS_PER_VARIANT = 10  # frame events that are passed on, per variant
RETRIED = ("crashed", "timeout")  # states for which another attempt may succeed


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits and options for running a job."""

    timeout: float | None = None  # [s] of an attempt
    retries: int = 1
    lock_timeout: float = 0.0  # [s] to wait for another run that writes the same result
    overwrite: bool = False  # repeat jobs that are done
    threads: int | None = 1  # CPU threads of a bake without --threads
    slice: int | None = None  # complete clips after which a bake ends, to be resumed
    continues: bool = (
        False  # not the first slice: jobs that ended in an earlier one are not repeated
    )


def run_job(
    job: Job,
    limits: Limits,
    *,
    commands: Commands,
    table: InputTable,
    emit: Emit,
) -> Outcome:
    """Bake, unless the same result exists; errors of the bake are in the outcome, never raised."""
    if commands.stopping:
        return _not_run_outcome(job, "stopped", "interrupted before it started")
    try:
        held = acquire(
            job.root, lock_timeout=limits.lock_timeout, stopped=lambda: commands.stopping
        )
    except GfUsdError as error:
        return _not_run_outcome(job, "failed", error.message, error.hint)
    if held is None:
        if commands.stopping:
            return _not_run_outcome(job, "stopped", "interrupted before it started")
        return _not_run_outcome(
            job, "busy", f"another run is baking {job.root}", "repeat the batch when it is done"
        )
    try:
        return _run_locked(job, limits, held, commands, table, emit)
    finally:
        held.release()


def _run_locked(
    job: Job,
    limits: Limits,
    held: Held,
    commands: Commands,
    table: InputTable,
    emit: Emit,
) -> Outcome:
    inputs = table.read(input_paths(job))
    unread = [row["error"] for row in inputs.values() if "error" in row]
    description = describe(job, inputs)
    # without its inputs, the result cannot be known to be the same
    known = None if unread else identity(description)
    strict = bool(job.options.get("strict"))
    if not limits.overwrite and (kept := finished(job, known)) is not None:
        if strict and kept.warnings:
            return replace(kept, state="unsound", message="it has warnings, and --strict was given")
        if any(warning.get("level") == "error" for warning in kept.warnings):
            return replace(kept, state="unsound", message="its result is wrong; see its warnings")
        return kept
    if limits.continues and (outcome := final_outcome(job, known)) is not None:
        return outcome
    before = file_stamps(inputs)
    seconds, cpu = time_spent(job, known)
    outcome, files = _attempts(job, limits, held, commands, emit)
    outcome = replace(
        outcome,
        host=socket.gethostname(),
        seconds=outcome.seconds + seconds,
        cpu_seconds=outcome.cpu_seconds + cpu,
        notes=tuple(f"it will be baked again the next time: {why}" for why in unread)
        if outcome.good
        else (),
    )
    if outcome.good and file_stamps(inputs) != before:
        outcome = replace(
            outcome, state="failed", message=f"{job.asset}: a file that it reads has changed in "
            f"the meantime",
            hint="repeat the batch",
        )  # fmt: skip
        known = None
    if outcome.state == "stopped":
        return outcome
    try:
        write_record(job, outcome, identity=known, description=description, outputs=files)
    except GfUsdError as error:
        if outcome.good:
            return replace(outcome, state="failed", message=error.message, hint=error.hint)
        return replace(outcome, notes=(*outcome.notes, error.message))
    return outcome


def _attempts(
    job: Job, limits: Limits, held: Held, commands: Commands, emit: Emit
) -> tuple[Outcome, tuple[Path, ...]]:
    """Run the bake until it succeeds, or until no retries are left."""
    seconds = cpu = 0.0
    attempt = 0
    while True:
        attempt += 1
        began = time.monotonic()
        emit({"event": "started", "job": job.name, "attempt": attempt, "command": job.command})
        watch = _BakeEvents(job, emit)
        ended = _bake(job, limits, held, commands, watch)
        if ended is None:
            return _not_run_outcome(job, "stopped", "interrupted before it started"), ()
        seconds += time.monotonic() - began
        cpu += ended.cpu_seconds
        bake: Attempt = attempt_outcome(job, ended, watch.last)
        outcome = replace(
            bake.outcome, attempts=attempt, seconds=seconds, cpu_seconds=cpu,
            frames=bake.outcome.frames or watch.done, particles=watch.particles,
            frames_per_second=watch.rate,
        )  # fmt: skip
        if outcome.state not in RETRIED or attempt > limits.retries or commands.stopping:
            return outcome, bake.files
        emit({"event": "retry", "job": job.name, "attempt": attempt, "why": outcome.message})
        # the cause, such as lack of memory, may have passed by then
        commands.pause(min(float(attempt), 5.0))


def _bake(
    job: Job, limits: Limits, held: Held, commands: Commands, watch: _BakeEvents
) -> ProcessResult | None:
    """One attempt; None where the batch is stopping."""
    arguments = [*job.arguments(), "--overwrite"]
    if "threads" not in job.options and limits.threads:
        arguments += ["--threads", str(limits.threads)]
    if limits.slice:
        arguments += ["--slice", str(limits.slice)]
    if resumable(job):
        arguments.append("--resume")
    # Jobs of one mesh file share a layer, which is written before the first frame.
    source = outputs(job.asset, job.variant_names, str(job.root)).source
    shared = None
    if source is not None:
        shared = acquire(source, lock_timeout=float("inf"), stopped=lambda: commands.stopping)
        if shared is None:
            return None
    watch.shared = shared
    locks = [lock.descriptor for lock in (held, shared) if lock is not None]
    try:
        with listening(lambda line: watch(json.loads(line))) as writer:
            return commands.run(arguments, events=writer, timeout=limits.timeout, inherit=locks)
    finally:
        if shared is not None:
            shared.release()


class _BakeEvents:
    """Follows the events of a bake.

    last : the last event of each kind, by name.
    """

    def __init__(self, job: Job, emit: Emit) -> None:
        self._job, self._emit = job, emit
        self._first: tuple[float, int] | None = None
        self.last: dict[str, dict[str, Any]] = {}
        self.done = self.particles = 0
        self.rate = 0.0
        self.shared: Held | None = None  # the lock on the shared layer, until the first frame

    def __call__(self, event: dict[str, Any]) -> None:
        self.last[event["event"]] = event
        if event["event"] != "frame":
            return
        if self.shared is not None:
            self.shared.release()
        now, total = time.monotonic(), event["total"]
        self.done, self.particles = event["done"], event["particles"]
        if self._first is None:
            self._first = (now, self.done)
        elif now > self._first[0]:
            self.rate = (self.done - self._first[1]) / (now - self._first[0])
        if self.done % max(1, total // EVENTS_PER_VARIANT) and self.done != total:
            return
        self._emit(
            {
                "event": "frame", "job": self._job.name, "done": self.done, "total": total,
                "frames_per_second": round(self.rate, 3),
            }
        )  # fmt: skip


def _not_run_outcome(job: Job, state: str, message: str, hint: str = "") -> Outcome:
    """The outcome of a job that was not run."""
    return Outcome(
        job=job.name, state=state, message=message, hint=hint, root=str(job.root),
        command=job.command, host=socket.gethostname(),
    )  # fmt: skip


def unexpected_error_outcome(job: Job, error: BaseException) -> Outcome:
    """The outcome of a job that failed outside its bake, for example without a process."""
    return _not_run_outcome(job, "crashed", f"{type(error).__name__}: {error}")


def finished_event(outcome: Outcome) -> dict[str, Any]:
    """The event at the end of a job."""
    row: Mapping[str, Any] = outcome.as_json()
    return {"event": "finished", **row}
