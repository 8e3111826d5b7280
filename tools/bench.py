"""Measure speed and memory, and write the tables of BENCHMARKS.md.

    python tools/bench.py [--runs 3] [--write]

Without --write the tables go to stdout.  Every figure is the median of the runs.  POSIX only: the
peak memory of a process comes from wait4.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from bench_median import median

ROOT = Path(__file__).resolve().parent.parent
DUCK = ROOT / "samples" / "duck.usda"
REPORT = ROOT / "BENCHMARKS.md"
BEGIN, END = "<!-- tools/bench.py: begin -->", "<!-- tools/bench.py: end -->"
LOOKS = ("rubber", "metal", "jelly")


def process(command: Sequence[str], environment: dict[str, str]) -> tuple[float, float, float]:
    """(wall [s], CPU [s], peak memory [bytes]) of a command that has to succeed."""
    began = time.perf_counter()
    child = subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(child.pid, 0)
    wall = time.perf_counter() - began
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{' '.join(command)} ended with exit status {child.returncode}")
    unit = 1 if sys.platform == "darwin" else 1024
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss * unit


def process_table(runs: int) -> str:
    """Whole commands: the duck with the three looks, a first bake, --help."""
    lines = [
        "| command | wall | CPU | peak memory | spread |",
        "|---|---:|---:|---:|---:|",
    ]
    program = [sys.executable, "-m", "gf_usd"]
    with tempfile.TemporaryDirectory() as folder:
        duck = [*program, "bake", str(DUCK), "--overwrite", "-o", f"{folder}/", "--material"]

        def fresh() -> dict[str, str]:
            cache = tempfile.mkdtemp(dir=folder)
            return {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": cache}

        def warm() -> dict[str, str]:
            return dict(os.environ)

        rows = [
            ("`gf-usd --help`", [*program, "--help"], warm),
            ("`gf-usd bake duck.usda`, kernels not compiled yet", [*duck, "rubber"], fresh),
            *((f"`gf-usd bake duck.usda --material {m}`", [*duck, m], warm) for m in LOOKS),
        ]
        for name, command, environment in rows:
            if environment is warm:
                process(command, environment())
            s = median([process(command, environment()) for _ in range(runs)])
            lines.append(
                f"| {name} | {s.wall:.2f} s | {s.cpu:.2f} s | {s.memory / 1e6:.0f} MB"
                f" | {100 * s.spread:.0f} % |"
            )
            print(lines[-1], file=sys.stderr)
        facts = [dry_run(duck, look) for look in LOOKS]
    return "\n".join([*lines, "", *facts])


def dry_run(duck: Sequence[str], look: str) -> str:
    """What a row of the table computes, in words."""
    done = subprocess.run(
        [*duck, look, "--dry-run", "--json"], check=True, capture_output=True, text=True
    )
    plan = json.loads(done.stdout)
    return (
        f"- {look}: {plan['frames']} frames of {plan['substeps_per_frame'][look]} substeps,"
        f" {plan['particles']} particles"
    )


def machine() -> str:
    """The machine and the versions, without names of anything."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    info = Path("/proc/cpuinfo")
    simd = ", AVX2" if info.exists() and " avx2 " in info.read_text() else ""
    packages = ", ".join(f"{p} {version(p)}" for p in ("taichi", "usd-core", "numpy"))
    return (
        f"{cores} cores, {platform.machine()}{simd}, {platform.system()}, CPU only; Python"
        f" {platform.python_version()}, {packages}."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=3, help="runs of each; the median counts")
    parser.add_argument("--write", action="store_true", help="write into BENCHMARKS.md")
    options = parser.parse_args()
    commands = process_table(options.runs)
    # Linux counts the memory of the process that forked into a child's peak: this one has to be
    # small until the commands are done.
    from bench_solver import solver_table

    tables = "\n\n".join(
        [
            f"{machine()} Median of {options.runs} runs.",
            "### Commands",
            commands,
            "### Solver",
            solver_table(options.runs),
        ]
    )
    if not options.write:
        print(tables)
        return
    head, _, rest = REPORT.read_text("utf-8").partition(BEGIN)
    tail = rest.partition(END)[2]
    REPORT.write_text(f"{head}{BEGIN}\n{tables}\n{END}{tail}", "utf-8")
    print(f"wrote {REPORT.name}", file=sys.stderr)


if __name__ == "__main__":
    main()
