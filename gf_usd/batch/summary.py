"""What a batch came to: its file, what to do again, and how to ask for that."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gf_usd.batch.job import GOOD, STATES, Job, Outcome
from gf_usd.batch.record import read_record
from gf_usd.locks import locked
from gf_usd.program import program
from gf_usd.publish import publish_text

SUMMARY, PAGE = ".batch.json", ".batch.html"
NAMED = 20  # so many names fit into a command; more are found in the summary


def ordered(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Those that need a look first, each kind by name."""
    ranks = {state: rank for rank, state in enumerate(reversed(STATES))}
    return sorted(outcomes, key=lambda o: (ranks.get(o.state, 0), o.job))


def counts(outcomes: Sequence[Outcome]) -> dict[str, int]:
    """How many ended in each state, states that none has left out."""
    found = {state: sum(o.state == state for o in outcomes) for state in STATES}
    return {state: n for state, n in found.items() if n}


def words(outcomes: Sequence[Outcome]) -> str:
    """``2 failed, 1 crashed, 197 done`` for a line."""
    found = counts(outcomes)
    names = [state for state in reversed(STATES) if state in found and state not in GOOD]
    names += [state for state in GOOD if state in found]
    return ", ".join(f"{found[state]} {state}" for state in names) or "no jobs"


def again(asked: Sequence[str], outcomes: Sequence[Outcome]) -> str:
    """The command that repeats just what is not good; "" where all is.

    asked : the words of the command, without ``--only`` and ``--failed``.
    """
    names = [o.job for o in ordered(outcomes) if not o.good]
    if not names:
        return ""
    if len(names) > NAMED:
        return shlex.join([*asked, "--failed"])
    return shlex.join([*asked, *(word for name in names for word in ("--only", name))])


def write_summary(
    path: Path, outcomes: Sequence[Outcome], *, repeat: str, seconds: float, jobs: Sequence[Job]
) -> dict[str, Any]:
    """Publish the summary and return it.  Raises BakeError where the disk refuses.

    Jobs of the plan that were not run keep what their record, or the summary before, says of them.
    """
    ran = {outcome.job: outcome for outcome in outcomes}
    rows = [ran.get(job.name) or recorded(job) for job in jobs]
    known = ordered([row for row in rows if row is not None])
    entry = {
        "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "seconds": round(seconds, 3),
        "counts": counts(known),
        "repeat": repeat,
        "program": program(),
        "jobs": [row.as_json() for row in known],
    }
    with locked(path):
        publish_text(path, json.dumps(entry, indent=1) + "\n")
    return entry


def recorded(job: Job) -> Outcome | None:
    """What the record beside a result says came of the job."""
    entry = read_record(job)
    return None if entry is None else Outcome.of(entry["outcome"])


def failed_in(path: Path) -> list[str]:
    """Names of the jobs that a summary says are not good; none where there is no summary."""
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))
        rows = [Outcome.of(row) for row in entry["jobs"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [row.job for row in rows if not row.good]
