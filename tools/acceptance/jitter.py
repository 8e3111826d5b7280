"""Every sample ten times with random seed, position and parameters: all must pass.

    python -m tools.acceptance.jitter [--json] [--runs N] [--seed S] [--keep FOLDER]
                                      [--only FILE]... [--rows FILE] [--kept]

A scene is put under an Xform that moves and turns it about the up axis, and is baked by `gf-usd
bake`; `gf-usd check` then checks the result. A run passes if neither reports anything except the
known warnings of the scene. Each run is appended to the FILE of --rows, with the day and the
commit; runs that are in it already are not baked again, and with --kept nothing is baked. Exit
status 1 if one fails.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pxr import Gf, Sdf, Usd, UsdGeom

from gf_usd.system import usd_schema as schema  # noqa: F401  (registers itself before any stage opens)
from tools.acceptance.record import git

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
RUNS = 10
PATIENCE = 900.0  # [s] for one bake, on a busy machine
FAR = 20.0  # [bounding boxes] that a scene is moved, at most, along each level axis


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A sample and what of its bake is drawn by lot."""

    file: str
    options: Callable[[random.Random], dict[str, str]]
    known: tuple[str, ...] = ()  # what warnings of the scene as it is are about


@dataclass(frozen=True, kw_only=True)
class Ran:
    """One bake and what came of it."""

    scene: str
    number: int
    command: str
    place: tuple[float, float, float]  # [stage units] of the scene, along x, y, z
    turned: float  # [degrees] about the up axis
    seconds: float
    warnings: tuple[str, ...] = ()  # what they are about
    figures: dict[str, Any] | None = None  # of the health of the bake
    fault: str = ""  # "" if it was sound
    seed: int = 0  # of all runs
    date: str = ""  # ISO 8601, UTC
    commit: str = ""  # of which it was baked


def one_body(dice: random.Random) -> dict[str, str]:
    """Options for a sample without physics: the presets, as far as they are laid out."""
    material = dice.choice(("rubber", "jelly", "metal"))
    fps, drop, gravity = dice.choice((24, 30, 48)), dice.uniform(0.3, 3.0), dice.uniform(5.0, 11.0)
    # long enough for a body of 1 m, the largest, to fall and to bounce
    seconds = math.sqrt(2.0 * drop / gravity) + dice.uniform(0.3, 0.8)
    # what is as soft as jelly turns inside out with corotated, and a warning says so
    laws = ("neoHookean",) if material == "jelly" else ("corotated", "neoHookean")
    return {
        "--material": material,
        "--law": dice.choice(laws),
        "--particles": str(dice.randint(1000, 2000)),
        "--drop": f"{drop:.3f}r",
        "--gravity": f"{gravity:.3f}",
        "--friction": f"{dice.uniform(0.0, 1.0):.3f}",
        "--restitution": f"{dice.uniform(0.0, 1.0):.3f}",
        "--fps": str(fps),
        "--frames": str(math.ceil(seconds * fps)),
    }


def many_bodies(dice: random.Random) -> dict[str, str]:
    """Options for the stage with physics of its own: its materials stay."""
    return {
        "--particles": str(dice.randint(6500, 7500)),
        "--gravity": f"{dice.uniform(7.0, 10.0):.3f}",
        "--frames": str(dice.randint(18, 22)),
    }


SCENES = (
    Scene(file="sphere.usda", options=one_body),
    Scene(file="deformed_sphere.usda", options=one_body),
    Scene(file="duck.usda", options=one_body),
    Scene(file="ten_ducks.usda", options=many_bodies),
)
FIGURES = ("restitution", "deepest_penetration_spacings", "deepest_overlap_spacings", "min_J",
           "energy_gain_max_share", "rollbacks")  # fmt: skip


def place(source: Path, target: Path, dice: random.Random) -> tuple[tuple[float, ...], float]:
    """Write a stage with the source moved and turned; the place [stage units] and angle."""
    scene = Usd.Stage.Open(str(source))
    up = "XYZ".index(UsdGeom.GetStageUpAxis(scene))
    boxes = UsdGeom.BBoxCache(Usd.TimeCode.EarliestTime(), ["default", "render"])
    size = max(boxes.ComputeWorldBound(scene.GetPseudoRoot()).ComputeAlignedRange().GetSize())
    away = [dice.uniform(-FAR, FAR) * size for _ in range(3)]
    away[up] = 0.0  # the floor, or the bowl, is where it was
    angle = dice.uniform(0.0, 360.0)
    layer = Sdf.Layer.CreateNew(str(target))
    for key in ("upAxis", "metersPerUnit", "timeCodesPerSecond", "startTimeCode", "endTimeCode"):
        if scene.GetRootLayer().pseudoRoot.HasInfo(key):
            layer.pseudoRoot.SetInfo(key, scene.GetRootLayer().pseudoRoot.GetInfo(key))
    stage = Usd.Stage.Open(layer)
    above = UsdGeom.Xform.Define(stage, "/Placed")
    stage.SetDefaultPrim(above.GetPrim())
    above.AddTranslateOp().Set(Gf.Vec3d(*away))
    turns = (above.AddRotateXOp, above.AddRotateYOp, above.AddRotateZOp)
    turns[up]().Set(angle)
    below = stage.DefinePrim(f"/Placed/{scene.GetDefaultPrim().GetName()}")
    below.GetReferences().AddReference(source.resolve().as_posix())
    layer.Save()
    return tuple(away), angle


