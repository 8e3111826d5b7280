"""The cost of contact between bodies: rows of 2 and 4 balls that collide.

    python -m tools.bench.bodies

CPU seconds of the frames only, with compiled kernels. With the same number of particles per ball,
twice the balls are twice the work; the remainder is contact detection and the smaller step of
contact.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from gf_usd.core.asset import Asset, StageFacts
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.stage import ContactSetup
from gf_usd.core.units import StageUnits
from gf_usd.geometry.connected.bodies import find_bodies
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.geometry.solid import build_solid
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.prepare.bodies.contact import skins
from gf_usd.verify.bodies import sphere
from tools.bench.tables import Sample, median

COUNTS = (1, 2, 4)
A_BALL = 1_000  # particles
GAP = 2.15  # [m] between the middles of balls of 1 m
SPEED = 3.0  # [m/s] of each, towards its neighbor: balls meet in pairs
FRAMES = 30


def row(count: int) -> TotalLagrangian:
    """A solver of so many balls in a row, which meet in pairs."""
    ball = sphere()
    surfaces = [
        replace(ball, path=f"/Ball{k}", points=ball.points + [GAP * k, 0.0, 0.0])
        for k in range(count)
    ]
    facts = StageFacts(
        path=Path("balls"), units=StageUnits(), up_axis="Y", time_codes_per_second=None,
        start_time_code=None, end_time_code=None, root_prims=("/Ball0",), default_prim=None,
    )  # fmt: skip
    solid = build_solid(Asset(facts=facts, surfaces=tuple(surfaces)))
    particles = sample_solid(solid, particles=A_BALL * count, spacing=None, seed=0)
    of = find_bodies(solid, particles.spacing)
    settings = Settings(
        frames=FRAMES, fps=24.0, time_codes_per_second=24.0, start=1.0, gravity=(0.0, 0.0, 0.0),
        up=(0.0, 1.0, 0.0), floor=None, filter_rate=10.0 * np.sqrt(9.81),
    )  # fmt: skip
    return TotalLagrangian(
        replace(particles, body=of[particles.surface]),
        [DIMENSIONLESS["rubber"].material(1.0)],
        settings,
        samples=sample_surface(solid, particles.spacing, of),
        velocity=[(SPEED * (1 - 2 * (k % 2)), 0.0, 0.0) for k in range(count)],
        contact_setup=ContactSetup(skins=skins(solid, of)),
    )


def cost(count: int, runs: int) -> tuple[int, int, Sample]:
    """Particles, substeps and seconds of a bake."""
    seconds, substeps, solver = [], 0, row(count)
    for _ in solver.frames():
        pass  # compiles the kernels, or fetches them from the disk
    for _ in range(runs):
        solver = row(count)
        wall, cpu = time.perf_counter(), time.process_time()
        substeps = sum(frame.health.substeps for frame in solver.frames())
        seconds.append((time.perf_counter() - wall, time.process_time() - cpu, 0.0))
    return len(solver.particles), substeps, median(seconds)


def main() -> int:
    parser = argparse.ArgumentParser(description="What contact between bodies costs.")
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    print("| balls | particles | substeps | CPU s | spread | over half as many |")
    print("|---:|---:|---:|---:|---:|---:|")
    before = 0.0
    for count in COUNTS:
        particles, substeps, s = cost(count, args.runs)
        ratio = f"{s.cpu / before:.2f}" if before else ""
        spread = f"{100 * s.spread:.0f} %"
        print(f"| {count} | {particles} | {substeps} | {s.cpu:.2f} | {spread} | {ratio} |")
        before = s.cpu
    return 0


if __name__ == "__main__":
    sys.exit(main())
