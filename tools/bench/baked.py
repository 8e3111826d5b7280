"""Particle-substeps per second of a whole bake and of other MPM solvers in the same run.

    python -m tools.bench.baked [--particles N ...] [--turns N] [--peers taichi,genesis]

`gf-usd bake` of a ball of rubber: damping, filter, contact with friction, health, Gaussians, mesh
and USD files, all with their defaults. The times of two bakes of different length are subtracted,
so that the start and the set-up do not count, but the output and checks of every frame do. Times
are CPU seconds of all threads, with one solver thread; the peers have no damping and no friction,
and write nothing. Results are medians over turns in which each program runs once. Peers are
installed from PyPI into environments of their own below --into, once.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from tools.bench.processes import ALONE, PEERS, ROOT, interpreter, run

FRAMES = (24, 96)  # the ball touches the floor in the first of them and rebounds in the second
ASSET = ROOT / "samples" / "sphere.usda"


def bake(particles: int, frames: int, folder: Path) -> tuple[float, int]:
    """CPU seconds of a bake, and its particles times its substeps."""
    command = [
        *(sys.executable, "-m", "gf_usd", "bake", str(ASSET), "--material", "rubber"),
        *("--particles", str(particles), "--frames", str(frames), "--threads", "1"),
        *("-o", f"{folder}/", "--overwrite", "--json"),
    ]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        command, capture_output=True, text=True, check=True,
        env={**os.environ, **ALONE, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads(done.stdout)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, report["particles"] * report["bakes"][0]["health"]["substeps"]


def rate(particles: int) -> float:
    """Million particle-substeps a CPU second of the longer bake beyond the shorter one."""
    with tempfile.TemporaryDirectory() as folder:
        (short, few), (long, many) = (bake(particles, n, Path(folder)) for n in FRAMES)
    return (many - few) / (long - short) / 1e6


def rate_of(key: str, python: str, particles: int) -> float:
    """The same of a peer on the drop of `tools/bench/scene.py`.

    Raises SystemExit with its message where it fails.
    """
    job = {"kind": "speed", "n": particles, "seconds": 3.0}
    found = run(python, PEERS[key], job, [0], 150.0)
    if "failed" in found:
        raise SystemExit(f"{PEERS[key].name}, {particles:,} particles: {found['failed']}")
    return found["particles"] / found["cpu"] / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--particles", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--peers", default="taichi", help="of tools/bench.py, default: %(default)s")
    parser.add_argument("--into", type=Path, default=ROOT / ".clients", help="default: .clients")
    args = parser.parse_args()
    keys = args.peers.split(",")
    if unknown := sorted(set(keys) - set(PEERS)):
        parser.error(f"unknown: {', '.join(unknown)} (choose from {', '.join(PEERS)})")
    # Taichi is installed here already.
    pythons = {k: sys.executable if k == "taichi" else interpreter(k, args.into) for k in keys}
    with tempfile.TemporaryDirectory() as folder:
        bake(1000, 2, Path(folder))  # compiles the kernels
    names = " | ".join(f"{PEERS[k].name}, M/s | ratio" for k in keys)
    print(f"| particles | whole bake, M/s | {names} |\n|---:|---:|{'---:|---:|' * len(keys)}")
    for n in args.particles:
        turns = [
            [rate(n), *(rate_of(key, python, n) for key, python in pythons.items())]
            for _ in range(args.turns)
        ]
        own, *others = (median(column) for column in zip(*turns))
        ratios = [median(turn[0] / turn[k] for turn in turns) for k in range(1, 1 + len(keys))]
        cells = " | ".join(f"{other:.2f} | {by:.1f}" for other, by in zip(others, ratios))
        print(f"| {n:,} | {own:.2f} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
