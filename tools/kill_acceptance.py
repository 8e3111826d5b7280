"""kill -9 at random moments of a bake: whole files at each, and the same bits after --resume.

    python tools/kill_acceptance.py [--json] [--kills N] [--seed S]

A bake of 200 particles and 25 frames in value clips of one frame.  Every second kill meets a bake
anywhere between its start and its end.  The others begin where all clips but the last are full,
and are killed after the last one is there, while the results get their final names.  After each,
what stands under a final name is opened, a root layer is checked, and --resume is compared with a
bake that nobody interrupted.  Exit status 1 if a kill left what it should not.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "tests" / "cli"))

from resumed import require_same, require_whole, start  # noqa: E402

from gf_usd.usd.check import check_file  # noqa: E402

STEM = "duck.rubber"
FRAMES = 25
WORDS = ("bake", ROOT / "samples" / "duck.usda", "--particles", "200", "--drop", "0.05r",
         "--frames", FRAMES, "--clip-frames", "1", "--threads", "1", "-q")  # fmt: skip
CLIPS = FRAMES - 1  # a clip of one frame holds the samples at both its ends
LAST = f"{STEM}.clips/{CLIPS:04d}.usdc"
PATIENCE = 120.0  # [s] for one bake


@dataclass(frozen=True, kw_only=True)
class Kill:
    """One kill and what came of it."""

    publishing: bool
    moment: float  # [s] after the start, or after the last clip was there
    ended: bool  # the bake was over before
    clips: int  # that stood then
    final: tuple[str, ...]  # results that stood then under their final names
    fault: str  # "" if nothing was wrong


def bake(folder: Path, *more: object) -> int:
    """The exit status of a whole run into a folder."""
    process = start(*WORDS, "-o", f"{folder}/", *more)
    _, err = process.communicate(timeout=PATIENCE)
    if process.returncode not in (0, 5):
        print(err, file=sys.stderr)
    return process.returncode


def wait_for(path: Path, process: subprocess.Popen[str]) -> float:
    """When the file was there [s]; also where the process ended first."""
    while not path.exists() and process.poll() is None:
        time.sleep(0.001)
    return time.monotonic()


def look(folder: Path) -> str:
    """What is wrong with the files under final names; "" if nothing is."""
    try:
        require_whole(folder)
    except (AssertionError, ValueError, OSError, RuntimeError) as error:
        return f"not whole: {error}"
    root = folder / f"{STEM}.usda"
    if root.exists() and not (found := check_file(root)).ok:
        return f"check: {found.findings[0]}"
    return ""


def resume(folder: Path, whole: Path) -> str:
    """Go on to the end; what differs from the bake in one go, "" if nothing does."""
    checkpoint, root = folder / f"{STEM}.checkpoint.npz", folder / f"{STEM}.usda"
    over = root.exists() and not checkpoint.exists()
    if not over and (status := bake(folder, "--resume")):
        return f"--resume ended with {status}"
    try:
        require_same(whole, folder)
    except AssertionError as error:
        return f"not the same bits: {error}"
    return ""


def kill(folder: Path, whole: Path, nearly: Path | None, moment: float) -> Kill:
    """One bake, its end, and its rest."""
    if nearly is not None:
        shutil.copytree(nearly, folder)
    process = start(*WORDS, "-o", f"{folder}/", "--resume")
    if nearly is not None:
        wait_for(folder / LAST, process)
    time.sleep(moment)
    ended = process.poll() is not None
    process.kill()
    process.communicate(timeout=PATIENCE)
    names = sorted(p.name for p in folder.glob("*")) if folder.exists() else []
    final = tuple(
        n for n in names if "partial" not in n and n.startswith(STEM) and ".clips" not in n
    )
    clips = len([p for p in folder.glob("*.clips/*.usdc") if "partial" not in p.name])
    fault = look(folder) or resume(folder, whole) or look(folder)
    return Kill(
        publishing=nearly is not None, moment=moment, ended=ended, clips=clips, final=final,
        fault=fault,
    )  # fmt: skip


def measure(folder: Path, nearly: Path) -> float:
    """Seconds from the last clip to the end of a bake that goes on."""
    shutil.copytree(nearly, folder)
    process = start(*WORDS, "-o", f"{folder}/", "--resume")
    there = wait_for(folder / LAST, process)
    process.communicate(timeout=PATIENCE)
    return time.monotonic() - there


def run(folder: Path, kills: int, seed: int) -> list[Kill]:
    """All kills, two at a time.  Raises SystemExit where the bake fails by itself."""
    whole, nearly = folder / "whole", folder / "nearly"
    if bake(whole) or bake(nearly, "--slice", CLIPS - 1) != 5:
        raise SystemExit("the bake fails without being killed")
    began = time.monotonic()
    bake(folder / "timed")
    length = time.monotonic() - began
    publishing = measure(folder / "ending", nearly)
    random = np.random.default_rng(seed)
    lengths = np.where(np.arange(kills) % 2 == 1, publishing, length)
    moments = random.uniform(0.0, lengths)

    def one(number: int) -> Kill:
        place = folder / f"kill{number}"
        case = kill(place, whole, nearly if number % 2 == 1 else None, float(moments[number]))
        print(f"  {case}", file=sys.stderr, flush=True)
        if not case.fault:
            shutil.rmtree(place)
        return case

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(one, range(kills)))


def main(words: Sequence[str] | None = None) -> None:
    """Run all and print what came of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=9)
    asked = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="gf-usd-kill-") as folder:
        found = run(Path(folder), asked.kills, asked.seed)
    if asked.json:
        print(json.dumps({"kills": [asdict(case) for case in found], "seed": asked.seed}))
    sys.exit(1 if any(case.fault for case in found) else 0)


if __name__ == "__main__":
    main()
