"""The cost of each constitutive law: a ball whose halves rotate in opposite directions.

    python -m tools.bench.laws

CPU seconds per particle-substep on one thread, with compiled kernels; laws take turns, so that
other work of the machine slows all of them. A flowing law is measured below its yield stress and
with the whole ball flowing. Memory is that of the arrays of the law's internal variables.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.physics.laws.registry import law_set
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from tools.bench.solver import ball, twist

FRAMES, SUBSTEPS = 3, 100
REAL = 4  # [bytes] of a number of the kernels


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A law at a yield stress."""

    law: str
    state: str
    yields: float | None  # of rubber's shear modulus

    @property
    def material(self) -> Material:
        made = DIMENSIONLESS["rubber"].material(1.0)
        mu = made.youngs_modulus / (2.0 * (1.0 + made.poissons_ratio))
        own = {} if self.yields is None else {"yield_stress": self.yields * mu}
        return replace(made, law=self.law, parameters=own)


def kinds() -> list[Kind]:
    """Every law; what flows twice."""
    out = []
    for token, row in LAWS.items():
        if row.flows:
            out.append(Kind(law=token, state="below yield", yields=1e6))
            out.append(Kind(law=token, state="flowing", yields=1e-3))
        else:
            out.append(Kind(law=token, state="", yields=None))
    return out


def cost(kind: Kind, n: int) -> float:
    """CPU seconds a particle-substep."""
    particles = ball(n)
    settings = Settings(
        frames=FRAMES, fps=60.0, time_codes_per_second=60.0, start=1.0, gravity=(0.0, 0.0, 0.0),
        up=(0.0, 1.0, 0.0), floor=None, filter_rate=10.0 * np.sqrt(9.81), threads=1,
        substeps=SUBSTEPS,
    )  # fmt: skip
    solver = TotalLagrangian(particles, [kind.material], settings, velocity=twist)
    stream = solver.frames()
    next(stream)
    began = time.process_time()
    steps = sum(frame.health.substeps for frame in stream) * len(particles)
    return (time.process_time() - began) / steps


def history_bytes(law: str) -> int:
    """Of a particle, besides what an elastic law has: the history, and the law's parameters."""
    spec = LAWS[law]
    return REAL * (law_set((spec,)).history + len(spec.parameters))


def main() -> int:
    parser = argparse.ArgumentParser(description="What each constitutive law costs.")
    parser.add_argument("--particles", type=int, default=10_000)
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    rows = kinds()
    for kind in rows:
        cost(kind, args.particles)  # compiles the kernels, or fetches them from the disk
    seen = [[cost(kind, args.particles) for kind in rows] for _ in range(args.runs)]
    print("| law | state | ns of CPU a particle-substep | over corotated | bytes a particle |")
    print("|---|---|---:|---:|---:|")
    first = next(k for k, kind in enumerate(rows) if kind.law == "corotated")
    for k, kind in enumerate(rows):
        ns = 1e9 * median(run[k] for run in seen)
        ratio = median(run[k] / run[first] for run in seen)
        print(f"| {kind.law} | {kind.state} | {ns:.1f} | {ratio:.2f} | {history_bytes(kind.law)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
