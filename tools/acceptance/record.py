"""Results of acceptance runs: dated files with the machine and the commit, and a page of them.

    docs/acceptance/DATE-SECTION.json    one run of one section
    docs/acceptance.md                   the newest of each section

Files are written under a temporary name and renamed, so that a kill leaves no partial file.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "acceptance"
PAGE = ROOT / "docs" / "acceptance.md"
PACKAGES = ("gf-usd", "taichi", "usd-core", "numpy", "scipy")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a section found."""

    passed: bool
    summary: str  # a line for the page
    table: tuple[tuple[str, ...], ...]  # the head and the rows of the page
    data: Any  # everything, for the file


@dataclass(frozen=True, kw_only=True)
class Record:
    """One run of one section."""

    section: str
    title: str
    date: str  # ISO 8601, UTC
    commit: str
    changed: bool  # the working tree differs from the commit
    machine: str
    versions: dict[str, str]
    command: str
    seconds: float
    outcome: Outcome


def git(*arguments: str) -> str:
    """Output of a git command that reads; "" outside a repository."""
    done = subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip()


def machine() -> str:
    """Cores, processor and system, without names of anything."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{cores} cores, {platform.machine()}, {platform.system()}"


def record(
    section: str, title: str, command: Sequence[str], seconds: float, outcome: Outcome
) -> Record:
    """An outcome with the circumstances it was found in."""
    return Record(
        section=section,
        title=title,
        date=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        commit=git("rev-parse", "HEAD"),
        changed=bool(git("status", "--porcelain", "--untracked-files=no")),
        machine=machine(),
        versions={"python": platform.python_version(), **{p: version(p) for p in PACKAGES}},
        command=" ".join(command),
        seconds=round(seconds, 1),
        outcome=outcome,
    )


def write(path: Path, text: str) -> None:
    """Put a whole file in its place, or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
    ) as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


def save(made: Record, folder: Path = FOLDER) -> Path:
    """Write a record under its date and section; a second run on a day replaces the first."""
    path = folder / f"{made.date[:10]}-{made.section}.json"
    write(path, json.dumps(asdict(made), indent=1, ensure_ascii=False) + "\n")
    return path


def newest(folder: Path = FOLDER) -> list[dict[str, Any]]:
    """The latest record of each section, by the sections' names."""
    latest = {path.stem[11:]: path for path in sorted(folder.glob("????-??-??-*.json"))}
    return [json.loads(latest[name].read_text("utf-8")) for name in sorted(latest)]


def page(records: Sequence[dict[str, Any]]) -> str:
    """The readable page of records."""
    lines = [
        "# Acceptance",
        "",
        "The newest run of each section of `python tools/acceptance.py`.  The last run of each day"
        " is kept in `docs/acceptance/` with all its figures.",
    ]
    for r in records:
        outcome = r["outcome"]
        head, *rows = outcome["table"]
        state = f"`{r['commit'][:12]}`{' with changes' if r['changed'] else ''}"
        versions = ", ".join(f"{name} {number}" for name, number in r["versions"].items())
        lines += [
            "",
            f"## {r['title']}",
            "",
            f"{'Passed' if outcome['passed'] else '**Failed**'}: {outcome['summary']}",
            "",
            f"{r['date'][:10]}, commit {state}, {r['seconds']:.0f} s on {r['machine']}; {versions}."
            f"  `{r['command']}`",
            "",
            "| " + " | ".join(head) + " |",
            "|---" * len(head) + "|",
            *("| " + " | ".join(row) + " |" for row in rows),
        ]
    return "\n".join(lines) + "\n"
