"""Run gf-usd and its peers on the same elastic drop, on the same cores, one after the other.

    python tools/bench_compare.py [--only gf-usd,taichi] [--sizes 1000,10000] [--runs 3]
                                  [--cores 1] [--seconds 2] [--jobs speed,drop] [--json FILE]

Peers are installed from PyPI into environments of their own below --into, once.  Runs are taken in
turns, so that what else the machine does strikes all alike; every figure is a median, and ratios
are taken of CPU time.  POSIX only: processes are held to their cores by sched_setaffinity.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import clients
from bench_limits import limits

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = ROOT / "tools" / "bench_peers"
TIMEOUT = 300.0  # [s] of one process, the compilation included
SIZES = "1000,10000,100000"


@dataclass(frozen=True)
class Peer:
    """A solver: a script, and what it needs; no requirements: this environment."""

    script: str
    name: str
    requirements: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ()
    most: int = 1_000_000  # particles that it is given


PEERS = {
    "gf-usd": Peer("gf_usd_solver.py", "gf-usd"),
    "ul": Peer("gf_usd_solver.py", "gf-usd, UL baseline", arguments=("ul",)),
    "taichi": Peer("taichi_mpm.py", "Taichi's stock MLS-MPM", ("taichi>=1.7.4,<2", "numpy>=2")),
    "genesis": Peer("genesis_mpm.py", "genesis-world MPM", ("genesis-world==1.4.5", "torch"),
                    most=100_000),
}  # fmt: skip


def interpreter(key: str, into: Path) -> str:
    """The Python of a peer; installs what is missing.

    Raises clients.NotInstalled where pip fails.
    """
    peer = PEERS[key]
    if not peer.requirements:
        return sys.executable
    proof = f"import {peer.requirements[0].partition('>')[0].partition('=')[0].split('-')[0]}"
    clients.CLIENTS[key] = clients.Client(peer.requirements, proof)
    print(f"{key}: {clients.set_up(key, into, [])}", file=sys.stderr, flush=True)
    return str(into.resolve() / key / "bin" / "python")


def run(python: str, peer: Peer, job: dict[str, Any], cores: list[int]) -> dict[str, Any]:
    """One process: its result, or {"failed": why}."""
    told = json.dumps(job | {"began": time.time()})
    command = [python, "-W", "ignore", str(SCRIPTS / peer.script), told, *peer.arguments]
    # gf-usd is the one that lies beside this file, not another that may be installed
    environment = {**os.environ, "PYTHONPATH": str(ROOT)} if not peer.requirements else None
    pin: Callable[[], None] = lambda: os.sched_setaffinity(0, cores)  # noqa: E731
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT, check=False,
            env=environment, preexec_fn=pin,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"no result within {TIMEOUT:.0f} s"}
    lines = (done.stdout.strip() or " ").splitlines()
    if done.returncode or not lines[-1].startswith("{"):
        said = (done.stderr or done.stdout).strip().splitlines()[-1:]
        return {"failed": " ".join(said) or f"exit status {done.returncode}"}
    return json.loads(lines[-1])


def middle(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of the numbers of the runs that succeeded; the first failure where none did."""
    good = [r for r in runs if "failed" not in r]
    if not good:
        return runs[0]
    return {
        key: statistics.median(r[key] for r in good) if isinstance(value, int | float) else value
        for key, value in good[0].items()
    }


