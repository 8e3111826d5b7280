"""How often the intervals of ``bake --certify`` contain the true value, and how wide they are.

    python -m tools.acceptance.certify [--scene NAME]... [--seeds N] [--particles N]...
                                       [--rows FILE] [--record]

Every scene has a figure whose true value is known: in closed form, or as the limit of much finer
runs. A seed turns the body about its axis of symmetry and changes the number of particles by up to
a tenth, which moves the lattice of particles, the grid and the contact samples.  Each row of the
table has the number of intervals that contain the true value, and the median of their width over
the error of the finest run. Runs in the FILE of --rows are not baked again: with --seeds 0 nothing
is baked.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gf_usd.system import usd_schema  # noqa: F401  # isort: skip  (before pxr opens a stage)
from pxr import Usd, UsdGeom, Vt
from scipy.spatial.transform import Rotation

import gf_usd
from gf_usd.core.materials.material import Material
from tools.acceptance.record import PAGE, Outcome, git, newest, page, record, save, write
from tools.bench import scene as bench

RESOLUTIONS = (5000, 8000, 12000)  # particles
COVERAGE, WIDTH = 0.95, 4.0  # that are required: share of intervals, and width over error
UP = (0.0, 1.0, 0.0)
G = 9.81


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A body, how it is baked, and the answers."""

    name: str
    mesh: Callable[[], trimesh.Trimesh]
    turn: Callable[[random.Random], Rotation]
    material: Material
    options: dict[str, Any]
    truth: dict[str, float]  # of figures, in SI
    source: str  # of the truth
    pinned: Callable[[np.ndarray], np.ndarray] | None = None  # faces by their centers (F, 3)


def _about_up(dice: random.Random) -> Rotation:
    return Rotation.from_rotvec(dice.uniform(0.0, 0.5 * math.pi) * np.array(UP))


def _anyhow(dice: random.Random) -> Rotation:
    return Rotation.from_quat([dice.gauss(0.0, 1.0) for _ in range(4)])


def _box(size: Sequence[float], cuts: int) -> trimesh.Trimesh:
    made = trimesh.creation.box(extents=size)
    for _ in range(cuts):
        made = made.subdivide()
    return made


BALL = Material(
    name="drop", law="corotated", density=bench.DENSITY, youngs_modulus=bench.YOUNG,
    poissons_ratio=bench.POISSON, friction=0.0, restitution=1.0, damping_time=0.0,
)  # fmt: skip
BAR_E, BAR_DENSITY = 1e5, 1000.0
BAR = Material(
    name="bar", law="corotated", density=BAR_DENSITY, youngs_modulus=BAR_E, poissons_ratio=0.0,
    friction=0.0, restitution=1.0, damping_time=0.0,
)  # fmt: skip
CUBE = Material(
    name="cube", law="corotated", density=BAR_DENSITY, youngs_modulus=BAR_E, poissons_ratio=0.0,
    friction=0.0, restitution=0.0, damping_time=0.05,
)  # fmt: skip
BEAM_E, BEAM_DENSITY, BEAM_HEIGHT = 1e7, 1000.0, 0.25
BEAM = Material(
    name="beam", law="corotated", density=BEAM_DENSITY, youngs_modulus=BEAM_E, poissons_ratio=0.0,
    friction=0.0, restitution=0.0, damping_time=0.0,
)  # fmt: skip
# A load q on a length of 1 m: q L^4 / 8 E I of bending and q L^2 / 2 k G A of shear, k = 5 / 6.
BENDING = 1.5 * BEAM_DENSITY * G / (BEAM_E * BEAM_HEIGHT**2)
SHEAR = BEAM_DENSITY * G / (2.0 * 5.0 / 6.0 * 0.5 * BEAM_E)


