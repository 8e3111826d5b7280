"""How often the intervals of ``bake --certify`` hold the truth, and how wide they are.

    python -m tools.acceptance.certify [--scene NAME]... [--seeds N] [--particles N]...
                                       [--json FILE]

Every scene has a figure whose answer is known: in closed form, or as the limit of much finer runs.
A seed turns the body about its axis of symmetry and changes the number of particles by up to a
tenth, which moves the lattice of particles, the grid and the contact samples.  Of each row the
table says how many intervals hold the truth, and the median of their width over the error of the
finest run.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import statistics
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gf_usd.system import usd_schema  # noqa: F401  # isort: skip  (before pxr opens a stage)
from pxr import Usd, UsdGeom, Vt
from scipy.spatial.transform import Rotation

from gf_usd.core.materials import Material
from tools.bench import scene as bench

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
BEAM = Material(
    name="beam", law="corotated", density=1000.0, youngs_modulus=3e6, poissons_ratio=0.3,
    friction=0.0, restitution=0.0, damping_time=0.0,
)  # fmt: skip

SCENES = {
    one.name: one
    for one in (
        Scene(
            name="ball",
            mesh=lambda: trimesh.creation.icosphere(4),
            turn=_anyhow,
            material=BALL,
            options={"drop": "0.52", "frames": "28", "fps": 24.0, "filter_rate": 0.0},
            # over its own diameter, which faces make a little smaller than 2 m
            truth={"squash": 1.0 - 0.7790, "rebound": 0.5061},
            source="BENCHMARKS.md, tools/bench/equal_error.py",
        ),
        Scene(
            name="bar",
            mesh=lambda: _box((0.5, 1.0, 0.5), 3),
            turn=_about_up,
            material=BAR,
            options={"drop": "0", "frames": "16", "fps": 48.0, "floor": "none"},
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
            options={"drop": "0", "frames": "73", "fps": 24.0},
            truth={"settled_height": 1.0 - 0.5 * BAR_DENSITY * G / BAR_E},
            source="1 - rho g L / 2 E, a column under its own weight",
        ),
        Scene(
            name="cantilever",
            mesh=lambda: _box((1.0, 0.25, 0.25), 4),
            turn=_about_up,
            material=BEAM,
            options={"drop": "0", "frames": "9", "fps": 24.0, "floor": "none"},
            truth={"sag": math.nan},
            source="",
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
    """Of `gf_usd.pipeline.run.prepare`, for a seed."""
    held = {"pins": ("/body/held",)} if scene.pinned is not None else {}
    count = round(particles * dice.uniform(0.9, 1.1))
    return {"material": (scene.material,), "particles": count, **scene.options, **held}