def bake(scene: Scene, number: int, seed: int, folder: Path) -> Ran:
    """One run, in a folder of its own."""
    dice = random.Random(f"{seed}:{scene.file}:{number}")
    folder.mkdir(parents=True)
    where, angle = place(SAMPLES / scene.file, folder / "scene.usda", dice)
    options = {"--seed": str(dice.randrange(2**31)), **scene.options(dice)}
    arguments = [word for pair in options.items() for word in pair]
    began = time.perf_counter()
    status, printed, errors = gf_usd(folder, "bake", "scene.usda", *arguments, "--json")
    ran = Ran(
        scene=scene.file,
        number=number,
        command="gf-usd bake scene.usda " + " ".join(arguments),
        place=(where[0], where[1], where[2]),
        turned=angle,
        seconds=0.0,
        seed=seed,
        date=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        commit=git("rev-parse", "HEAD"),
    )
    found: dict[str, Any] = {}
    if status == 0:
        report = json.loads(printed)
        health = report["bakes"][0]["health"]
        found = {
            "figures": {name: health[name] for name in FIGURES},
            "warnings": tuple(w["about"] for w in report["warnings"]),
        }
        bad = [w["message"] for w in report["warnings"] if w["about"] not in scene.known]
        if bad:
            found["fault"] = "warning: " + "; ".join(bad)
        checked, messages, _ = gf_usd(folder, "check", report["root"])
        if checked != 0:
            found["fault"] = messages.strip().splitlines()[-1]
    else:
        message = errors[errors.find("error:") :]  # less the plan and the progress
        found["fault"] = f"status {status}: {' '.join(message.split())}"[:600]
    return Ran(**{**asdict(ran), **found, "seconds": round(time.perf_counter() - began, 1)})


def gf_usd(folder: Path, *arguments: str, patience: float = PATIENCE) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of a command; status 124 where it took too long."""
    command = [sys.executable, "-m", "gf_usd", *arguments]
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=patience, check=False
        )
    except subprocess.TimeoutExpired:
        return 124, "", f"it took longer than {patience:g} s"
    return done.returncode, done.stdout, done.stderr


def earlier(file: Path | None, seed: int) -> dict[tuple[str, int], Ran]:
    """Runs of a seed that a file of rows has, by scene and number; none where it is not there."""
    if file is None or not file.exists():
        return {}
    rows = [Ran(**json.loads(line)) for line in file.read_text("utf-8").splitlines()]
    return {(ran.scene, ran.number): ran for ran in rows if ran.seed == seed}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all and print what came of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true", help="print the runs as JSON")
    parser.add_argument("--runs", type=int, default=RUNS, help="of each scene")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for what was baked")
    parser.add_argument("--only", action="append", choices=[scene.file for scene in SCENES])
    parser.add_argument("--rows", type=Path, help="JSON lines of the runs, to continue from")
    parser.add_argument("--kept", action="store_true", help="bake nothing")
    args = parser.parse_args(arguments)
    there = earlier(args.rows, args.seed)
    runs = []
    with tempfile.TemporaryDirectory() as scratch:
        for scene in SCENES:
            for number in range(args.runs):
                if args.only and scene.file not in args.only:
                    continue
                if one := there.get((scene.file, number)):
                    runs.append(one)
                    continue
                if args.kept:
                    continue
                folder = (args.keep or Path(scratch)) / scene.file.partition(".")[0] / str(number)
                runs.append(bake(scene, number, args.seed, folder))
                if args.rows:
                    with args.rows.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(asdict(runs[-1])) + "\n")
                verdict = runs[-1].fault or "sound"
                print(f"{scene.file} {number}: {runs[-1].seconds} s, {verdict}", file=sys.stderr)
    if args.json:
        print(json.dumps({"seed": args.seed, "runs": [asdict(ran) for ran in runs]}))
    return 1 if any(ran.fault for ran in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
