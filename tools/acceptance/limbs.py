"""Bodies with limbs, each with three presets at defaults: no warning, no part inside another.

    python -m tools.acceptance.limbs ASSETS [--only NAME[:LOOK]]... [--json] [--keep FOLDER]
                                            [--again] [--recorded FILE] [--kept] [--divide SHARE]

ASSETS is a folder with the four assets of `FILES` that are not made here.  A bake passes if it has
no warning and at most 1 % of its surface lies inside a body at the end that was not inside at rest,
as where shells overlap in the source. This is measured on the baked stage, by the winding numbers
of its meshes around pieces of the surface. Bakes in FOLDER are not repeated (with --again they are
measured again), nor are those in FILE, the record of an earlier run; each row has the day and the
commit of its bake. With --kept nothing is baked. Exit status 1 if a bake fails.

Faces remain flat when the body bends: if they are many spacings long, faces intersect although the
body does not. With --divide the faces of a USD asset are divided at the midpoints of their edges
before the bake, mesh by mesh until 95 % of the edges are shorter than SHARE of the asset. This
shows the share of the surface that is due to long faces.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import igl
import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.mesh.subdivision import Pieces, divided
from gf_usd.system import usd_schema as schema  # noqa: F401  (registers itself before any stage opens)
from tools.acceptance.jitter import gf_usd
from tools.acceptance.record import git

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "helpers"))

LOOKS = ("rubber", "metal", "jelly")
FILES = {
    "penguin": "penguin.obj",
    "armchair": "armchair/armchair.usdc",
    "figure": "RiggedFigure.usdz",
    "spot": "spot/spot_low_resolution.obj",
}
MADE = ("hand", "table", "octopus", "rings")
INSIDE = 0.01  # of the surface, at the end
PIECE = 0.01  # of the box at rest: edges of the squares as large as two pieces of the surface
PATIENCE = 7200.0  # [s] for a bake
RESULT = "limbs.json"  # next to a bake: what came of it
# Of the box: how far from the surface a point is wanted, on both sides.  What is as near to
# another place of the same mesh counts as inside although it only touches: at 2e-3 that were half
# of the share of a figure of jelly.  1e-6 are ten times the rounding of points in single precision.
OFF = 1e-6
FIGURES = ("inverted_max", "rollbacks", "min_J", "substeps", "deepest_penetration_spacings",
           "deepest_overlap_spacings", "energy_gain_max_share", "inside_at_end_share",
           "inside_at_end_m")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Ran:
    """One bake and what came of it."""

    asset: str
    look: str
    seconds: float
    particles: int = 0
    inside: float | None = None  # of the surface, at the last frame and not at the first
    at_rest: float | None = None  # of the surface, at the first frame
    figures: dict[str, Any] | None = None  # of its health
    fault: str = ""  # "" if it was sound
    date: str = ""  # ISO 8601, UTC, of the bake
    commit: str = ""  # of which it was baked


def triangles_at(stage: Usd.Stage, frame: int) -> tuple[Any, Any, Any]:
    """Points (n, 3) in the world, triangles (t, 3) and whose they are (t,) of the animated meshes.

    frame : -1 is the last one.  Polygons are fans; faces of meshes that are left handed are turned.
    """
    points, triangles, count = [], [], 0
    for prim in stage.Traverse():
        mesh = UsdGeom.Mesh(prim)
        if not mesh or not (times := mesh.GetPointsAttr().GetTimeSamples()):
            continue
        time = times[frame]
        world = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim))
        X = np.array(mesh.GetPointsAttr().Get(time), float)
        corners = np.array(mesh.GetFaceVertexCountsAttr().Get(time))
        index = np.array(mesh.GetFaceVertexIndicesAttr().Get(time))
        first = np.cumsum(corners) - corners
        fan = np.repeat(first, corners - 2)
        step = np.arange(len(fan)) - np.repeat(np.cumsum(corners - 2) - (corners - 2), corners - 2)
        faces = np.stack([index[fan], index[fan + step + 1], index[fan + step + 2]], 1)
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            faces = faces[:, ::-1]
        points.append(X @ world[:3, :3] + world[3, :3])
        triangles.append(faces + count)
        count += len(X)
    mesh = np.repeat(np.arange(len(triangles)), [len(one) for one in triangles])
    every = np.ascontiguousarray(np.concatenate(triangles), dtype=np.int64)
    return np.concatenate(points), every, mesh


def which_inside(points: Any, triangles: Any, mesh: Any, pieces: Pieces) -> tuple[Any, Any]:
    """(p,) whether both sides of a piece of a triangle have a winding number above 1/2, and its
    area.

    The winding number of its own mesh is evaluated next to it, where it is a whole number, and
    those of the others on it: meshes that touch without penetration have nothing inside.
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    cross = np.cross(b - a, c - a)
    twice = np.linalg.norm(cross, axis=1)
    used = np.flatnonzero((twice > 1e-12 * twice.max())[pieces.of])
    of = pieces.of[used]
    off = OFF * np.ptp(points, axis=0).max() * cross[of] / twice[of, None]
    middle = np.einsum("pk,pka->pa", pieces.weights[used], points[triangles[of]])
    around, whose = np.zeros((2, len(middle))), mesh[of]
    for k in np.unique(mesh):
        own = whose == k
        at = np.concatenate([middle[~own], (middle + off)[own], (middle - off)[own]])
        turns = igl.fast_winding_number(points, triangles[mesh == k], at)
        others, sides = np.split(turns, [(~own).sum()])
        around[:, ~own] += others
        around[:, own] += sides.reshape(2, -1)
    inside = np.zeros(len(pieces.of), bool)
    inside[used] = np.abs(around).min(0) > 0.5
    return inside, 0.5 * twice[pieces.of] * pieces.share


