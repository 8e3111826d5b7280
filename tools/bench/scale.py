"""How time and memory grow with particles, bodies, frames and more: the table of BENCHMARKS.md.

    python -m tools.bench.scale [--axes AXIS,...] [--most N] [--write]

Every size runs in its own process, whose peak memory is then that of the size.  The time is CPU
time of all threads and children.  An exponent p is the slope of log(time) over log(size), time ~
size^p, by least squares over the sizes from KNEE on: below it, the start of the process dominates.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench.processes import ALONE, ROOT
from tools.bench.tables import write

A_BODY = 60  # particles, of a row of bodies
POINTS = 10_000  # of the mesh of a row of particles
FEW_FRAMES = 4  # the first of them loads kernels
BODY_FRAMES = 12
SPECKS = 300
APART = 3.0  # [m] between the middles of balls of 1 m
Row = dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Something that grows."""

    measure: Callable[[int], Row]  # CPU seconds by name; in a process of its own
    sizes: tuple[int, ...]
    knee: int  # the fit begins here
    text: str


def particles(size: int) -> Row:
    """A ball of so many particles, filled, simulated and written: CPU seconds of each stage."""
    from tools.bench.pipeline import SUBSTEPS, measure

    with tempfile.TemporaryDirectory(prefix="gf-usd-scale-") as folder:
        rows = measure(Path(folder), size, POINTS, FEW_FRAMES).rows
    frame = [rows[name][0] / rows[name][1] for name in ("poses and health", "Gaussians", "write")]
    return {
        "set-up": rows["read, check, fill"][0] + rows["solver"][0],
        "a substep": rows["substeps"][0] / rows["substeps"][1] / SUBSTEPS,
        "a frame without them": sum(frame),
    }


def bodies(size: int) -> Row:
    """So many balls that fly apart from each other, over nothing: solver alone."""
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
    from tools.bench.solver import twist

    began = time.process_time()
    ball, side = sphere(), int(np.ceil(np.cbrt(size)))
    places = np.stack(np.unravel_index(np.arange(size), (side, side, side)), -1) * APART
    surfaces = [
        replace(ball, path=f"/Ball{k}", points=ball.points + place)
        for k, place in enumerate(places)
    ]
    facts = StageFacts(
        path=Path("balls"), units=StageUnits(), up_axis="Y", time_codes_per_second=None,
        start_time_code=None, end_time_code=None, root_prims=("/Ball0",), default_prim=None,
    )  # fmt: skip
    solid = build_solid(Asset(facts=facts, surfaces=tuple(surfaces)))
    filled = sample_solid(solid, particles=A_BODY * size, spacing=None, seed=0)
    of = find_bodies(solid, filled.spacing)
    settings = Settings(
        frames=BODY_FRAMES, fps=24.0, time_codes_per_second=24.0, start=1.0,
        gravity=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), floor=None, filter_rate=10.0 * np.sqrt(9.81),
    )  # fmt: skip
    solver = TotalLagrangian(
        replace(filled, body=of[filled.surface]),
        [DIMENSIONLESS["rubber"].material(1.0)],
        settings,
        samples=sample_surface(solid, filled.spacing, of),
        velocity=[_twist(place, twist) for place in places],
        contact_setup=ContactSetup(skins=skins(solid, of), self_contact=frozenset(range(size))),
    )
    made = time.process_time()
    frames = solver.frames()
    next(frames)
    next(frames)  # compiles, or loads what was compiled
    moving = time.process_time()
    substeps = sum(frame.health.substeps for frame in frames)
    spent = time.process_time() - moving
    return {
        "set-up": made - began,
        "a frame": spent / (BODY_FRAMES - 2),
        "a substep": spent / max(substeps, 1),
    }


