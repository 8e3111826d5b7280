"""Particle-substeps a second of gf-usd and its peers, taken in turns."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from tools.bench.processes import PEERS, middle, run

LIMIT = 150.0  # [s] of one process, its compilation included
ONCE = 1_000_000  # so many particles or more are run once, in twice the time: it is mostly set-up

Results = dict[tuple[str, int], list[dict[str, Any]]]


def rounds(
    cells: Sequence[Any],
    measure: Callable[[Any], dict[str, Any]],
    runs: int,
    seconds: float,
    clock: Callable[[], float] = time.perf_counter,
    once: Callable[[Any], bool] = lambda cell: False,
) -> dict[Any, list[dict[str, Any]]]:
    """Measure every cell `runs` times, a round of all of them after another.

    In turns, so that what else the machine does strikes all alike.  No round after the first
    begins a cell that, by what it took before, would end after `seconds`.  A cell that failed is
    not tried again.
    """
    end = clock() + seconds
    took: dict[Any, float] = {}
    found: dict[Any, list[dict[str, Any]]] = {}
    for turn in range(runs):
        for cell in cells:
            if turn and (once(cell) or cell not in found or "failed" in found[cell][0]):
                continue
            began = clock()
            if began + took.get(cell, 0.0) > end:
                continue
            result = measure(cell)
            took[cell] = clock() - began
            found.setdefault(cell, []).append(result)
    return found


def peers(
    pythons: dict[str, str], cores: list[int], runs: int, seconds: float, stepping: float
) -> Results:
    """Runs of every solver at every size that it is given."""
    sizes = sorted({n for key in pythons for n in PEERS[key].sizes})
    cells = [(key, n) for n in sizes for key in pythons if n in PEERS[key].sizes]

    def measure(cell: tuple[str, int]) -> dict[str, Any]:
        key, n = cell
        job = {"kind": "speed", "n": n, "seconds": stepping}
        result = run(pythons[key], PEERS[key], job, cores, 2.0 * LIMIT if n >= ONCE else LIMIT)
        outcome = result.get("failed") or f"{rate(result, 'cpu'):.2f} M/s of CPU"
        print(f"  {PEERS[key].name}, {n:,}: {outcome}", file=sys.stderr, flush=True)
        return result

    return rounds(cells, measure, runs, seconds, once=lambda cell: cell[1] >= ONCE)


def rate(result: dict[str, Any], clock: str) -> float:
    """Million particle-substeps a second."""
    return result["particles"] / result[clock] / 1e6


def peer_tables(results: Results) -> list[str]:
    """A table for each size; ratios are taken of CPU time."""
    lines = []
    for n in sorted({n for _, n in results}):
        rows = {key: middle(r) for (key, m), r in results.items() if m == n}
        own = rows.get("gf-usd", {"failed": ""})
        dt = next((r["dt"] for r in rows.values() if "dt" in r), 0.0)
        lines += [
            f"**{n:,} particles**, substeps of {1e3 * dt:.2f} ms",
            "",
            "| solver | M/s, CPU | M/s, wall | ms a frame of 1/60 s | gf-usd is faster, CPU"
            " | start-up, CPU | peak memory | runs |",
            "|---|---:|---:|---:|---:|---:|---:|---:|",
        ]
        for key, r in rows.items():
            if "failed" in r:
                lines.append(f"| {PEERS[key].name} | failed: {r['failed']} | | | | | | |")
                continue
            ratio = "" if "failed" in own else f"{rate(own, 'cpu') / rate(r, 'cpu'):.1f} x"
            frame = 1e3 * r["wall"] / r["dt"] / 60.0
            lines.append(
                f"| {PEERS[key].name} | {rate(r, 'cpu'):.3g} | {rate(r, 'wall'):.3g} | {frame:.2f}"
                f" | {ratio} | {r['start_up_cpu']:.1f} s | {r['memory'] / 1e6:.0f} MB"
                f" | {r['runs']:.0f} |"
            )
        lines.append("")
    return lines


def remarks() -> list[str]:
    """What the table does not say of the peers."""
    return [f"- {p.name}: {p.remark}." for p in PEERS.values() if p.remark]


def size_ratio(results: Results, small: int = 10_000, large: int = 1_000_000) -> str:
    """Cost of a particle-substep with many particles over that with few."""
    pair = [middle(results.get(("gf-usd", n), [{"failed": ""}])) for n in (large, small)]
    if any("failed" in r for r in pair):
        return "- Cost at 1M over cost at 10k: not measured."
    ratio = rate(pair[1], "cpu") / rate(pair[0], "cpu")
    return f"- A particle-substep costs {ratio:.2f} times as much CPU at 1M particles as at 10k."


def thread_scaling(
    python: str, cores: list[int], runs: int, seconds: float, n: int = 100_000
) -> list[str]:
    """gf-usd on one core and on all, in turns."""
    if len(cores) < 2:
        return ["One core only: nothing to compare."]

    def measure(count: int) -> dict[str, Any]:
        job = {"kind": "speed", "n": n, "seconds": 3.0}
        return run(python, PEERS["gf-usd"], job, cores[:count], LIMIT)

    found = rounds([1, 2], measure, runs, seconds)
    rows = {count: middle(results) for count, results in found.items()}
    lines = ["| threads | M/s, wall | M/s, CPU | runs |", "|---:|---:|---:|---:|"]
    for count, r in rows.items():
        if "failed" in r:
            return [f"Failed with {count} threads: {r['failed']}."]
        lines.append(
            f"| {count} | {rate(r, 'wall'):.2f} | {rate(r, 'cpu'):.2f} | {r['runs']:.0f} |"
        )
    if len(rows) == 2:
        gain = rate(rows[2], "wall") / rate(rows[1], "wall")
        lines += ["", f"Two threads are {gain:.2f} times as fast as one, {n:,} particles."]
    return lines