def in_pieces(points: Any, triangles: Any) -> Pieces:
    """The pieces of a surface that are evaluated: one triangle may be a percent of all."""
    edge = PIECE * float(np.ptp(points, axis=0).max())
    return divided(points, triangles, 0.5 * edge**2)


def share_inside(points: Any, triangles: Any, mesh: Any) -> float:
    """Of the area."""
    inside, area = which_inside(points, triangles, mesh, in_pieces(points, triangles))
    return float(area[inside].sum() / area.sum())


def shares_inside(stage: Usd.Stage) -> tuple[float, float]:
    """Of the area: what is inside at the last frame and not at the first, and at the first."""
    rest = triangles_at(stage, 0)
    pieces = in_pieces(*rest[:2])
    before, size = which_inside(*rest, pieces)
    now, stretched = which_inside(*triangles_at(stage, -1), pieces)
    share = float(stretched[now & ~before].sum() / stretched.sum())
    return share, float(size[before].sum() / size.sum())


def divide(source: Path, target: Path, share: float) -> None:
    """Write a stage with the faces of its meshes divided until nearly all edges are shorter than a
    share of all of them; without normals and primvars."""
    Usd.Stage.Open(str(source)).Flatten().Export(str(target))
    stage = Usd.Stage.Open(str(target))
    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    every = np.concatenate([np.asarray(UsdGeom.Mesh(p).GetPointsAttr().Get()) for p in meshes])
    longest = share * float(np.ptp(every, axis=0).max())
    for prim in meshes:
        mesh = UsdGeom.Mesh(prim)
        points = [np.asarray(p, float) for p in mesh.GetPointsAttr().Get()]
        counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get())
        faces = np.split(np.asarray(mesh.GetFaceVertexIndicesAttr().Get()), np.cumsum(counts)[:-1])
        while np.quantile(edges(points, faces), 0.95) > longest:
            points, faces = divided_once(points, faces)
        mesh.GetPointsAttr().Set(np.array(points, np.float32))
        mesh.GetFaceVertexCountsAttr().Set([len(face) for face in faces])
        mesh.GetFaceVertexIndicesAttr().Set(np.concatenate(faces).astype(np.int32))
        mesh.GetNormalsAttr().Clear()
        for name in [p.GetName() for p in prim.GetProperties() if p.GetNamespace() == "primvars"]:
            prim.RemoveProperty(name)
        for child in prim.GetChildren():
            stage.RemovePrim(child.GetPath())
    stage.GetRootLayer().Save()


def edges(points: Sequence[Any], faces: Sequence[Any]) -> Any:
    """Lengths of the edges of all faces."""
    x = np.asarray(points)
    return np.concatenate([np.linalg.norm(x[f] - x[np.roll(f, 1)], axis=1) for f in faces])


