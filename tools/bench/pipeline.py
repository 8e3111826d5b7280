"""CPU time and memory of each stage of a bake: the tables of docs/performance.md.

    python -m tools.bench.pipeline --particles 10000
    python -m tools.bench.pipeline --particles 10000 --points 1000000

A ball of rubber as a mesh of about so many points is filled, simulated for a few frames of few
substeps, and written; each stage is timed separately. There are few substeps, because their cost is
known (BENCHMARKS.md) and the other stages are measured here.
"""

from __future__ import annotations

import argparse
import gc
import resource
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

SUBSTEPS = 2  # a frame
PAGE = resource.getpagesize()


class Stages:
    """CPU seconds, how often, and what stayed in memory, by stage."""

    def __init__(self) -> None:
        self.rows: dict[str, list[float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        before, began = resident(), time.process_time()
        try:
            yield
        finally:
            took = time.process_time() - began
            row = self.rows.setdefault(name, [0.0, 0, 0.0, 0.0])
            row[0] += took
            row[1] += 1
            row[2] += resident() - before
            row[3] = peak()


def resident() -> float:
    """[B] in memory now."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def peak() -> float:
    """[B] at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0


def sphere(path: Path, points: int) -> None:
    """A latitude-longitude ball of radius 1 m over the floor, of about so many points."""
    rings = max(4, round(np.sqrt(points / 2.0)))
    around = 2 * rings
    latitude = np.pi * np.arange(1, rings) / rings
    longitude = 2.0 * np.pi * np.arange(around) / around
    a, b = np.meshgrid(latitude, longitude, indexing="ij")
    ball = np.stack([np.sin(a) * np.cos(b), np.cos(a), np.sin(a) * np.sin(b)], -1).reshape(-1, 3)
    X = np.concatenate([[[0.0, 1.0, 0.0]], ball, [[0.0, -1.0, 0.0]]])
    ring = 1 + around * np.arange(rings - 1)[:, None] + np.arange(around)
    after = np.roll(ring, -1, 1)
    top = np.stack([np.zeros(around, int), after[0], ring[0]], 1)
    low = np.stack([np.full(around, len(X) - 1), ring[-1], after[-1]], 1)
    quads = np.stack([ring[:-1], after[:-1], after[1:], ring[1:]], -1).reshape(-1, 4)
    counts = np.r_[np.full(2 * around, 3), np.full(len(quads), 4)]
    indices = np.r_[top.ravel(), low.ravel(), quads.ravel()]
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    mesh = UsdGeom.Mesh.Define(stage, Sdf.Path("/Ball/Mesh"))
    stage.SetDefaultPrim(stage.GetPrimAtPath("/Ball"))
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(X.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts.astype(np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices.astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    stage.Save()


def measure(folder: Path, particles: int, points: int, frames: int) -> Stages:
    """Bake a ball, stage by stage."""
    from gf_usd.core.frames.frame import BakeInfo
    from gf_usd.layers.cache import CacheWriter
    from gf_usd.pipeline.prepared import prepare
    from gf_usd.pipeline.run.parts import frame_builder, splat_deformer
    from gf_usd.prepare.plan import input_hash

    stages, file = Stages(), folder / "ball.usdc"
    sphere(file, points)
    with stages.stage("read, check, fill"):
        prepared = prepare(
            file, particles=particles, frames=frames, material="rubber", no_shortcuts=True,
            time_scale="1e-4",  # so short a frame that two substeps are enough
            output=str(folder / "out") + "/",
        )  # fmt: skip
    plan = prepared.plan
    (variant,) = plan.variants
    with stages.stage("solver"):
        solver = prepared.solvers.take(variant)
    builder = frame_builder(plan, variant, solver, splat_deformer(plan, variant))
    info = BakeInfo(
        look=variant.name, materials=variant.table, settings=plan.settings, command="",
        version=plan.version, input_hash=input_hash(file),
    )  # fmt: skip
    plan.outputs.caches[0].parent.mkdir(exist_ok=True)
    with stages.stage("open the cache"):
        cache = CacheWriter(plan.outputs.caches[0], plan.asset, plan.particles, info)
    with cache:
        solver.advance(1, SUBSTEPS)  # compiles, or loads what was compiled
        for index in range(frames):
            with stages.stage("substeps"):
                solver.advance(index + 2, SUBSTEPS)
            with stages.stage("poses and health"):
                frame = solver.read(index)
            with stages.stage("Gaussians"):
                baked = builder.sample(frame)
            with stages.stage("write"):
                cache.write(baked)
        with stages.stage("close the cache"):
            cache.close()
    count, vertices = len(plan.particles), sum(len(s.points) for s in plan.asset.surfaces)
    print(f"\n{count} particles, {vertices} points, {frames} frames of {SUBSTEPS} substeps\n")
    return stages


def table(stages: Stages, particles: int, frames: int) -> None:
    print(
        "| stage | CPU s each | stays, bytes a particle | peak so far, MB |\n|---|---:|---:|---:|"
    )
    for name, (seconds, times, grown, most) in stages.rows.items():
        print(f"| {name} | {seconds / times:.3g} | {grown / particles:.0f} | {most / 1e6:.0f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--particles", type=int, default=10_000)
    parser.add_argument("--points", type=int, default=10_000, help="of the mesh, about")
    parser.add_argument("--frames", type=int, default=6)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="gf-usd-pipeline-") as folder:
        stages = measure(Path(folder), args.particles, args.points, args.frames)
    table(stages, args.particles, args.frames)


if __name__ == "__main__":
    main()
