"""Whole commands, from start to exit: wall time, CPU time and peak memory."""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tools.bench.tables import median

ROOT = Path(__file__).resolve().parents[2]
DUCK = ROOT / "samples" / "duck.usda"
SPHERE = ROOT / "samples" / "sphere.usda"
DIMENSIONLESS = ("rubber", "metal", "jelly")


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


def children_cpu() -> float:
    """[s] that processes of this one have used and ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def pace() -> float:
    """CPU time [s] of a loop in Python: how fast the machine is just now, whoever shares it."""
    began, total = time.process_time(), 0
    for number in range(2_000_000):
        total += number
    return time.process_time() - began


def command_table(runs: int, seconds: float) -> list[str]:
    """The duck with the three presets, the paper's sphere, a first bake, --help.

    Rows that there is no time for in `seconds` are left out, and marked so.
    """
    end = time.perf_counter() + seconds
    lines = [
        "| command | wall | CPU | machine | peak memory | spread | runs |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    measured: list[tuple[str, list[tuple[float, float, float]], list[float]]] = []
    program = [sys.executable, "-m", "gf_usd"]
    with tempfile.TemporaryDirectory() as folder:
        variables = {**os.environ, "PYTHONPATH": str(ROOT)}
        sphere = [*program, "bake", str(SPHERE), "--overwrite", "-o", f"{folder}/"]
        duck = [*program, "bake", str(DUCK), "--overwrite", "-o", f"{folder}/", "--material"]

        def fresh() -> dict[str, str]:
            cache = tempfile.mkdtemp(dir=folder)
            return {**variables, "TI_OFFLINE_CACHE_FILE_PATH": cache}

        def warm() -> dict[str, str]:
            return variables

        rows = [
            ("`gf-usd --help`", [*program, "--help"], warm),
            ("`gf-usd bake sphere.usda --preset paper`", [*sphere, "--preset", "paper"], warm),
            *((f"`gf-usd bake duck.usda --material {m}`", [*duck, m], warm) for m in DIMENSIONLESS),
            ("`gf-usd bake duck.usda`, kernels not compiled yet", [*duck, "rubber"], fresh),
        ]
        for name, command, environment in rows:
            took, paces = [], [pace()]
            if environment is warm and time.perf_counter() < end:
                process(command, environment())
            while len(took) < runs and time.perf_counter() < end:
                took.append(process(command, environment()))
                paces.append(pace())
            measured.append((name, took, paces))
            print(f"  {name}: {[round(cpu, 2) for _, cpu, _ in took]}", file=sys.stderr, flush=True)
        facts = [dry_run(duck, look, variables) for look in DIMENSIONLESS]
    best = min(one for _, _, paces in measured for one in paces)
    for name, took, paces in measured:
        if not took:
            lines.append(f"| {name} | not measured: no time left | | | | | |")
            continue
        s = median(took)
        lines.append(
            f"| {name} | {s.wall:.2f} s | {s.cpu:.2f} s | {statistics.median(paces) / best:.2f}"
            f" | {s.memory / 1e6:.0f} MB | {100 * s.spread:.0f} % | {len(took)} |"
        )
    return [*lines, "", *facts]


def dry_run(duck: Sequence[str], look: str, environment: dict[str, str]) -> str:
    """What a row of the table computes, as text."""
    done = subprocess.run(
        [*duck, look, "--dry-run", "--json"], check=True, capture_output=True, text=True,
        env=environment,
    )  # fmt: skip
    plan = json.loads(done.stdout)
    return (
        f"- {look}: {plan['frames']} frames of {plan['substeps_per_frame'][look]} substeps,"
        f" {plan['particles']} particles"
    )
