"""Make the pictures of the documents with the program itself.

    python tools/pictures.py [--out FOLDER] [--only NAME ...]

Bakes samples into a temporary folder, draws frames with ``gf-usd preview`` and joins them:

    duck.png     the start of the fall, the hardest squash, the top of the rebound
    looks.png    rubber, metal and jelly, each at maximum compression in the first bounce
    displays.png one frame as mesh, Gaussians, ellipsoids and points
    strain.png   the squash, colored by strain
    drop.gif     the drop as a film, five times slower than real
    walk.gif     the walk of the creature without and with flesh, one period
    ten-ducks.png  the pile of ducks in the rocking bowl, near its end
    can.gif      a tin can under a press, at half of real speed
    plastic.png  the can before and after, and its plastic strain
    clay.png     the duck of clay, thrown on the floor, and its plastic strain
    star.png     a star of foil, thrown on a ball: how it folds over it
    flesh-goal.png, flesh-bones.png  the creature in one frame of its walk, with three settings each
    flesh-limits.png  the same frame with no limit of stretch, 0.5 and 0.2
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PIL import Image
from pxr import Gf, Usd, UsdGeom

from tools.samples.crumple import DOWN, HOLD, UP, WAIT, write_can, write_star
from tools.samples.side_by_side import repeat_cycle, side_by_side

ROOT = Path(__file__).resolve().parent.parent
DUCK = ROOT / "samples" / "duck.usda"
CREATURE = ROOT / "samples" / "creature.usda"
TEN_DUCKS = ROOT / "samples" / "ten_ducks.usda"
PILE = 75  # time code
BACK = Gf.Vec3d(-8.0, 0.0, -13.0)  # [m] away from the camera, of the ground below the pile
STAR, CLAY = (1, 5, 7, 24), (1, 4, 25)  # time codes
FPS_CAN = 12
STRIDE = 20  # time code of the creature's walk
STRETCHES = ("", "0.5", "0.2")
DIMENSIONLESS = ("rubber", "metal", "jelly")
DISPLAYS = ("mesh", "gaussians", "ellipsoids", "points")
LARGEST = 500_000  # bytes of a picture in the repository
LARGEST_FILM = 2_000_000
KINDS = ("duck", "film", "pile", "walk", "can", "clay", "star", "flesh", "limits")
FPS = 96  # four times the usual: a bounce of the 10 cm duck is over in three frames at 24
# The film: a lower fall than the default, so that the duck is larger in it; until it has bounced
# twice.  Played at 24 frames per second, a fifth of real speed.
DROP = ("--drop", "2.5r", "--time-scale", "0.2", "--fps", "24", "--frames", "58")
FILM = "420x420"
FRAMES = 40  # to the top of the rebound and no further: the camera is fitted to the whole motion


def gf_usd(*arguments: str | int | Path) -> str:
    """Run the command line; returns its stdout.  Raises CalledProcessError where it fails."""
    command = [sys.executable, "-m", "gf_usd", *map(str, arguments)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def film(path: Path, folder: Path) -> None:
    """The drop as an animated picture of at most `LARGEST_FILM` bytes."""
    stage = folder / "drop.usda"
    gf_usd("bake", DUCK, "--material", "rubber", *DROP, "-o", stage)
    gf_usd("preview", stage, "-o", path, "--size", FILM)
    require(path, LARGEST_FILM)


def walk(path: Path, folder: Path) -> None:
    """The second of two cycles of the creature's walk, without flesh and with it."""
    twice, both = folder / "twice.usda", folder / "both.usda"
    cycle = repeat_cycle(CREATURE, twice, 2)
    gf_usd("bake", twice, "--flesh", "--material", "jelly", "--only", "mesh", "-o", f"{folder}/")
    baked = folder / "twice.jelly.usda"
    side_by_side(twice, baked, both, apart=62.0, height=70.0, away=190.0)
    frames = f"{cycle + 1}:{2 * cycle}"
    gf_usd("preview", both, "-o", path, "--camera", "/World/Camera", "--time-codes", frames,
           "--size", "560x340")  # fmt: skip
    require(path, LARGEST_FILM)


