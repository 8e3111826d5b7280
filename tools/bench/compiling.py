"""CPU seconds until the first substep of flowing materials, without compiled kernels.

    python -m tools.bench.compiling [honey dry-sand ...]

A block of 64 particles over a floor takes two substeps, each time in a new process: with kernels in
32 and in 64 bits, and with vectors made scalars as for CUDA, on the CPU.  The second process of
each loads the compiled kernels; its time is subtracted.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.system import taichi_runtime
from gf_usd.verify.bodies import block, settings

KINDS = ("f32", "f64", "scalars")
FLOWS = ("honey", "dry-sand", "wet-snow")


def first_substeps(material: str, kind: str) -> float:
    """CPU seconds [s] of this process for two substeps, from the import of Taichi on."""
    start = time.process_time()
    ti = taichi_runtime.import_taichi()
    from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian

    if kind == "scalars":
        init = ti.init
        ti.init = lambda **given: init(**{**given, "real_matrix_scalarize": True})
    body = block((0.0, 0.05, 0.0), (2, 2, 2), 0.1)
    solver = UpdatedLagrangian(
        body, [PHYSICAL[material].material(1.0)],
        settings("cpu", floor=0.0, gravity=(0.0, -9.81, 0.0), solver="ul"),
        samples=SurfaceSamples(X=body.X, area=body.V0 / body.spacing),
        real=np.float64 if kind == "f64" else np.float32,
    )  # fmt: skip
    solver.advance(1, 2)
    return time.process_time() - start


def compiling(material: str, kind: str) -> float:
    """CPU seconds that an empty folder of kernels costs."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, taichi_runtime.CACHE_FOLDER: folder}
        run = [sys.executable, "-m", "tools.bench.compiling", "--child", kind, material]
        cold, warm = (
            float(subprocess.check_output(run, env=environment, text=True).split()[-1])
            for _ in range(2)
        )
    return cold - warm


def main() -> int:
    parser = argparse.ArgumentParser(description="What compiling the kernels of flows takes.")
    parser.add_argument("materials", nargs="*", default=FLOWS)
    parser.add_argument("--child", choices=KINDS)
    args = parser.parse_args()
    if args.child:
        print(first_substeps(args.materials[0], args.child))
        return 0
    print("| material | f32 | f64 | vectors made scalars |")
    print("|---|---:|---:|---:|")
    for material in args.materials:
        seen = " | ".join(f"{compiling(material, kind):.1f} s" for kind in KINDS)
        print(f"| {material} | {seen} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
