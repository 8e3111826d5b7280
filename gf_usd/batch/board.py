"""The status of every job of a batch, from its events; the summary file and the command to
repeat.
"""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gf_usd.batch.job import GOOD, NOT_FAILED, STATES, Job, Outcome
from gf_usd.batch.record import read_record
from gf_usd.batch.slices import NOT_ATTEMPTED
from gf_usd.core.errors import UsageError
from gf_usd.system.atomic_files import publish_text
from gf_usd.system.file_locks import locked
from gf_usd.system.fingerprint import program


@dataclass
class Row:
    """The status of a job."""

    name: str
    state: str = "waiting"  # waiting, running, or one of job.STATES
    attempt: int = 0
    done: int = 0  # frames
    total: int = 0
    frames_per_second: float = 0.0
    seconds: float = 0.0
    began: float = 0.0
    message: str = ""

    @property
    def left(self) -> float | None:
        """[s] estimated remaining time; None: unknown."""
        if self.frames_per_second <= 0.0:
            return None
        return (self.total - self.done) / self.frames_per_second


class Board:
    """The status of all jobs, and the progress of the batch."""

    def __init__(
        self, names: Sequence[str], at_once: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.rows = {name: Row(name=name) for name in names}
        self._at_once, self._clock, self._began = at_once, clock, clock()

    def handle(self, event: Mapping[str, Any]) -> Row | None:
        """Update the row of an event's job, and return it."""
        row = self.rows.get(event.get("job", ""))
        if row is None:
            return None
        kind = event["event"]
        if row.state not in ("waiting", "running"):
            return row  # a cluster may deliver earlier events after the last one
        if kind == "started":
            row.state, row.attempt, row.began = "running", event["attempt"], self._clock()
            row.done, row.frames_per_second = 0, 0.0
        elif kind == "frame":
            row.state = "running"
            row.done, row.total = event["done"], event["total"]
            row.frames_per_second = event["frames_per_second"]
        elif kind == "finished":
            row.state, row.seconds = event["state"], event["seconds"]
            row.message, row.frames_per_second = event["message"], event["frames_per_second"]
        return row

    def of(self, *states: str) -> list[Row]:
        """The rows in any of the given states."""
        return [row for row in self.rows.values() if row.state in states]

    @property
    def ended(self) -> list[Row]:
        """The rows of jobs that have ended."""
        return [row for row in self.rows.values() if row.state not in ("waiting", "running")]

    @property
    def failed(self) -> list[Row]:
        """The rows of jobs that ended without success."""
        return [row for row in self.ended if row.state not in NOT_FAILED]

    @property
    def seconds(self) -> float:
        """[s] since the start."""
        return self._clock() - self._began

    @property
    def left(self) -> float | None:
        """[s] estimated remaining time, from the mean time of ended jobs; None before the first
        ends.
        """
        took = [row.seconds for row in self.ended if row.seconds > 0.0]
        if not took:
            return None
        mean = sum(took) / len(took)
        running = sum(max(0.0, mean - self.running_for(row)) for row in self.of("running"))
        return (mean * len(self.of("waiting")) + running) / self._at_once

    @property
    def share(self) -> float:
        """Share of the work that is done, 0 to 1, including the frames of running jobs."""
        parts = (row.done / row.total for row in self.of("running") if row.total)
        return (len(self.ended) + sum(parts)) / max(1, len(self.rows))

    def running_for(self, row: Row) -> float:
        """[s] since the start of the current attempt."""
        return self._clock() - row.began


SUMMARY, PAGE = ".batch.json", ".batch.html"
NAMES_IN_COMMAND = 20  # job names in a command; with more, the command reads the summary


def by_urgency(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Outcomes by urgency: failures first, each state by name."""
    ranks = {state: rank for rank, state in enumerate(reversed(STATES))}
    return sorted(outcomes, key=lambda o: (ranks.get(o.state, 0), o.job))


def state_counts(outcomes: Sequence[Outcome]) -> dict[str, int]:
    """Number of outcomes in each state, without states that do not occur."""
    found = {state: sum(o.state == state for o in outcomes) for state in STATES}
    return {state: n for state, n in found.items() if n}


def summary_line(outcomes: Sequence[Outcome]) -> str:
    """``2 failed, 1 crashed, 197 done``, on one line."""
    found = state_counts(outcomes)
    names = [state for state in reversed(STATES) if state in found and state not in GOOD]
    names += [state for state in GOOD if state in found]
    return ", ".join(f"{found[state]} {state}" for state in names) or "no jobs"


def rerun_command(arguments: Sequence[str], outcomes: Sequence[Outcome]) -> str:
    """The command that repeats the unsuccessful jobs; "" where there are none.

    arguments : the arguments of the command, without ``--select`` and ``--failed``.
    """
    names = [o.job for o in by_urgency(outcomes) if not o.good]
    if not names:
        return ""
    if len(names) > NAMES_IN_COMMAND:
        return shlex.join([*arguments, "--failed"])
    return shlex.join(
        [*arguments, *(argument for name in names for argument in ("--select", name))]
    )


def write_summary(
    path: Path, outcomes: Sequence[Outcome], *, arguments: Sequence[str], seconds: float,
    jobs: Sequence[Job],
) -> dict[str, Any]:  # fmt: skip
    """Publish the summary and return it.  Raises BakeError where the file cannot be written.

    A job of the plan that was not run keeps the outcome in its record or in the earlier summary,
    whichever is newer.  A job that another run completed meanwhile has the outcome in its record.

    arguments : as of `rerun_command`; empty: there is no command to repeat.
    seconds : [s] that this run took.
    """
    began = _utc(time.time() - seconds)
    with locked(path):
        known = _known_outcomes(path, jobs)
        of_name = {job.name: job for job in jobs}
        for outcome in outcomes:
            record = read_record(of_name[outcome.job]) if outcome.state in NOT_ATTEMPTED else None
            meanwhile = record is not None and str(record.get("finished", "")) >= began
            known[outcome.job] = Outcome.of(record["outcome"]) if meanwhile else outcome
        rows = by_urgency([known[job.name] for job in jobs if job.name in known])
        entry = {
            "finished": _utc(time.time()),
            "seconds": round(seconds, 3),
            "counts": state_counts(rows),
            "repeat": rerun_command(arguments, rows) if arguments else "",
            "program": program(),
            "jobs": [row.as_json() for row in rows],
        }
        publish_text(path, json.dumps(entry, indent=1) + "\n")
    return entry


def _utc(seconds: float) -> str:
    """The time in the format of records."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(seconds))


def _known_outcomes(path: Path, jobs: Sequence[Job]) -> dict[str, Outcome]:
    """The outcome of each job in the summary or its record, whichever is newer.

    Tasks of a bundle write records but no summary.  The summary also has jobs that were stopped or
    left to another run, which have no record.
    """
    when, rows = _summary(path)
    known = {row.job: row for row in rows}
    for job in jobs:
        entry = read_record(job)
        if entry is not None and (job.name not in known or entry.get("finished", "") > when):
            known[job.name] = Outcome.of(entry["outcome"])
    return known


def earlier_run(path: Path, jobs: Sequence[Job], flag: str) -> dict[str, Outcome]:
    """The outcome of each job in the summary or its record, whichever is newer.

    flag : the option that needs an earlier run.

    Raises UsageError where there is no outcome of any job.
    """
    known = _known_outcomes(path, jobs)
    if not any(job.name in known for job in jobs):
        raise UsageError(
            f"{flag}: no earlier run is known: there is no {path}, and no job has a record",
            f"run the batch without {flag} first, or give the --output of that run",
        )
    return known


def failed_in(known: Mapping[str, Outcome], jobs: Sequence[Job]) -> list[str]:
    """Names of the jobs with a known outcome that is not good."""
    return [job.name for job in jobs if job.name in known and not known[job.name].good]


def not_run(known: Mapping[str, Outcome], jobs: Sequence[Job]) -> int:
    """Number of jobs without a known outcome."""
    return sum(job.name not in known for job in jobs)


def _summary(path: Path) -> tuple[str, list[Outcome]]:
    """When a summary was written, and its jobs; ("", []) where there is no summary."""
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))
        return str(entry["finished"]), [Outcome.of(row) for row in entry["jobs"]]
    except (OSError, ValueError, KeyError, TypeError):
        return "", []
