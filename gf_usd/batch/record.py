"""The record of a job, in a file next to its result: ``NAME.job.json``.

When two bakes would be the same: the same inputs, options, program and schema.

What the jobs' assets consist of, found out in another process.

USD may crash on a damaged file; so it reads them in a child, which names each asset when it is done
with it.  What a crash was at is left out, and the child goes on with the next.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.manifest import decisive, material_files, obstacle_files
from gf_usd.core.errors import InputError
from gf_usd.readers.inputs import digest
from gf_usd.system.atomic_files import publish_text
from gf_usd.system.fingerprint import program
from gf_usd.system.processes import Children


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


def read_by(job: Job) -> tuple[Path, ...]:
    """The files that a job names itself: the asset, and files with a material."""
    return (job.asset, *material_files(job.options), *obstacle_files(job.options))


def describe(job: Job, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """All that decides what a job writes, as plain values.

    inputs : for each path of `read_by`, ``{"files": [[relative path, sha256], ...], "missing":
    [...]}`` of `readers.inputs`.  Files count by their content and by where they lie relative
    to the asset; the asset by where it lies relative to the result, which refers to it.
    """
    return {
        **program(),
        "inputs": [inputs[str(path)] for path in read_by(job)],
        "options": decisive(_portable(job)),
        "asset": job.asset.name,
        "from_result": Path(os.path.relpath(job.asset, job.root.parent)).as_posix(),
        "name": job.root.name,
    }


def _portable(job: Job) -> dict[str, Any]:
    """Options in which material files are named without their folder; their content counts."""
    parts = [Path(m).name if "/" in m or "\\" in m else m for m in job.materials]
    return {**job.options, "material": ",".join(parts)}


def identity(description: Mapping[str, Any]) -> str:
    """sha256 of a description."""
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


AT_ONCE = 200  # assets of one child: a command line has an end
PATIENCE = 120.0  # [s] for one asset: a large mesh takes seconds


class InputTable:
    """The inputs of assets by path; each is read once.

    A row is ``{"files": [[path, sha256], ...], "missing": [...]}``, or ``{"error": why}`` for what
    cannot be read: a bake will say more.  Safe for threads.
    """

    def __init__(self, children: Children, rows: Mapping[str, Any] | None = None) -> None:
        self._children = children
        self._rows: dict[str, Any] = dict(rows or {})
        self._lock = threading.Lock()

    def read(self, paths: Iterable[Path]) -> dict[str, Any]:
        """The rows of these paths."""
        wanted = [str(path) for path in paths]
        with self._lock:
            todo = [name for name in dict.fromkeys(wanted) if name not in self._rows]
            for start in range(0, len(todo), AT_ONCE):
                self._rows.update(_ask(self._children, todo[start : start + AT_ONCE]))
        return {name: self._rows[name] for name in wanted}


def _ask(children: Children, names: Sequence[str]) -> dict[str, Any]:
    """Rows of all the names, asking as many children as crash."""
    rows: dict[str, Any] = {}
    while left := [name for name in names if name not in rows]:
        # it is a child itself, which may crash and has its time
        arguments = ("inputs", "--limits", "none", "--json")
        command = [sys.executable, "-m", "gf_usd", *arguments, *left]
        ended = children.run(command, lambda line: None, timeout=PATIENCE + len(left))
        if ended is None or ended.stopped:
            return {**{name: {"error": "interrupted"} for name in left}, **rows}
        # a line that a crash cut short says nothing
        for line in ended.out[: ended.out.rfind("\n") + 1].splitlines():
            row = json.loads(line)
            rows[row.pop("asset")] = row
        first = next((name for name in left if name not in rows), None)
        if first is not None:
            how = "took too long" if ended.timed_out else f"ended with status {ended.status}"
            rows[first] = {"error": f"reading {first} {how}"}
    return rows


def stamps(inputs: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
    """(size, time of change) of every file of the rows: another one means another content."""
    found = {}
    for name, row in inputs.items():
        for file, _ in row.get("files", ()):
            path = Path(name).absolute().parent / file
            try:
                seen = path.stat()
            except OSError:
                found[str(path)] = (-1, -1)
            else:
                found[str(path)] = (seen.st_size, seen.st_mtime_ns)
    return found
