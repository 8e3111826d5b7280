"""The record of a job, in a file next to its result: ``NAME.job.json``.

Two bakes are the same if their inputs, options, program and schema are.  The input files of assets
are determined in a child process, because USD may crash on a damaged file.  The child names each
asset when it is done with it; after a crash, another child continues with the next asset.
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
from gf_usd.batch.manifest import material_files, obstacle_files, result_options
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
    """Publish the outcome of a job.

    Raises BakeError where the file cannot be written, InputError where an output is missing.
    outputs : the files of a good bake, which are recorded with their content hash.
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
    """The record; None where there is no valid one."""
    try:
        entry = json.loads(job.record.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    known = isinstance(entry, dict) and isinstance(entry.get("outcome"), dict)
    return entry if known and isinstance(entry.get("outputs"), list) else None


def finished(job: Job, identity: str | None) -> Outcome | None:
    """The outcome of an earlier bake that is the same, good, and whose files are unchanged; else
    None.
    """
    entry = read_record(job)
    if entry is None or identity is None or entry.get("identity") != identity:
        return None
    outcome = Outcome.of(entry["outcome"])
    sound = outcome.good or (outcome.state == "unsound" and not outcome.findings)
    if not sound or not entry["outputs"]:
        return None
    if not all(is_unchanged(job.root.parent / row["path"], row) for row in entry["outputs"]):
        return None
    return replace(outcome, state="kept", attempts=0)


def is_unchanged(path: Path, row: Mapping[str, Any]) -> bool:
    """Whether a file is as recorded: by size and time, else by content, since it may be a copy."""
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


def input_paths(job: Job) -> tuple[Path, ...]:
    """The files that a job names: the asset, and material files."""
    return (job.asset, *material_files(job.options), *obstacle_files(job.options))


def describe(job: Job, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Everything that determines the result of a job, as plain values.

    inputs : for each path of `input_paths`, ``{"files": [[relative path, sha256], ...], "missing":
        [...]}`` of `readers.inputs`.  Files count by content and by location relative to the asset;
        the asset counts by location relative to the result, which refers to it.
    """
    return {
        **program(),
        "inputs": [inputs[str(path)] for path in input_paths(job)],
        "options": result_options(_portable(job)),
        "asset": job.asset.name,
        "from_result": Path(os.path.relpath(job.asset, job.root.parent)).as_posix(),
        "name": job.root.name,
    }


def _portable(job: Job) -> dict[str, Any]:
    """Options with material files named without their folder, since their content counts."""
    parts = [Path(m).name if "/" in m or "\\" in m else m for m in job.materials]
    return {**job.options, "material": ",".join(parts)}


def identity(description: Mapping[str, Any]) -> str:
    """sha256 of a description."""
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


AT_ONCE = 200  # assets of one child, because the length of a command line is limited
PATIENCE = 120.0  # [s] for one asset: a large mesh takes seconds


class InputTable:
    """The inputs of assets by path; each asset is read once.

    A row is ``{"files": [[path, sha256], ...], "missing": [...]}``, or ``{"error": why}`` for an
    asset that cannot be read, on which the bake reports more.  Thread-safe.
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
                self._rows.update(_read_inputs(self._children, todo[start : start + AT_ONCE]))
        return {name: self._rows[name] for name in wanted}


def _read_inputs(children: Children, names: Sequence[str]) -> dict[str, Any]:
    """The rows of all names, with a new child after each crash."""
    rows: dict[str, Any] = {}
    while left := [name for name in names if name not in rows]:
        # the child may crash, and has a time limit
        arguments = ("inputs", "--limits", "none", "--json")
        command = [sys.executable, "-m", "gf_usd", *arguments, *left]
        ended = children.run(command, lambda line: None, timeout=PATIENCE + len(left))
        if ended is None or ended.stopped:
            return {**{name: {"error": "interrupted"} for name in left}, **rows}
        # a line that a crash cut short
        for line in ended.out[: ended.out.rfind("\n") + 1].splitlines():
            row = json.loads(line)
            rows[row.pop("asset")] = row
        first = next((name for name in left if name not in rows), None)
        if first is not None:
            how = "took too long" if ended.timed_out else f"ended with status {ended.status}"
            rows[first] = {"error": f"reading {first} {how}"}
    return rows


def file_stamps(inputs: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
    """(size, modification time) of every file of the rows, which change with its content."""
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
