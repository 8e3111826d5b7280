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
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from gf_usd.materials import LOOKS
from gf_usd.model import Floats, Particles, Settings
from gf_usd.physics import solver

ROOT = Path(__file__).resolve().parent.parent
DUCK = ROOT / "samples" / "duck.usda"
REPORT = ROOT / "BENCHMARKS.md"
BEGIN, END = "<!-- tools/bench.py: begin -->", "<!-- tools/bench.py: end -->"
SIZES = (120, 1_000, 10_000, 100_000)
SUBSTEPS = 200  # a frame: what the duck takes at 24 fps, to a tenth or so
SECONDS = 2.0  # of a run of the solver


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


def ball(n: int) -> Particles:
    """About n particles, one at a random place in each stratum of a ball of radius 1 m."""
    a = float(np.cbrt(4.0 / 3.0 * np.pi / n))
    k = int(np.ceil(2.0 / a))
    corner = np.full(3, -0.5 * k * a)
    cube = np.stack(np.unravel_index(np.arange(k**3), (k, k, k)), -1)
    place = 0.5 + 0.7 * (np.random.default_rng(0).random(cube.shape) - 0.5)
    X = corner + a * (cube + place)
    X = X[np.linalg.norm(X, axis=1) < 1.0]
    volume = 4.0 / 3.0 * np.pi
    n = len(X)
    return Particles(
        X=X, V0=np.full(n, volume / n), material=np.zeros(n, int),
        orientation=np.tile((1.0, 0.0, 0.0, 0.0), (n, 1)), scale=np.full((n, 3), a),
        colour=np.full((n, 3), 0.5), opacity=np.ones(n), surface=np.zeros(n, int),
        spacing=float(np.cbrt(volume / n)), volume=volume, lattice=a, corner=corner,
    )  # fmt: skip


def twist(X: Floats) -> Floats:
    """v = w(z) x r [m/s]: the halves turn against each other, so that no particle stays at rest."""
    turn = 2.0 * X[:, 2]
    return np.stack([-turn * X[:, 1], turn * X[:, 0], np.zeros(len(X))], -1)


def solver_speed(n: int, path: str, runs: int) -> tuple[int, Sample]:
    """Particles, and seconds per particle-substep of rubber in free flight, frames read out.

    path : "serial", a frame in one launch on one thread, or "parallel".
    """
    particles = ball(n)
    rubber = LOOKS["rubber"].material(particles.radius)
    solver.SERIAL_BELOW = 0 if path == "parallel" else 10**9

    def made(fps: float, count: int) -> solver.TotalLagrangian:
        settings = Settings(
            frames=count, fps=fps, time_codes_per_second=fps, start=1.0, gravity=(0.0, 0.0, 0.0),
            up=(0.0, 1.0, 0.0), floor=None, filter_rate=10.0 * np.sqrt(9.81 / particles.radius),
        )  # fmt: skip
        return solver.TotalLagrangian(particles, [rubber], settings, velocity=twist)

    fps = 1.0 / (0.999 * SUBSTEPS * made(24.0, 1).step.dt)
    for _ in made(fps, 2).frames():
        pass  # compiles the kernels, or fetches them from the disk
    began = time.perf_counter()
    for _ in made(fps, 2).frames():
        pass
    frames = 1 + max(1, round(SECONDS / (time.perf_counter() - began)))
    times = []
    for _ in range(runs):
        body = made(fps, frames)
        stream = body.frames()
        next(stream)
        wall, cpu = time.perf_counter(), time.process_time()
        steps = sum(frame.health.substeps for frame in stream) * len(particles)
        times.append(
            ((time.perf_counter() - wall) / steps, (time.process_time() - cpu) / steps, 0.0)
        )
    return len(particles), median(times)


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


def solver_table(runs: int) -> str:
    """Particle-substeps per second for sizes and paths."""
    lines = [
        "| particles | path | million a second, wall | million a CPU second | spread |",
        "|---:|---|---:|---:|---:|",
    ]
    default = solver.SERIAL_BELOW
    for n in SIZES:
        for path in ("serial", "parallel"):
            count, s = solver_speed(n, path, runs)
            used = " (default)" if (path == "serial") == (count < default) else ""
            lines.append(
                f"| {count} | {path}{used} | {1e-6 / s.wall:.2f} | {1e-6 / s.cpu:.2f}"
                f" | {100 * s.spread:.0f} % |"
            )
            print(lines[-1], file=sys.stderr)
    solver.SERIAL_BELOW = default
    return "\n".join(lines)


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

        warm: Callable[[], dict[str, str]] = lambda: dict(os.environ)  # noqa: E731
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
        f"- {look}: {plan['frames']} frames of {plan['substeps_per_frame']} substeps,"
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
    # Linux counts the memory of the process that forked into a child's peak: commands go first.
    tables = "\n\n".join(
        [
            f"{machine()} Median of {options.runs} runs.",
            "### Commands",
            process_table(options.runs),
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