def pile(path: Path, folder: Path) -> None:
    """The ten ducks in their bowl, cut out of a frame that fits the whole motion."""
    gf_usd("bake", TEN_DUCKS, "--frames", PILE, "-o", f"{folder}/", "--quiet")
    baked = folder / "ten_ducks.authored.usda"
    stage = Usd.Stage.Open(str(baked))
    # the plate under the bake is moved back, so that none of its corners is in the picture
    place = UsdGeom.Xformable(stage.GetPrimAtPath("/TenDucks/Ground")).GetOrderedXformOps()[0]
    place.Set(place.Get() + BACK)
    stage.GetRootLayer().Save()
    picture = draw(baked, PILE, (1400, 1000))
    strip([picture.crop((388, 550, 988, 950))], path)


def crushed(film: Path, path: Path, folder: Path) -> None:
    """The can under its press: a film, and before, after and what is left of strain."""
    write_can(folder / "can.usda")
    last = WAIT + DOWN + HOLD + UP + 1
    length = ("--frames", str(last), "--floor", "0", "--particles", "6000", "--internal")
    stage = folder / "can.dented.usda"
    gf_usd("bake", folder / "can.usda", "--material", "dented", *length, "-o", stage, "--quiet")
    gf_usd("preview", stage, "-o", film, "--size", "320x356", "--fps", str(FPS_CAN))
    require(film, LARGEST_FILM)
    shown = [draw(stage, frame, (420, 480)) for frame in (1, WAIT + DOWN // 2, last)]
    strain = draw(stage, last, (560, 480), "mesh", "--color", "plastic")
    strip([*shown, strain], path)


def thrown(path: Path, folder: Path) -> None:
    """The duck of clay: before it is hit, as it is hit, as it stays, and its plastic strain."""
    stage = folder / "duck.clay.usda"
    options = ("--drop", "0.6r", "--velocity", "0,-200,0", "--time-scale", "0.15", "--internal")
    length = ("--particles", "3000", "--frames", str(CLAY[-1]))
    gf_usd("bake", DUCK, "--material", "clay", *options, *length, "-o", stage, "--quiet")
    shown = [draw(stage, frame, (420, 400)) for frame in CLAY]
    strain = draw(stage, CLAY[-1], (560, 400), "mesh", "--color", "plastic")
    strip([*shown, strain], path)


def crumpled(path: Path, folder: Path) -> None:
    """The star of foil: before, as it folds over the ball, and as it stays."""
    write_star(folder / "star.usda")
    stage = folder / "star.dented.usda"
    options = ("--particles", "2500", "--frames", str(STAR[-1]), "--floor", "0", "--drop", "1.1")
    arguments = (*options, "--velocity", "0,-3,0", "-o", stage, "--quiet")
    gf_usd("bake", folder / "star.usda", "--material", "dented", *arguments)
    pictures = [draw(stage, frame, (460, 460)) for frame in STAR]
    strip([p.crop((0, 45, 460, 445)) for p in pictures], path)


def flesh(goal: Path, bones: Path, folder: Path) -> None:
    """One frame of the creature's walk by the settings of its flesh, softest first."""
    settings = {
        "free": (),
        "2 Hz": ("--goal-frequency", "2"),
        "8 Hz": ("--goal-frequency", "8"),
        "thin": ("--bone-radius", "0.3"),
        "thick": ("--bone-radius", "0.8"),
    }
    shown = {}
    for name, more in settings.items():
        stage = folder / f"{name.replace(' ', '')}.usda"
        options = ("--material", "jelly", "--particles", "3000", "--only", "mesh", *more)
        gf_usd("bake", CREATURE, "--flesh", *options, "-o", stage, "--quiet")
        shown[name] = draw(stage, STRIDE, (420, 420)).crop((90, 20, 350, 400))
    strip([shown[name] for name in ("free", "2 Hz", "8 Hz")], goal)
    strip([shown[name] for name in ("thin", "free", "thick")], bones)


def limits(path: Path, folder: Path) -> None:
    """The same frame of flesh around thin bones: without a limit, and kept nearer to its pose."""
    shown = []
    for stretch in STRETCHES:
        stage = folder / f"stretch{len(shown)}.usda"
        options = ("--material", "jelly", "--particles", "3000", "--only", "mesh")
        limit = ("--bone-radius", "0.3", *(("--stretch", stretch) if stretch else ()))
        gf_usd("bake", CREATURE, "--flesh", *options, *limit, "-o", stage, "--quiet")
        shown.append(draw(stage, STRIDE, (420, 420)).crop((90, 20, 350, 400)))
    strip(shown, path)


def require(path: Path, largest: int) -> None:
    """Say how large a file is; SystemExit where it is larger than it may be."""
    size = path.stat().st_size
    if size > largest:
        raise SystemExit(f"{path} has {size} bytes, more than {largest}: draw it smaller")
    print(f"{path}: {size / 1e3:.0f} kB")


def bake(look: str, folder: Path) -> tuple[Path, list[int]]:
    """Bake the duck; returns its root layer and the time codes of fall, squash and rebound."""
    length = ("--fps", str(FPS), "--frames", str(FRAMES), "--deformation-gradients")
    out = gf_usd("bake", DUCK, "--material", look, *length, "-o", f"{folder}/", "--json")
    result = json.loads(out)
    report = json.loads(Path(result["report"]).read_text("utf-8"))
    frames = report["bakes"][0]["per_frame"]
    return Path(result["root"]), [1 + index for index in moments(frames)]


def moments(frames: Sequence[dict[str, Any]]) -> tuple[int, int, int]:
    """Indices of the first frame, of the lowest center in the first bounce, and of the top of the
    rebound after it (where nothing leaves the floor: the highest center that follows)."""
    height = [frame["center"][1] for frame in frames]
    touching = [frame["penetration"] > 0.0 for frame in frames]
    first = touching.index(True)
    end = next((i for i in range(first, len(frames)) if not touching[i]), len(frames))
    squash = min(range(first, end), key=height.__getitem__)
    again = next((i for i in range(end, len(frames)) if touching[i]), len(frames))
    rebound = max(range(squash, again), key=height.__getitem__)
    return 0, squash, rebound


def draw(
    stage: Path, frame: int, size: tuple[int, int], show: str = "mesh", *options: str
) -> Image.Image:
    """One frame of a bake as ``gf-usd preview`` draws it."""
    target = stage.with_name(f"{stage.stem}.{show}.{frame}.png")
    shape = f"{size[0]}x{size[1]}"
    chosen = ("--frame", str(frame), "--show", show, "--size", shape, *options)
    gf_usd("preview", stage, "-o", target, *chosen)
    with Image.open(target) as picture:
        return picture.convert("RGB")


def near(picture: Image.Image, left: float, right: float) -> Image.Image:
    """The part where the duck meets the floor, between two fractions of the width."""
    width, height = picture.size
    return picture.crop((int(left * width), int(0.52 * height), int(right * width),
                         int(0.97 * height)))  # fmt: skip


def strip(pictures: Sequence[Image.Image], path: Path) -> None:
    """Pictures of one height side by side, as a PNG of at most `LARGEST` bytes."""
    joined = Image.new("RGB", (sum(p.width for p in pictures), pictures[0].height))
    at = 0
    for picture in pictures:
        joined.paste(picture, (at, 0))
        at += picture.width
    joined.save(path, optimize=True)
    require(path, LARGEST)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder")
    parser.add_argument("--only", choices=KINDS, nargs="*", help="which of them")
    args = parser.parse_args()
    out: Path = args.out
    out.mkdir(parents=True, exist_ok=True)
    made = args.only or KINDS
    with tempfile.TemporaryDirectory() as temporary:
        if "pile" in made:
            pile(out / "ten-ducks.png", Path(temporary))
        if "walk" in made:
            walk(out / "walk.gif", Path(temporary))
        if "film" in made:
            film(out / "drop.gif", Path(temporary))
        if "can" in made:
            crushed(out / "can.gif", out / "plastic.png", Path(temporary))
        if "clay" in made:
            thrown(out / "clay.png", Path(temporary))
        if "star" in made:
            crumpled(out / "star.png", Path(temporary))
        if "flesh" in made:
            flesh(out / "flesh-goal.png", out / "flesh-bones.png", Path(temporary))
        if "limits" in made:
            limits(out / "flesh-limits.png", Path(temporary))
        if "duck" not in made:
            return
        baked = {look: bake(look, Path(temporary)) for look in DIMENSIONLESS}
        stage, (start, squash, rebound) = baked["rubber"]
        shot = [draw(stage, frame, (480, 480)) for frame in (start, squash, rebound)]
        strip(shot, out / "duck.png")
        squashed = [draw(s, times[1], (560, 784)) for s, times in baked.values()]
        strip([near(picture, 0.17, 0.93) for picture in squashed], out / "looks.png")
        shown = [draw(stage, squash, (440, 770), show) for show in DISPLAYS]
        strip([near(picture, 0.28, 0.98) for picture in shown], out / "displays.png")
        strain = draw(stage, squash, (800, 600), "mesh", "--color", "strain")
        # the part that holds the legend and the duck
        strip([strain.crop((0, 160, 800, 600))], out / "strain.png")


if __name__ == "__main__":
    main()