SCENES = {
    one.name: one
    for one in (
        Scene(
            name="ball",
            mesh=lambda: trimesh.creation.icosphere(4),
            turn=_anyhow,
            material=BALL,
            options={"drop": 0.52, "frames": 28, "fps": 24.0, "filter_rate": 0.0},
            # over its own diameter, which faces make a little smaller than 2 m
            truth={"squash": 1.0 - 0.7781, "rebound": 0.5076},
            source="BENCHMARKS.md, tools/bench/equal_error.py",
        ),
        Scene(
            name="bar",
            mesh=lambda: _box((0.5, 1.0, 0.5), 3),
            turn=_about_up,
            material=BAR,
            options={"drop": 0.0, "frames": 16, "fps": 48.0, "floor": False},
            # linear waves in one dimension: twice the static sag, after half a period
            truth={"sag": BAR_DENSITY * G / BAR_E},
            source="rho g L^2 / E, the wave equation with a sudden weight",
            pinned=lambda centers: centers[:, 1] > 0.5 - 1e-6,
        ),
        Scene(
            name="cube",
            mesh=lambda: _box((1.0, 1.0, 1.0), 3),
            turn=_about_up,
            material=CUBE,
            options={"drop": 0.0, "frames": 73, "fps": 24.0},
            truth={"settled_height": 1.0 - 0.5 * BAR_DENSITY * G / BAR_E},
            source="1 - rho g L / 2 E, a column under its own weight",
        ),
        Scene(
            name="cantilever",
            mesh=lambda: _box((1.0, BEAM_HEIGHT, BEAM_HEIGHT), 4),
            turn=_about_up,
            material=BEAM,
            # drag just above what is critical for the first bending mode: it comes to rest at once
            options={"drop": 0.0, "frames": 16, "fps": 24.0, "floor": False, "drag": 60.0},
            truth={"sag": BENDING + SHEAR},
            source="Timoshenko's beam",
            pinned=lambda centers: centers[:, 0] < -0.5 + 1e-6,
        ),
    )
}


def write_asset(path: Path, scene: Scene, dice: random.Random) -> None:
    """The body of a scene as a stage, with a GeomSubset of its pinned faces."""
    mesh = scene.mesh()
    path.unlink(missing_ok=True)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    made = UsdGeom.Mesh.Define(stage, "/body")
    stage.SetDefaultPrim(made.GetPrim())
    points = scene.turn(dice).apply(mesh.vertices).astype(np.float32)
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    made.CreateFaceVertexCountsAttr([3] * len(mesh.faces))
    made.CreateFaceVertexIndicesAttr(mesh.faces.ravel().tolist())
    made.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    if scene.pinned is not None:
        faces = np.flatnonzero(scene.pinned(mesh.triangles_center))
        subset = UsdGeom.Subset.Define(stage, "/body/held")
        subset.CreateElementTypeAttr(UsdGeom.Tokens.face)
        subset.CreateIndicesAttr(faces.tolist())
    stage.GetRootLayer().Save()


def options_of(scene: Scene, particles: int, dice: random.Random) -> dict[str, Any]:
    """Of `gf_usd.bake`, for a seed."""
    held = {"pins": ["/body/held"]} if scene.pinned is not None else {}
    count = round(particles * dice.uniform(0.9, 1.1))
    return {"material": scene.material, "particles": count, **scene.options, **held}


@dataclass(frozen=True, kw_only=True)
class Row:
    """One figure of one bake."""

    scene: str
    figure: str
    seed: int
    asked: int  # particles, about
    particles: int
    truth: float
    fine: float
    value: float | None  # None: it was not certified
    half: float | None
    order: float | None
    reason: str
    date: str = ""  # ISO 8601, UTC, of the bake
    commit: str = ""  # of which it was baked

    @property
    def holds(self) -> bool:
        """Whether the interval holds the truth."""
        if self.value is None or self.half is None:
            return False
        return abs(self.value - self.truth) <= self.half

    @property
    def width(self) -> float:
        """Width of the interval over the error of the finest run."""
        error = abs(self.fine - self.truth)
        return 2.0 * (self.half or math.nan) / error if error else math.inf


