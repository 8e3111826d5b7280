"""Characters with --flesh at defaults: no warning, nothing inside itself or skinned twice.

    python -m tools.acceptance.characters ASSETS [--only NAME]... [--particles N] [--keep FOLDER]

ASSETS is a folder with the two characters of `FILES` that are not samples.  A bake passes if it has
no warning, at most 1 % of its surface lies inside a body in every frame, and no moving mesh is
still bound to its skeleton. Exit status 1 if a bake fails.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pxr import Usd, UsdGeom, UsdSkel

from gf_usd.system import usd_schema as schema  # noqa: F401  (registers itself before any stage opens)
from tools.acceptance.jitter import gf_usd
from tools.acceptance.limbs import FIGURES, INSIDE, share_inside, triangles_at

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
FILES = {
    "creature": SAMPLES / "creature.usda",
    "figure": Path("RiggedFigure.usdz"),
    "simple": Path("RiggedSimple.usdz"),
}
PATIENCE = 3600.0  # [s] for a bake


@dataclass(frozen=True, kw_only=True)
class Ran:
    """One bake and what came of it."""

    name: str
    particles: int = 0
    inside: float | None = None  # of the surface, at the frame with the most
    figures: dict[str, Any] | None = None  # of its health
    faults: tuple[str, ...] = ()


def deforming(stage: Usd.Stage) -> list[UsdGeom.Mesh]:
    """The meshes whose points have time samples."""
    meshes = (UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    return [mesh for mesh in meshes if mesh.GetPointsAttr().GetNumTimeSamples()]


def skinned(stage: Usd.Stage) -> list[str]:
    """Paths of moving meshes that a skeleton would pose once more."""
    out = []
    for root in (UsdSkel.Root(prim) for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)):
        cache = UsdSkel.Cache()
        cache.Populate(root, Usd.PrimDefaultPredicate)
        for mesh in deforming(stage):
            query = cache.GetSkinningQuery(mesh.GetPrim())
            if query and query.HasJointInfluences():
                out.append(str(mesh.GetPath()))
    return out


def bake(name: str, file: Path, folder: Path, particles: int | None) -> Ran:
    """One bake at defaults but for the number of particles, in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    more = ("--particles", str(particles)) if particles else ()
    arguments = ("bake", str(file.resolve()), "--flesh", *more, "-o", f"{folder}/", "--json")
    status, printed, errors = gf_usd(folder, *arguments, "--overwrite", patience=PATIENCE)
    if status != 0:
        message = " ".join(errors[errors.find("error:") :].split())[:600]
        return Ran(name=name, faults=(f"status {status}: {message}",))
    report = json.loads(printed)
    stage = Usd.Stage.Open(report["root"])
    frames = deforming(stage)[0].GetPointsAttr().GetNumTimeSamples()
    inside = max(share_inside(*triangles_at(stage, frame)) for frame in range(frames))
    faults = [f"warning: {w['message']}" for w in report["warnings"]]
    if inside > INSIDE:
        faults.append(f"{100.0 * inside:.2g} % of the surface lies inside")
    faults += [f"<{path}> is skinned once more" for path in skinned(stage)]
    health = report["bakes"][0]["health"]
    return Ran(
        name=name, particles=report["particles"], inside=inside,
        figures={key: health[key] for key in FIGURES}, faults=tuple(faults),
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Bake them and print what came of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("assets", type=Path)
    parser.add_argument("--only", action="append", default=[], choices=tuple(FILES))
    parser.add_argument("--particles", type=int, help="fewer or more than the default")
    parser.add_argument("--keep", type=Path, help="folder for what was baked")
    args = parser.parse_args(arguments)
    runs = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in args.only or FILES:
            folder = (args.keep or Path(scratch)) / name
            one = bake(name, args.assets / FILES[name], folder, args.particles)
            runs.append(one)
            print(json.dumps(asdict(one)), flush=True)
    return 1 if any(one.faults for one in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
