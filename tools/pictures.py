"""Make the pictures of the documents with the program itself.

    python tools/pictures.py [--out FOLDER]

Bakes the sample duck into a temporary folder, draws frames with ``gf-usd preview`` and joins them:

    duck.png     the start of the fall, the hardest squash, the top of the rebound
    looks.png    rubber, metal and jelly, each at its hardest squash in the first bounce
    displays.png one frame as mesh, Gaussians, ellipsoids and points
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

ROOT = Path(__file__).resolve().parent.parent
DUCK = ROOT / "samples" / "duck.usda"
LOOKS = ("rubber", "metal", "jelly")
DISPLAYS = ("mesh", "gaussians", "ellipsoids", "points")
LARGEST = 500_000  # bytes of a picture in the repository
FPS = 96  # four times the usual: a bounce of the 10 cm duck is over in three frames at 24
FRAMES = 40  # to the top of the rebound and no further: the camera is fitted to the whole motion


def gf_usd(*words: str | Path) -> str:
    """Run the command line; returns its stdout.  Raises CalledProcessError where it fails."""
    command = [sys.executable, "-m", "gf_usd", *map(str, words)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def bake(look: str, folder: Path) -> tuple[Path, list[int]]:
    """Bake the duck; returns its root layer and the time codes of fall, squash and rebound."""
    length = ("--fps", str(FPS), "--frames", str(FRAMES))
    out = gf_usd("bake", DUCK, "--material", look, *length, "-o", f"{folder}/", "--json")
    result = json.loads(out)
    report = json.loads(Path(result["report"]).read_text("utf-8"))
    frames = report["bakes"][0]["per_frame"]
    return Path(result["root"]), [1 + index for index in moments(frames)]


def moments(frames: Sequence[dict[str, Any]]) -> tuple[int, int, int]:
    """Indices of the first frame, of the lowest centre in the first bounce, and of the top of the
    rebound after it (where nothing leaves the floor: the highest centre that follows)."""
    height = [frame["centre"][1] for frame in frames]
    touching = [frame["penetration"] > 0.0 for frame in frames]
    first = touching.index(True)
    end = next((i for i in range(first, len(frames)) if not touching[i]), len(frames))
    squash = min(range(first, end), key=height.__getitem__)
    again = next((i for i in range(end, len(frames)) if touching[i]), len(frames))
    rebound = max(range(squash, again), key=height.__getitem__)
    return 0, squash, rebound


def draw(stage: Path, frame: int, size: tuple[int, int], show: str = "mesh") -> Image.Image:
    """One frame of a bake as ``gf-usd preview`` draws it."""
    target = stage.with_name(f"{stage.stem}.{show}.{frame}.png")
    shape = f"{size[0]}x{size[1]}"
    gf_usd("preview", stage, "-o", target, "--frame", str(frame), "--show", show, "--size", shape)
    with Image.open(target) as picture:
        return picture.convert("RGB")


def low(picture: Image.Image) -> Image.Image:
    """The lower half, where the duck meets the floor."""
    return picture.crop((0, picture.height // 2, picture.width, picture.height))


def strip(pictures: Sequence[Image.Image], path: Path) -> None:
    """Pictures of one height side by side, as a PNG of at most `LARGEST` bytes."""
    joined = Image.new("RGB", (sum(p.width for p in pictures), pictures[0].height))
    at = 0
    for picture in pictures:
        joined.paste(picture, (at, 0))
        at += picture.width
    joined.save(path, optimize=True)
    size = path.stat().st_size
    if size > LARGEST:
        raise SystemExit(f"{path} has {size} bytes, more than {LARGEST}: draw it smaller")
    print(f"{path}: {joined.width}x{joined.height}, {size / 1e3:.0f} kB")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        baked = {look: bake(look, Path(temporary)) for look in LOOKS}
        stage, (start, squash, rebound) = baked["rubber"]
        shot = [draw(stage, frame, (360, 480)) for frame in (start, squash, rebound)]
        strip(shot, out / "duck.png")
        squashed = [draw(s, times[1], (400, 560)) for s, times in baked.values()]
        strip([low(picture) for picture in squashed], out / "looks.png")
        shown = [draw(stage, squash, (320, 560), show) for show in DISPLAYS]
        strip([low(picture) for picture in shown], out / "displays.png")


if __name__ == "__main__":
    main()
