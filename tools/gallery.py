"""Make the pictures of docs/gallery.md by the commands next to them.

    python tools/gallery.py [--only NAME ...] [--keep FOLDER]

Every block of commands in the page makes the picture before it: the block that makes
images/gallery/NAME.png writes NAME.png.  All of them run in one folder, in the order of the page.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from tools.documents import ROOT, blocks

PAGE = ROOT / "docs" / "gallery.md"
PICTURE = re.compile(r"^!\[[^\]]*\]\((images/\S+)\)$", re.M)
LARGEST = 400_000  # bytes of a picture in the repository


def pictures() -> dict[str, str]:
    """The commands of every picture, by its path in docs/."""
    text = PAGE.read_text("utf-8")
    lines = {text[: found.start()].count("\n") + 1: found[1] for found in PICTURE.finditer(text)}
    made: dict[str, str] = {}
    for block in blocks(PAGE):
        before = [line for line in lines if line < block.line]
        if block.language == "bash" and before:
            made[lines[max(before)]] = block.text
    if set(made) != set(lines.values()):
        raise ValueError(
            f"{PAGE}: pictures without commands: {sorted({*lines.values()} - {*made})}"
        )
    return made


def make(name: str, commands: str, folder: Path) -> None:
    """Run the commands in `folder`, and put the picture that they leave into docs/.

    Raises CalledProcessError where one fails, and ValueError where the picture is too large.
    """
    program = folder / "bin" / "gf-usd"
    if not program.exists():
        program.parent.mkdir()
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m gf_usd "$@"\n')
        program.chmod(0o755)
        (folder / "samples").symlink_to(ROOT / "samples")
    path = os.pathsep.join((str(program.parent), os.environ["PATH"]))
    subprocess.run(
        ["bash", "-eu", "-c", commands], cwd=folder, check=True,
        env={**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    target = ROOT / "docs" / name
    target.parent.mkdir(exist_ok=True)
    drawn = folder / target.name
    if target.suffix == ".png":
        with Image.open(drawn) as picture:
            picture.convert("RGB").save(target, optimize=True)
    else:
        shutil.copyfile(drawn, target)
    size = target.stat().st_size
    if size > LARGEST:
        raise ValueError(f"{target} has {size} bytes, more than {LARGEST}: draw it smaller")
    print(f"{target}: {size / 1e3:.0f} kB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="*", metavar="NAME", help="without folder and suffix")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="to run in, and to keep")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder: Path = args.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name, commands in pictures().items():
            if args.only is None or Path(name).stem in args.only:
                make(name, commands, folder.resolve())


if __name__ == "__main__":
    main()
