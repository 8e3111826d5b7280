"""One job from its lock to its record.  It is the same here, on a cluster and on a farm."""

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
    finished,
    identity,
    read_by,
    stamps,
    write_record,
)
from gf_usd.batch.slices import resumable, settled, spent
from gf_usd.batch.verdict import Bake, judge
from gf_usd.core.errors import GfUsdError
from gf_usd.prepare.outputs import outputs
from gf_usd.system.file_locks import Held, acquire
from gf_usd.system.processes import Ended
from gf_usd.system.warm.workers import Commands, listening

Emit = Callable[[dict[str, Any]], None]  # an event, see docs/farm.md

SHOWN = 10  # events of frames that are passed on, for each look
AGAIN = ("crashed", "timeout")  # for which another attempt may succeed


@dataclass(frozen=True, kw_only=True)
class Limits:
    """How a job is run."""

    timeout: float | None = None  # [s] of an attempt
    retries: int = 1
    patience: float = 0.0  # [s] to wait for a result that another run is writing
    overwrite: bool = False  # bake what is done already
    threads: int | None = 1  # CPU threads of a bake that asks for none
    slice: int | None = None  # full clips after which a bake ends, to be gone on with
    later: bool = False  # this is no first slice: what an earlier one settled is not begun again


def run_job(
    job: Job,
    limits: Limits,
    *,
    commands: Commands,
    table: InputTable,
    emit: Emit,
) -> Outcome:
    """Bake, unless the same is there already; nothing that happens to a bake raises."""
    if commands.stopping:
        return _none(job, "stopped", "interrupted before it started")
    try:
        held = acquire(job.root, patience=limits.patience, stopped=lambda: commands.stopping)
    except GfUsdError as error:
        return _none(job, "failed", error.message, error.hint)
    if held is None:
        if commands.stopping:
            return _none(job, "stopped", "interrupted before it started")
        return _none(
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
    inputs = table.read(read_by(job))
    unread = [row["error"] for row in inputs.values() if "error" in row]
    description = describe(job, inputs)
    # without knowing what it reads nobody can say that it is the same
    known = None if unread else identity(description)
    strict = bool(job.options.get("strict"))
    if not limits.overwrite and (kept := finished(job, known)) is not None:
        if strict and kept.warnings:
            return replace(kept, state="unsound", message="it has warnings, and --strict was given")
        if any(warning.get("level") == "error" for warning in kept.warnings):
            return replace(kept, state="unsound", message="its result is wrong; see its warnings")
        return kept
    if limits.later and (told := settled(job, known)) is not None:
        return told
    before = stamps(inputs)
    seconds, cpu = spent(job, known)
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
    if outcome.good and stamps(inputs) != before:
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
    """Run the bake until it ends by itself or the retries are used up."""
    seconds = cpu = 0.0
    attempt = 0
    while True:
        attempt += 1
        began = time.monotonic()
        emit({"event": "started", "job": job.name, "attempt": attempt, "command": job.command})
        watch = _Watch(job, emit)
        ended = _bake(job, limits, held, commands, watch)
        if ended is None:
            return _none(job, "stopped", "interrupted before it started"), ()
        seconds += time.monotonic() - began
        cpu += ended.cpu_seconds
        bake: Bake = judge(job, ended, watch.last)
        outcome = replace(
            bake.outcome, attempts=attempt, seconds=seconds, cpu_seconds=cpu,
            frames=bake.outcome.frames or watch.done, particles=watch.particles,
            frames_per_second=watch.rate,
        )  # fmt: skip
        if outcome.state not in AGAIN or attempt > limits.retries or commands.stopping:
            return outcome, bake.files
        emit({"event": "retry", "job": job.name, "attempt": attempt, "why": outcome.message})
        # what killed it, memory for one, may have passed by then
        commands.pause(min(float(attempt), 5.0))


def _bake(job: Job, limits: Limits, held: Held, commands: Commands, watch: _Watch) -> Ended | None:
    """One attempt; None where no more is to be started."""
    arguments = [*job.arguments(), "--overwrite"]
    if "threads" not in job.options and limits.threads:
        arguments += ["--threads", str(limits.threads)]
    if limits.slice:
        arguments += ["--slice", str(limits.slice)]
    if resumable(job):
        arguments.append("--resume")
    # Jobs of one mesh file share a layer, which is written before the first frame.
    source = outputs(job.asset, job.looks, str(job.root)).source
    shared = None
    if source is not None:
        shared = acquire(source, patience=float("inf"), stopped=lambda: commands.stopping)
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


class _Watch:
    """Follows the events of a bake.

    last : the last event of each kind, by name.
    """

    def __init__(self, job: Job, emit: Emit) -> None:
        self._job, self._emit = job, emit
        self._first: tuple[float, int] | None = None
        self.last: dict[str, dict[str, Any]] = {}
        self.done = self.particles = 0
        self.rate = 0.0
        self.shared: Held | None = None  # the lock on what jobs share, until the first frame

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
        if self.done % max(1, total // SHOWN) and self.done != total:
            return
        self._emit(
            {
                "event": "frame", "job": self._job.name, "done": self.done, "total": total,
                "frames_per_second": round(self.rate, 3),
            }
        )  # fmt: skip


def _none(job: Job, state: str, message: str, hint: str = "") -> Outcome:
    """The outcome of a job of which nothing was run."""
    return Outcome(
        job=job.name, state=state, message=message, hint=hint, root=str(job.root),
        command=job.command, host=socket.gethostname(),
    )  # fmt: skip


def unforeseen(job: Job, error: BaseException) -> Outcome:
    """The outcome of a job that an error outside its bake ended, such as no process to be had."""
    return _none(job, "crashed", f"{type(error).__name__}: {error}")


def finished_event(outcome: Outcome) -> dict[str, Any]:
    """The event of a job's end."""
    row: Mapping[str, Any] = outcome.as_json()
    return {"event": "finished", **row}