def divided_once(points: list[Any], faces: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Each face as quadrilaterals around its middle."""
    points, middles = list(points), {}

    def middle(a: int, b: int) -> int:
        edge = (min(a, b), max(a, b))
        if edge not in middles:
            middles[edge] = len(points)
            points.append(0.5 * (points[a] + points[b]))
        return middles[edge]

    found = []
    for face in faces:
        around = [int(k) for k in face]
        center = len(points)
        points.append(np.mean([points[k] for k in around], axis=0))
        for before, at, after in zip(around[-1:] + around[:-1], around, around[1:] + around[:1]):
            found.append(np.array([at, middle(at, after), center, middle(before, at)]))
    return points, found


def bake(name: str, look: str, file: Path, folder: Path) -> Ran:
    """One bake at defaults, in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    began, date = time.perf_counter(), time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    arguments = ("bake", str(file.resolve()), "--material", look, "-o", f"{folder}/", "--json")
    status, _, errors = gf_usd(folder, *arguments, patience=PATIENCE)
    ran = Ran(
        asset=name, look=look, seconds=round(time.perf_counter() - began, 1), date=date,
        commit=git("rev-parse", "HEAD"),
    )  # fmt: skip
    if status != 0:
        message = " ".join(errors[errors.find("error:") :].split())[:600]
        return replace(ran, fault=f"status {status}: {message}")
    return measured(ran, folder)


def measured(ran: Ran, folder: Path) -> Ran:
    """A bake with what is seen in its report and on its stage."""
    (written,) = folder.glob("*.report.json")
    report = json.loads(written.read_text("utf-8"))
    health = report["bakes"][0]["health"]
    stage = Usd.Stage.Open(str(written.with_name(written.name.replace(".report.json", ".usda"))))
    inside, at_rest = shares_inside(stage)
    faults = [f"warning: {w['message']}" for w in report["warnings"]]
    if inside > INSIDE:
        faults.append(f"{100.0 * inside:.2g} % of the surface lies inside at the end")
    return replace(
        ran, particles=report["particles"], inside=inside, at_rest=at_rest,
        figures={name: health[name] for name in FIGURES}, fault="; ".join(faults),
    )  # fmt: skip


def recorded(file: Path) -> dict[tuple[str, str], Ran]:
    """The bakes in the record of an earlier run, by asset and preset."""
    tree = json.loads(file.read_text("utf-8"))
    since = {"date": tree["date"], "commit": tree["commit"]}
    rows = [Ran(**{**since, **row}) for row in tree["outcome"]["data"]["runs"]]
    return {(ran.asset, ran.look): ran for ran in rows}


def main(arguments: Sequence[str] | None = None) -> int:
    """Bake them and print what came of it."""
    from limbed import write_limbed

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("assets", type=Path)
    parser.add_argument("--only", action="append", default=[], metavar="NAME[:LOOK]")
    parser.add_argument("--json", action="store_true", help="print the bakes as JSON")
    parser.add_argument("--keep", type=Path, help="folder for what was baked")
    parser.add_argument("--again", action="store_true", help="measure again what is in that folder")
    parser.add_argument("--recorded", type=Path, help="record with rows that are not baked again")
    parser.add_argument("--kept", action="store_true", help="bake nothing")
    parser.add_argument("--divide", type=float, metavar="SHARE", help="divide long faces first")
    args = parser.parse_args(arguments)
    wanted = [word.partition(":")[::2] for word in args.only] or [("", "")]
    pairs = [
        (name, look)
        for name in (*FILES, *MADE)
        for look in LOOKS
        if any(a in ("", name) and b in ("", look) for a, b in wanted)
    ]
    if not pairs:
        parser.error(f"--only: choose of {', '.join((*FILES, *MADE))}, each with :LOOK or without")
    runs, before = [], recorded(args.recorded) if args.recorded else {}
    with tempfile.TemporaryDirectory() as scratch:
        for name, look in pairs:
            folder = (args.keep or Path(scratch)) / name
            folder.mkdir(parents=True, exist_ok=True)
            file = args.assets / FILES[name] if name in FILES else folder / f"{name}.usda"
            if name in MADE and not file.exists():
                write_limbed(name, file)
            if args.divide:
                if file.suffix not in (".usda", ".usdc", ".usdz"):
                    parser.error(f"--divide: {file.name} is not USD")
                whole, file = file, folder / f"{name}-divided.usdc"
                divide(whole, file, args.divide)
            seen = folder / look / RESULT
            if seen.exists():
                one = Ran(**json.loads(seen.read_text("utf-8")))
                if not args.again:
                    runs.append(one)
                    continue
                one = measured(one, folder / look)
            elif one := before.get((name, look)):
                runs.append(one)
                continue
            elif args.kept:
                continue
            else:
                one = bake(name, look, file, folder / look)
            runs.append(one)
            seen.write_text(json.dumps(asdict(one)) + "\n", "utf-8")
            share = "" if one.inside is None else f", {100.0 * one.inside:.2f} % inside"
            print(
                f"{name} {look}: {one.particles} particles, {one.seconds} s{share},"
                f" {one.fault or 'sound'}",
                file=sys.stderr, flush=True,
            )  # fmt: skip
    if args.json:
        print(json.dumps({"runs": [asdict(ran) for ran in runs]}))
    return 1 if any(ran.fault for ran in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
