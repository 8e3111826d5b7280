"""Long bakes that must remain stable: finite, bounded, without recomputed frames.

    python -m tools.acceptance.endurance [--json] [--frames-scale X] [--particles N]

The solver runs as in a bake; nothing is written.  Exit status 1 if a run is not stable.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gf_usd.core.errors import BakeError
from gf_usd.pipeline.prepared import prepare

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
PARTICLES = 3000
SETTLED = 1e-3  # of m g0 r: a body that lies still may hold no more than this in motion


@dataclass(frozen=True, kw_only=True)
class Run:
    """One of the runs."""

    name: str
    asset: str
    material: str
    frames: int
    law: str | None = None


RUNS = (
    Run(name="rubber sphere", asset="sphere.usda", material="rubber", frames=3000),
    Run(name="jelly duck", asset="duck.usda", material="jelly", frames=1000),
    Run(name="stiff duck", asset="duck.usda", material="metal", frames=1000),
    Run(
        name="neo-Hookean duck", asset="duck.usda", material="rubber", law="neoHookean", frames=1000
    ),
)


@dataclass(frozen=True, kw_only=True)
class Lasted:
    """The result of a run."""

    name: str
    frames: int  # that were had
    requested: int
    rollbacks: int
    inverted: int  # particle-frames
    farthest: float  # [radii] of a particle from where the body was put, over all frames
    kinetic_end: float  # [m g0 r] at the end
    energy_rise: float  # [m g0 r] largest of a frame
    seconds: float
    fault: str

    @property
    def sound(self) -> bool:
        """All frames, no one redone, everything near, at rest in the end."""
        return (
            not self.fault
            and self.frames == self.requested
            and self.rollbacks == 0
            and self.farthest < 50.0
            and self.kinetic_end < SETTLED
        )


def last(run: Run, particles: int, scale: float) -> Lasted:
    """Run to the end, or to where it cannot continue."""
    requested = max(2, round(scale * run.frames))
    prepared = prepare(
        SAMPLES / run.asset, material=run.material, law=run.law, particles=particles,
        frames=requested, overwrite=True,
    )  # fmt: skip
    plan = prepared.plan
    material = plan.materials[0]
    r = plan.particles.radius
    unit = material.density * plan.particles.volume * 9.81 * r
    home = plan.particles.X.mean(0) + np.asarray(plan.settings.lift)
    before, rise, farthest = np.inf, -np.inf, 0.0
    frames, rollbacks, inverted, kinetic, fault = 0, 0, 0, 0.0, ""
    began = time.process_time()
    try:
        for frame in prepared.solvers.take(plan.variants[0]).frames():
            h = frame.health
            frames, rollbacks = frames + 1, rollbacks + h.rollbacks
            inverted, kinetic = inverted + h.inverted, h.kinetic
            rise, before = max(rise, h.energy - before), h.energy
            farthest = max(farthest, float(np.linalg.norm(frame.particles.x - home, axis=1).max()))
    except BakeError as error:
        fault = error.message
    return Lasted(
        name=run.name, frames=frames, requested=requested, rollbacks=rollbacks, inverted=inverted,
        farthest=farthest / r, kinetic_end=kinetic / unit, energy_rise=rise / unit,
        seconds=time.process_time() - began, fault=fault,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all and print what came of them."""
    parser = argparse.ArgumentParser(description="Long bakes that must stay sound.")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--particles", type=int, default=PARTICLES)
    parser.add_argument("--frames-scale", type=float, default=1.0, help="shorter or longer runs")
    args = parser.parse_args(arguments)
    found = []
    for run in RUNS:
        found.append(last(run, args.particles, args.frames_scale))
        print(f"{run.name}: {found[-1]}", file=sys.stderr)
    if args.json:
        print(json.dumps({"runs": [{**asdict(f), "sound": f.sound} for f in found]}))
    sys.exit(0 if all(f.sound for f in found) else 1)


if __name__ == "__main__":
    main()
