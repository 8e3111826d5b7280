"""Particle-substeps per second of a whole bake and of other MPM solvers in the same run.

    python -m tools.bench.baked [--particles N ...] [--turns N] [--peers taichi,genesis]
    python -m tools.bench.baked --damping ASSET ... [--turns N]

`gf-usd bake` of a ball of rubber: damping, filter, contact with friction, health, Gaussians, mesh
and USD files, all with their defaults. The times of two bakes of different length are subtracted,
so that the start and the set-up do not count, but the output and checks of every frame do. Times
are CPU seconds of all threads, with one solver thread; the peers have no damping and no friction,
and write nothing. Results are medians over turns in which each program runs once. Peers are
installed from PyPI into environments of their own below --into, once.

--damping measures instead what viscosity and the filter cost a whole bake of an asset: its rate
with the defaults, and in turn its rate without both.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

from tools.bench.processes import ALONE, PEERS, ROOT, interpreter, run

FRAMES = (24, 96)  # the ball touches the floor in the first of them and rebounds in the second
ASSET = ROOT / "samples" / "sphere.usda"
UNDAMPED = ("--damping-time", "0", "--filter-rate", "0")


def bake(asset: Path, frames: int, folder: Path, options: Sequence[str]) -> tuple[float, int]:
    """CPU seconds of a bake, and its particles times its substeps."""
    command = [
        *(sys.executable, "-m", "gf_usd", "bake", str(asset), "--material", "rubber"),
        *("--frames", str(frames), "--threads", "1"),
        *("-o", f"{folder}/", "--overwrite", "--json", *options),
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


def rate(asset: Path, options: Sequence[str]) -> float:
    """Million particle-substeps a CPU second of the longer bake beyond the shorter one."""
    with tempfile.TemporaryDirectory() as folder:
        (short, few), (long, many) = (bake(asset, n, Path(folder), options) for n in FRAMES)
    return (many - few) / (long - short) / 1e6


def damping(assets: Sequence[Path], turns: int) -> None:
    """Print the rate of each asset with the default damping, without it, and their ratio."""
    print("| asset | whole bake, M/s | undamped, M/s | ratio | of each turn |")
    print("|---|---:|---:|---:|---|")
    for asset in assets:
        rates = [(rate(asset, ()), rate(asset, UNDAMPED)) for _ in range(turns)]
        damped, undamped = (median(column) for column in zip(*rates))
        ratios = [a / b for a, b in rates]
        each = ", ".join(f"{r:.2f}" for r in ratios)
        row = f"{damped:.2f} | {undamped:.2f} | {median(ratios):.2f} | {each}"
        print(f"| `{asset.name}` | {row} |", flush=True)


def rate_of(key: str, python: str, particles: int) -> float:
    """The same of a peer on the drop of `tools/bench/scene.py`.

    Raises SystemExit with its message where it fails.
    """
    job = {"kind": "speed", "n": particles, "seconds": 3.0}
    found = run(python, PEERS[key], job, [0], 150.0)
    if "failed" in found:
        raise SystemExit(f"{PEERS[key].name}, {particles:,} particles: {found['failed']}")
    return found["particles"] / found["cpu"] / 1e6


def against(pythons: Mapping[str, str], sizes: Sequence[int], turns: int) -> None:
    """Print the rate of a ball of each number of particles, and those of the peers."""
    names = " | ".join(f"{PEERS[k].name}, M/s | ratio" for k in pythons)
    print(f"| particles | whole bake, M/s | {names} |\n|---:|---:|{'---:|---:|' * len(pythons)}")
    for n in sizes:
        rates = [
            [
                rate(ASSET, ("--particles", str(n))),
                *(rate_of(key, python, n) for key, python in pythons.items()),
            ]
            for _ in range(turns)
        ]
        own, *others = (median(column) for column in zip(*rates))
        ratios = [median(turn[0] / turn[k] for turn in rates) for k in range(1, 1 + len(pythons))]
        cells = " | ".join(f"{other:.2f} | {by:.1f}" for other, by in zip(others, ratios))
        print(f"| {n:,} | {own:.2f} | {cells} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--damping", type=Path, nargs="+", metavar="ASSET", help=damping.__doc__)
    parser.add_argument("--particles", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--peers", default="taichi", help="of tools/bench.py, default: %(default)s")
    parser.add_argument("--into", type=Path, default=ROOT / ".clients", help="default: .clients")
    args = parser.parse_args()
    keys = args.peers.split(",")
    if unknown := sorted(set(keys) - set(PEERS)):
        parser.error(f"unknown: {', '.join(unknown)} (choose from {', '.join(PEERS)})")
    with tempfile.TemporaryDirectory() as folder:
        bake(ASSET, 2, Path(folder), ("--particles", "1000"))  # compiles the kernels
    if args.damping:
        damping(args.damping, args.turns)
    else:
        # Taichi is installed here already.
        pythons = {k: sys.executable if k == "taichi" else interpreter(k, args.into) for k in keys}
        against(pythons, args.particles, args.turns)


if __name__ == "__main__":
    main()