def bake_rows(scene: Scene, particles: int, seed: int, folder: Path) -> list[Row]:
    """The figures of a seed."""
    dice = random.Random(seed)
    asset = folder / f"{scene.name}.usda"
    write_asset(asset, scene, dice)
    result = gf_usd.bake(
        asset, output=f"{folder}/out/", overwrite=True, certify=True, only="mesh", limits=False,
        **options_of(scene, particles, dice),
    )  # fmt: skip
    certificate = result.bakes[0].certificate
    if certificate is None:
        raise SystemExit(f"{asset}: there is no certificate")
    rows = []
    for name, truth in scene.truth.items():
        found = certificate.figures[name]
        rows.append(
            Row(
                scene=scene.name, figure=name, seed=seed, asked=particles,
                particles=result.particles, truth=truth,
                fine=float(found.fine[0]), order=found.order, reason=found.reason,
                value=float(found.value[0]) if found.known else None,
                half=float(found.half) if found.known else None,
                date=time.strftime("%Y-%m-%d", time.gmtime()), commit=git("rev-parse", "HEAD"),
            )
        )  # fmt: skip
    return rows


def table(rows: Sequence[Row]) -> list[str]:
    """The coverage of each scene, figure and resolution, as Markdown."""
    groups: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.figure, row.asked), []).append(row)
    lines = [
        "| scene | figure | particles | bakes | certified | hold the truth | width over error |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for (scene, figure, particles), group in sorted(groups.items()):
        lines.append(_line(f"{scene} | {figure} | about {particles:,}", group))
    return [*lines, _line("all | | ", rows)]


def _line(name: str, group: Sequence[Row]) -> str:
    known = [row for row in group if row.value is not None]
    holds = sum(row.holds for row in known)
    width = statistics.median([row.width for row in known]) if known else math.nan
    share = 100.0 * holds / len(known) if known else math.nan
    return f"| {name} | {len(group)} | {len(known)} | {holds} ({share:.0f} %) | {width:.1f} |"


def outcome(rows: Sequence[Row]) -> Outcome:
    """The results of the intervals, for the page."""
    known = [row for row in rows if row.value is not None]
    holds = sum(row.holds for row in known)
    width = statistics.median([row.width for row in known] or [math.nan])
    head, _, *lines = (
        [cell.strip() for cell in line.strip("|").split("|")] for line in table(rows)
    )
    baked = ", ".join(sorted({f"`{row.commit[:12]}` {row.date}" for row in rows}))
    return Outcome(
        passed=holds >= COVERAGE * len(known) and width <= WIDTH,
        summary=f"{holds} of {len(known)} intervals hold the truth, and the median is"
        f" {width:.1f} times as wide as the error; {len(rows) - len(known)} figures had none;"
        f" baked of {baked}",
        table=(tuple(head), *map(tuple, lines)),
        data=[asdict(row) for row in rows],
    )


def main() -> int:
    """Run the requested cases, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scene", action="append", choices=[*SCENES], default=[])
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--particles", type=int, action="append", default=[])
    parser.add_argument("--rows", type=Path, help="file to add rows to; what it has is kept")
    parser.add_argument("--record", action="store_true", help="write a record of the rows")
    args = parser.parse_args()
    began = time.perf_counter()
    rows = read_rows(args.rows) if args.rows else []
    done = {(row.scene, row.asked, row.seed) for row in rows}
    with tempfile.TemporaryDirectory() as name:
        for scene in args.scene or SCENES:
            for particles in args.particles or RESOLUTIONS:
                for seed in range(args.seeds):
                    if (scene, particles, seed) in done:
                        continue
                    made = bake_rows(SCENES[scene], particles, seed, Path(name))
                    rows += made
                    if args.rows:
                        with args.rows.open("a", encoding="utf-8") as file:
                            file.writelines(json.dumps(asdict(row)) + "\n" for row in made)
                    for row in made:
                        print(f"{row}", file=sys.stderr, flush=True)
    print("\n".join(table(rows)))
    found = outcome(rows)
    print(f"{'passed' if found.passed else 'failed'}: {found.summary}")
    if args.record:
        title = "Certified intervals"
        command = ["python", "-m", "tools.acceptance.certify", *sys.argv[1:]]
        save(record("certify", title, command, time.perf_counter() - began, found))
        write(PAGE, page(newest()))
    return 0 if found.passed else 1


def read_rows(path: Path) -> list[Row]:
    """The rows of a file of `--rows`; none where it is not there yet."""
    if not path.exists():
        return []
    return [Row(**json.loads(line)) for line in path.read_text("utf-8").splitlines()]


if __name__ == "__main__":
    sys.exit(main())
