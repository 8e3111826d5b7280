"""Measure gf-usd and its peers side by side, and write the tables of BENCHMARKS.md.

    python tools/bench.py [--write] [--sections peers,error] [--only gf-usd,taichi]
                          [--runs 3] [--minutes 25] [--cores 1]

Peers are installed from PyPI into environments of their own below --into, once.  Every process is
restricted to the same cores, solvers take turns, and every figure is a median. A section is written
when it is complete, so that finished sections remain after an interrupt. Each has a share of the
minutes: after the first round, a run is started only if it would end in time.  Without --write the
tables go to stdout only.  POSIX only.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from tools.bench import equal_error, speed, tables
from tools.bench.commands import command_table
from tools.bench.limits import limits
from tools.bench.processes import PEERS, interpreters

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / "BENCHMARKS.md"
# Of the minutes; what a section leaves over goes to those after it.
SHARES = {
    "limits": 0.02, "peers": 0.40, "threads": 0.06, "error": 0.35, "commands": 0.11, "solver": 0.06
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="write into BENCHMARKS.md")
    parser.add_argument("--sections", default=",".join(SHARES), help="default: %(default)s")
    parser.add_argument("--only", default=",".join(PEERS), help="default: %(default)s")
    parser.add_argument("--runs", type=int, default=3, help="at most; the median counts")
    parser.add_argument("--minutes", type=float, default=25.0, help="default: %(default)s")
    parser.add_argument("--cores", type=int, default=1, help="cores that a process is held to")
    parser.add_argument("--seconds", type=float, default=1.5, help="of stepping in a speed run")
    parser.add_argument("--into", type=Path, default=ROOT / ".clients", help="default: .clients")
    options = parser.parse_args()
    sections, names = options.sections.split(","), options.only.split(",")
    for given, known in ((sections, SHARES), (names, PEERS)):
        unknown = [name for name in given if name not in known]
        if unknown:
            parser.error(f"unknown: {', '.join(unknown)} (choose from {', '.join(known)})")
    every = sorted(os.sched_getaffinity(0))
    cores = every[: options.cores]
    pythons = interpreters(names, options.into)
    own = {p: version(p) for p in ("gf-usd", "taichi", "usd-core", "numpy")}
    stamp = f"{tables.machine(own)} {tables.load()}"

    def peers(seconds: float) -> list[str]:
        found = speed.peers(pythons, cores, options.runs, seconds, options.seconds)
        seen = [r["versions"] for runs in found.values() for r in runs if "versions" in r]
        versions = {name: number for one in seen for name, number in one.items()}
        return [
            f"Restricted to {len(cores)} core(s). Versions: "
            + ", ".join(f"{name} {number}" for name, number in versions.items())
            + f". A process has {speed.LIMIT:.0f} s, with a million particles twice that.",
            "",
            *speed.remarks(),
            "",
            *speed.peer_tables(found),
            speed.size_ratio(found),
        ]

    def solver(seconds: float) -> list[str]:
        # Linux counts the memory of the process that forked into a child's peak: this one has to
        # stay small until the commands are done.
        from tools.bench.solver import solver_table

        return solver_table(options.runs, seconds)

    jobs: dict[str, Callable[[float], list[str]]] = {
        "limits": lambda seconds: [
            f"{len(held)} core(s): {limits(held)['text']}.  " for held in (cores, every)
        ],
        "peers": peers,
        "threads": lambda seconds: speed.thread_scaling(
            sys.executable, every, options.runs, seconds
        ),
        "error": lambda seconds: equal_error.table(pythons, cores, seconds),
        "commands": lambda seconds: command_table(options.runs, seconds),
        "solver": solver,
    }
    began, end = time.perf_counter(), time.perf_counter() + 60.0 * options.minutes
    for at, section in enumerate(sections):
        left = end - time.perf_counter()
        seconds = left * SHARES[section] / sum(SHARES[name] for name in sections[at:])
        print(f"{section}: {seconds:.0f} s", file=sys.stderr, flush=True)
        lines = jobs[section](seconds)
        text = "\n".join([stamp, "", *lines])
        if options.write:
            tables.write(REPORT, section, text)
        print(f"{text}\n", flush=True)
    print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
