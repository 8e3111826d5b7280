"""Speed of the solver alone: rubber in free flight, frames read out."""

from __future__ import annotations

import sys
import time

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.physics.total_lagrangian import launch, solver
from gf_usd.system.resources import cores
from tools.bench.tables import Sample, median

SIZES = (120, 1_000, 10_000, 100_000)
SUBSTEPS = 200  # a frame: what the duck takes at 24 fps, to a tenth or so
SECONDS = 1.0  # of a run


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
        color=np.full((n, 3), 0.5), opacity=np.ones(n), surface=np.zeros(n, int),
        spacing=float(np.cbrt(volume / n)), volume=volume, lattice=a, corner=corner,
    )  # fmt: skip


def twist(X: Floats) -> Floats:
    """v = w(z) x r [m/s]: the halves turn against each other, so that no particle stays at rest."""
    turn = 2.0 * X[:, 2]
    return np.stack([-turn * X[:, 1], turn * X[:, 0], np.zeros(len(X))], -1)


def solver_speed(n: int, threads: int, runs: int) -> tuple[int, Sample]:
    """Particles, and seconds per particle-substep of rubber in free flight, frames read out."""
    particles = ball(n)
    rubber = DIMENSIONLESS["rubber"].material(particles.radius)

    def made(fps: float, count: int) -> solver.TotalLagrangian:
        settings = Settings(
            frames=count, fps=fps, time_codes_per_second=fps, start=1.0, gravity=(0.0, 0.0, 0.0),
            up=(0.0, 1.0, 0.0), floor=None, filter_rate=10.0 * np.sqrt(9.81 / particles.radius),
            threads=threads,
        )  # fmt: skip
        return solver.TotalLagrangian(particles, [rubber], settings, velocity=twist)

    fps = 1.0 / (0.999 * SUBSTEPS * made(24.0, 1).body.step.dt)
    for _ in made(fps, 2).frames():
        pass  # compiles the kernels, or fetches them from the disk
    body = made(fps, 2)
    began = time.perf_counter()
    for _ in body.frames():
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


def solver_table(runs: int, seconds: float) -> list[str]:
    """Particle-substeps per second for sizes and threads; no row is begun after `seconds`."""
    end = time.perf_counter() + seconds
    lines = [
        "| particles | threads | million a second, wall | million a CPU second | spread |",
        "|---:|---:|---:|---:|---:|",
    ]
    for n in SIZES:
        for threads in sorted({1, cores()}):
            # A body of few particles takes fewer threads than it is given.
            if threads > 1 and n < threads * launch.FEW:
                continue
            if time.perf_counter() > end:
                lines.append(f"| {n} | {threads}: no time left | | | |")
                continue
            count, s = solver_speed(n, threads, runs)
            lines.append(
                f"| {count} | {threads} | {1e-6 / s.wall:.2f} | {1e-6 / s.cpu:.2f}"
                f" | {100 * s.spread:.0f} % |"
            )
            print(f"  {lines[-1]}", file=sys.stderr, flush=True)
    return lines