def speed_table(n: int, rows: dict[str, dict[str, Any]]) -> list[str]:
    """Particle-substeps a second, and how many times slower than gf-usd per CPU second."""
    lines = [
        f"#### {n:,} particles, dt {next(iter(rows.values())).get('dt', 0.0) * 1e3:.3f} ms",
        "",
        "| solver | M/s, CPU | M/s, wall | ms a frame of 1/60 s | gf-usd is faster"
        " | start-up, CPU | peak memory |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    own = rows.get("gf-usd", {})
    for key, r in rows.items():
        name = PEERS[key].name
        if "failed" in r:
            lines.append(f"| {name} | failed: {r['failed']} | | | | | |")
            continue
        count = r["particles"]
        ratio = ""
        if "cpu" in own:
            ratio = f"{(r['cpu'] / count) / (own['cpu'] / own['particles']):.1f} x"
        lines.append(
            f"| {name} | {count / r['cpu'] / 1e6:.2f} | {count / r['wall'] / 1e6:.2f}"
            f" | {1e3 * r['wall'] * r['frame']:.2f} | {ratio} | {r['start_up_cpu']:.1f} s"
            f" | {r['memory'] / 1e6:.0f} MB |"
        )
    return [*lines, ""]


def drop_table(results: dict[int, dict[str, dict[str, Any]]], truth: dict[str, Any]) -> list[str]:
    """What the drop came to, its error beside `truth`, and simulated seconds a second."""
    lines = [
        f"Errors are measured from gf-usd with {truth['particles']:,} particles: squash"
        f" {truth['squash']:.4f} of the height at rest, rebound {truth['rebound']:.4f} m.",
        "",
        "| solver | particles | squash | rebound | worst error | simulated s a CPU second |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for rows in results.values():
        for key, r in rows.items():
            if "squash" not in r:
                lines.append(f"| {PEERS[key].name} | failed: {r.get('failed', '')} | | | | |")
                continue
            worst = max(abs(r[k] / truth[k] - 1.0) for k in ("squash", "rebound"))
            lines.append(
                f"| {PEERS[key].name} | {r['particles']:,.0f} | {r['squash']:.4f}"
                f" | {r['rebound']:.4f} m | {100 * worst:.1f} % | {r['simulated'] / r['cpu']:.3g} |"
            )
    return [*lines, ""]


def main() -> None:
    """Measure, and print the tables as Markdown."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default=",".join(PEERS), help="default: %(default)s")
    parser.add_argument("--sizes", default=SIZES, help="particles; default: %(default)s")
    parser.add_argument("--drop-sizes", default="1000,10000", help="default: %(default)s")
    parser.add_argument("--jobs", default="limits,speed,drop", help="default: %(default)s")
    parser.add_argument("--runs", type=int, default=3, help="of each; the median counts")
    parser.add_argument("--cores", type=int, default=1, help="cores that every process is held to")
    parser.add_argument("--seconds", type=float, default=2.0, help="of stepping in a speed run")
    parser.add_argument("--into", type=Path, default=ROOT / ".clients", help="default: .clients")
    parser.add_argument("--json", type=Path, help="write all results there too")
    options = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))[: options.cores]
    jobs, names = options.jobs.split(","), options.only.split(",")
    unknown = [name for name in names if name not in PEERS]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)} (choose from {', '.join(PEERS)})")
    kept: dict[str, Any] = {}
    if "limits" in jobs:
        kept["limits"] = found = limits(cores)
        print(f"Limits of {len(cores)} core(s): {found['text']}\n", flush=True)
    pythons = {}
    for name in names:
        try:
            pythons[name] = interpreter(name, options.into)
        except clients.NotInstalled as error:
            print(f"{name}: not installed: {error}", file=sys.stderr, flush=True)

    def measure(job: dict[str, Any], runs: int) -> dict[str, dict[str, Any]]:
        taken: dict[str, list[dict[str, Any]]] = {}
        for _ in range(runs):
            for name, python in pythons.items():
                if job["n"] <= PEERS[name].most and "failed" not in taken.get(name, [{}])[0]:
                    taken.setdefault(name, []).append(run(python, PEERS[name], job, cores))
        return {name: middle(results) for name, results in taken.items()}

    if "speed" in jobs:
        kept["speed"] = {}
        for n in (int(size) for size in options.sizes.split(",")):
            rows = measure({"kind": "speed", "n": n, "seconds": options.seconds}, options.runs)
            kept["speed"][n] = rows
            print("\n".join(speed_table(n, rows)), flush=True)
    if "drop" in jobs:
        sizes = [int(size) for size in options.drop_sizes.split(",")]
        kept["drop"] = {n: measure({"kind": "drop", "n": n}, 1) for n in sizes}
        fine = run(sys.executable, PEERS["gf-usd"], {"kind": "drop", "n": 4 * max(sizes)}, cores)
        if "failed" in fine:
            raise SystemExit(f"the drop that errors are measured from failed: {fine['failed']}")
        kept["truth"] = fine
        print("\n".join(drop_table(kept["drop"], fine)), flush=True)
    if options.json:
        options.json.write_text(json.dumps(kept, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
