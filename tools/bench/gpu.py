"""Substeps per second on a GPU, and whether its results repeat: the GPU table of BENCHMARKS.md.

    python -m tools.bench.gpu [--device cuda] [--particles N]... [--substeps N] [--runs N]
                              [--jobs N]

Rubber in free flight, as in `tools.bench.solver`, with the APIC filter.  Every row has a law, with
and without viscosity, and the median of the runs. Only the launches are timed, until they end: the
other work of a frame (poses, health, contact detection) runs on the CPU on every device. With
several jobs, rows are set up in as many processes at a time, which take turns on the GPU.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from tools.bench.solver import ball, twist

SIZES = (10_000, 100_000, 1_000_000)
LAWS = ("neoHookean", "corotated")
REPEATED = 20  # substeps that are run twice from the same state


def solver(particles: int, law: str, damped: bool, device: str) -> TotalLagrangian:
    """A ball of about so many particles."""
    body = ball(particles)
    rubber = replace(DIMENSIONLESS["rubber"].material(body.radius), law=law)
    settings = Settings(
        frames=2, fps=24.0, time_codes_per_second=24.0, start=1.0, gravity=(0.0, 0.0, 0.0),
        up=(0.0, 1.0, 0.0), floor=None, filter_rate=10.0 * np.sqrt(9.81 / body.radius),
        device=device,
    )  # fmt: skip
    material = rubber if damped else replace(rubber, damping_time=0.0)
    return TotalLagrangian(body, [material], settings, velocity=twist)


def repeats(made: TotalLagrangian) -> bool:
    """Whether the same substeps lead to the same bits."""
    start, ends = made.state.save(), []
    for _ in range(2):
        made.state.load(start)
        made.launches.run(made.state, REPEATED, made.body.step.dt, 0)
        ends.append((made.state.get("u"), made.state.get("v")))
    made.state.load(start)
    (u, v), (again_u, again_v) = ends
    return bool(np.isfinite(v).all() and np.array_equal(u, again_u) and np.array_equal(v, again_v))


def row(particles: int, law: str, damped: bool, args: argparse.Namespace, turn: Any) -> str:
    """A line of the table; turn : the lock that its process holds while it uses the GPU."""
    made = solver(particles, law, damped, args.device)
    seconds = []
    with turn:
        began = time.perf_counter()
        same = repeats(made)
        first = time.perf_counter() - began
        for _ in range(args.runs):
            began = time.perf_counter()
            made.launches.run(made.state, args.substeps, made.body.step.dt, 0)
            made.state.get("sample_active")  # waits for the launches
            seconds.append((time.perf_counter() - began) / args.substeps)
    middle, count = statistics.median(seconds), len(made.particles)
    size = sum(made.state.get(name).nbytes for name in made.state.arrays)
    return (
        f"| {count:,} | {law} | {'yes' if damped else 'no'} | {1e6 * middle:.0f}"
        f" | {count / middle / 1e6:,.0f} | {1e6 * min(seconds):.0f} to {1e6 * max(seconds):.0f}"
        f" | {size / 2**20:.0f} | {'yes' if same else 'NO'} | {first:.0f} |"
    )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--device", default="cuda", choices=("cpu", "cuda"))
    parser.add_argument("--particles", type=int, action="append", default=[])
    parser.add_argument("--substeps", type=int, default=100, help="of a run; default: %(default)s")
    parser.add_argument("--runs", type=int, default=7, help="default: %(default)s")
    parser.add_argument("--jobs", type=int, default=1, help="default: %(default)s")
    args = parser.parse_args()
    print(
        "| particles | law | viscosity | us a substep | million particle-substeps a second"
        " | from, to | MiB of arrays | repeats | s to the first result |\n"
        "|---:|---|---|---:|---:|---:|---:|---|---:|",
        flush=True,
    )
    sizes = args.particles or SIZES
    rows = [(n, law, damped) for n in sizes for law in LAWS for damped in (False, True)]
    spawn = multiprocessing.get_context("spawn")
    with (
        spawn.Manager() as manager,
        ProcessPoolExecutor(args.jobs, mp_context=spawn, max_tasks_per_child=1) as pool,
    ):
        turn = manager.Lock()
        lines = [pool.submit(row, *one, args, turn) for one in rows]
        for line in lines:
            print(line.result(), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
