"""What is known of a job's result, in a file beside it: ``NAME.job.json``."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gf_usd.assets.inputs import digest
from gf_usd.batch.job import Job, Outcome
from gf_usd.errors import InputError
from gf_usd.publish import publish_text


def write_record(
    job: Job,
    outcome: Outcome,
    *,
    identity: str | None,
    description: Mapping[str, Any],
    outputs: Sequence[Path] = (),
) -> None:
    """Publish what came of a job.  Raises BakeError where the disk refuses, InputError where an
    output is not there.

    outputs : the files of a good bake; kept with their content.
    """
    rows = []
    for path in outputs:
        content = digest(path)
        seen = path.stat()
        name = path.absolute().relative_to(job.root.parent).as_posix()
        rows.append(
            {"path": name, "bytes": seen.st_size, "mtime_ns": seen.st_mtime_ns, "sha256": content}
        )
    entry = {
        "job": job.as_json(),
        "identity": identity,
        "description": description,
        "outputs": rows,
        "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "outcome": outcome.as_json(),
    }
    publish_text(job.record, json.dumps(entry, indent=1) + "\n")


def read_record(job: Job) -> dict[str, Any] | None:
    """The record; None where there is none, or what lies there is none."""
    try:
        entry = json.loads(job.record.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    known = isinstance(entry, dict) and isinstance(entry.get("outcome"), dict)
    return entry if known and isinstance(entry.get("outputs"), list) else None


def finished(job: Job, identity: str | None) -> Outcome | None:
    """The outcome of a bake that need not be done again: the same, good, and its files intact."""
    entry = read_record(job)
    if entry is None or identity is None or entry.get("identity") != identity:
        return None
    outcome = Outcome.of(entry["outcome"])
    sound = outcome.good or (outcome.state == "unsound" and not outcome.findings)
    if not sound or not entry["outputs"]:
        return None
    if not all(intact(job.root.parent / row["path"], row) for row in entry["outputs"]):
        return None
    return replace(outcome, state="kept", attempts=0)


def intact(path: Path, row: Mapping[str, Any]) -> bool:
    """Whether a file is as it was recorded: by size and time, else by content (it was copied)."""
    try:
        seen = path.stat()
    except OSError:
        return False
    if seen.st_size != row["bytes"]:
        return False
    if seen.st_mtime_ns == row["mtime_ns"]:
        return True
    try:
        return digest(path) == row["sha256"]
    except InputError:
        return False