def _twist(place: Any, twist: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda X: twist(X - place)


def _commands(*arguments: str) -> float:
    """CPU seconds of a ``gf-usd`` command and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "gf_usd", *arguments], check=True, capture_output=True, cwd=ROOT,
        env={**os.environ, **ALONE},
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def frames(size: int) -> Row:
    """A bake of so many frames, all of them simulated."""
    ball = str(ROOT / "samples" / "sphere.usda")
    with tempfile.TemporaryDirectory(prefix="gf-usd-scale-") as folder:
        return {
            "a bake": _commands(
                "bake", ball, "--material", "jelly", "--particles", "120", "--frames", str(size),
                "--no-shortcuts", "--no-settling", "-o", f"{folder}/", "-q",
            )
        }  # fmt: skip


def jobs(size: int) -> Row:
    """A batch of so many bakes."""
    ball = ROOT / "samples" / "sphere.usda"
    with tempfile.TemporaryDirectory(prefix="gf-usd-scale-") as folder:
        assets = [Path(folder) / f"ball{k}.usda" for k in range(size)]
        for asset in assets:
            asset.write_text(ball.read_text())
        return {
            "a batch": _commands(
                "batch", *map(str, assets), "--material", "rubber", "--particles", "120",
                "--frames", "24", "--jobs", "1", "--output", f"{folder}/baked",
            )
        }  # fmt: skip


def inspection(size: int, specks: int = 0) -> Row:
    """An uneven ball of so many triangles, and specks of 80 triangles around it."""
    import trimesh
    from pxr import Sdf, Usd, UsdGeom, Vt

    rings = round(np.sqrt(max(size - 80 * specks, 128) / 8.0))
    ball = trimesh.creation.uv_sphere(count=[rings, 2 * rings])
    x, y, z = ball.vertices.T
    bumps = 0.1 * np.sin(5.0 * x) * np.sin(6.0 * y + 1.0) * np.cos(4.0 * z)
    ball.vertices *= (1.0 + bumps + 0.004 * np.sin(60.0 * x) * np.sin(60.0 * y))[:, None]
    grain, places = trimesh.creation.icosphere(1, 0.003), np.random.default_rng(0)
    parts = [ball]
    for place in places.normal(size=(specks, 3)):
        parts.append(grain.copy().apply_translation(1.3 * place / np.linalg.norm(place)))
    whole = trimesh.util.concatenate(parts)
    with tempfile.TemporaryDirectory(prefix="gf-usd-scale-") as folder:
        path = f"{folder}/ball.usdc"
        stage = Usd.Stage.CreateNew(path)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        mesh = UsdGeom.Mesh.Define(stage, Sdf.Path("/Ball"))
        stage.SetDefaultPrim(mesh.GetPrim())
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(whole.vertices.astype(np.float32)))
        counts = np.full(len(whole.faces), 3, np.int32)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
        mesh.CreateFaceVertexIndicesAttr(
            Vt.IntArray.FromNumpy(whole.faces.astype(np.int32).reshape(-1))
        )
        stage.GetRootLayer().Save()
        return {"an inspection": _commands("inspect", path)}


AXES = {
    "particles": Axis(
        measure=particles, sizes=(1_000, 10_000, 100_000, 1_000_000, 10_000_000), knee=10_000,
        text=f"a ball under a mesh of {POINTS:,} points",
    ),
    "bodies": Axis(
        measure=bodies, sizes=(1, 10, 100, 1_000), knee=10,
        text=f"balls of {A_BODY} particles that touch nothing, with contact and self-contact",
    ),
    "frames": Axis(
        measure=frames, sizes=(10, 100, 1_000, 10_000), knee=100,
        text="`gf-usd bake`, 120 particles of jelly",
    ),
    "jobs": Axis(
        measure=jobs, sizes=(1, 10, 100, 1_000), knee=10,
        text="`gf-usd batch --jobs 1`, 120 particles of rubber, 24 frames",
    ),
    "triangles": Axis(
        measure=inspection, sizes=(20_000, 200_000, 2_000_000), knee=200_000,
        text="`gf-usd inspect` of an uneven ball",
    ),
    "triangles of a scan": Axis(
        measure=partial(inspection, specks=SPECKS), sizes=(40_000, 200_000, 2_000_000),
        knee=200_000, text=f"`gf-usd inspect` of the same with {SPECKS} specks around it",
    ),
}  # fmt: skip


COMMANDS = [axis for axis in AXES if axis not in ("particles", "bodies")]  # children


def case(axis: str, size: int) -> Row:
    """In a process of its own: what `Axis.measure` says, and the peak memory [MB] as "memory"."""
    row = AXES[axis].measure(size)
    peaks = [
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return {**row, "memory": (peaks[1] if axis in COMMANDS else peaks[0]) / 1e3}


def exponent(sizes: list[int], values: list[float], knee: int) -> float | None:
    """p of value ~ size^p over the sizes from `knee` on; None of fewer than two."""
    pairs = [(n, v) for n, v in zip(sizes, values, strict=True) if n >= knee and v > 0.0]
    if len(pairs) < 2:
        return None
    x, y = np.log(np.array(pairs)).T
    return float(np.polyfit(x, y, 1)[0])


def table(axis: str, most: int) -> list[str]:
    """The rows of an axis up to a size, and the exponents."""
    of = AXES[axis]
    sizes, rows = [], []
    for size in (n for n in of.sizes if n <= most):
        done = subprocess.run(
            [sys.executable, "-m", "tools.bench.scale", "--case", axis, str(size)],
            capture_output=True, text=True, check=False, cwd=ROOT, env={**os.environ, **ALONE},
        )  # fmt: skip
        if done.returncode:
            message = done.stderr.strip().splitlines()[-1:]
            print(f"{axis} {size}: {' '.join(message) or done.returncode}", file=sys.stderr)
            break
        sizes.append(size)
        rows.append(json.loads(done.stdout.strip().splitlines()[-1]))
        print(f"{axis} {size}: {rows[-1]}", file=sys.stderr, flush=True)
    names = [name for name in rows[0] if name != "memory"]
    lines = [
        f"**{axis}**: {of.text}", "",
        f"| {axis} | {' | '.join(f'{name}, CPU s' for name in names)} | peak memory, MB |",
        f"|---:|{'---:|' * (len(names) + 1)}",
    ]  # fmt: skip
    for size, row in zip(sizes, rows, strict=True):
        cells = [f"{row[name]:.3g}" for name in names]
        lines.append(f"| {size:,} | {' | '.join(cells)} | {row['memory']:,.0f} |")
    found = [exponent(sizes, [r[name] for r in rows], of.knee) for name in (*names, "memory")]
    cells = ["" if p is None else f"**{p:.2f}**" for p in found]
    return [*lines, f"| exponent from {of.knee:,} on | {' | '.join(cells)} |", ""]


def main() -> int:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--axes", default=",".join(AXES))
    parser.add_argument("--most", type=int, default=2_000_000, help="the largest size of an axis")
    parser.add_argument("--write", action="store_true", help="put it into BENCHMARKS.md")
    parser.add_argument("--case", nargs=2, metavar=("AXIS", "SIZE"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case:
        print(json.dumps(case(args.case[0], int(args.case[1]))))
        return 0
    lines = [line for axis in args.axes.split(",") for line in table(axis, args.most)]
    print("\n".join(lines))
    if args.write:
        write(ROOT / "BENCHMARKS.md", "scale", "\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
