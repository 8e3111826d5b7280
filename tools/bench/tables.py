"""Tables of BENCHMARKS.md: medians of repeated measurements, and the sections between markers.

`tools/bench.py` writes each section between markers of its own.
"""

from __future__ import annotations

import os
import platform
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Median cost of something."""

    wall: float  # [s]
    cpu: float  # [s] of all threads
    spread: float  # (slowest - fastest) / median of the wall times
    memory: float = 0.0  # [bytes] peak resident


def median(runs: Sequence[tuple[float, float, float]]) -> Sample:
    """Median of (wall, cpu, memory) over the runs."""
    wall, cpu, memory = (list(column) for column in zip(*runs, strict=True))
    middle = statistics.median(wall)
    return Sample(
        wall=middle,
        cpu=statistics.median(cpu),
        spread=(max(wall) - min(wall)) / middle,
        memory=statistics.median(memory),
    )


def marks(section: str) -> tuple[str, str]:
    """The comments that a section stands between."""
    return f"<!-- bench {section}: begin -->", f"<!-- bench {section}: end -->"


def put(page: str, section: str, text: str) -> str:
    """The page with the section's text instead of what stood there.

    Raises ValueError where the page has no such section.
    """
    begin, end = marks(section)
    head, found, rest = page.partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"the page has no section between {begin} and {end}")
    return f"{head}{begin}\n{text.strip()}\n{end}{tail}"


def write(path: Path, section: str, text: str) -> None:
    """`put` into a file, all or nothing."""
    partial = path.with_suffix(".partial")
    partial.write_text(put(path.read_text("utf-8"), section, text), "utf-8")
    partial.replace(path)


def machine(versions: dict[str, str]) -> str:
    """The machine and the versions, without names of anything."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    info = Path("/proc/cpuinfo")
    text = info.read_text() if info.exists() else ""
    model = next((x.partition(":")[2].strip() for x in text.splitlines() if "model name" in x), "")
    simd = ", AVX2" if " avx2 " in text else ""
    packages = ", ".join(f"{name} {number}" for name, number in versions.items())
    return (
        f"CPU only: {cores} cores, {model or platform.machine()}{simd}, {platform.system()};"
        f" Python {platform.python_version()}, {packages}."
    )


def load() -> str:
    """How busy the machine is: a table is worth little where others work on it."""
    busy = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return f"Load average at the start {busy:.1f}."
