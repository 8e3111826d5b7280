"""kill -9 at random moments of a bake: complete files at each, identical bits after --resume.

    python -m tools.acceptance.kills [--json] [--kills N] [--seed S]

A bake of 200 particles and 25 frames in value clips of one frame.  It has three phases:

    start     until the first clip is there, and with it soon the first checkpoint: 1 kill in 10
    clips     from the first clip to the last but one, each waited for in its turn: 6 in 10
    results   from the last clip to the end, while the results get their final names: 3 in 10

Within a phase, and after the clip that is waited for, the moment is random. After each kill all
files with a final name are opened, a root layer is checked, and the result of --resume is compared
with that of an uninterrupted bake. Exit status 1 if a check fails.
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

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "helpers"))

from resumed import require_same, require_whole, start  # noqa: E402

from gf_usd.layers.check.run import check_file  # noqa: E402

STEM = "duck.rubber"
FRAMES = 25
BAKE = (
    "bake", ROOT / "samples" / "duck.usda", "--particles", "200", "--drop", "0.05r",
    "--frames", FRAMES, "--clip-frames", "1", "--threads", "1", "-q",
)  # fmt: skip
CLIPS = FRAMES - 1  # a clip of one frame holds the samples at both its ends
PATIENCE = 120.0  # [s] for one bake
START, MIDDLE, RESULTS = "start", "clips", "results"
PHASES = (START, *[MIDDLE] * 6, *[RESULTS] * 3)  # of ten kills


@dataclass(frozen=True, kw_only=True)
class Target:
    """When a bake is to be killed."""

    phase: str
    after: int  # the clip that is waited for first; 0: none
    moment: float  # [s] from there, or from the start


@dataclass(frozen=True, kw_only=True)
class Kill:
    """One kill and what came of it."""

    target: Target
    ended: bool  # the bake was over before
    clips: int  # that stood then
    final: tuple[str, ...]  # results that stood then under their final names
    fault: str  # "" if nothing was wrong


@dataclass(frozen=True, kw_only=True)
class Pace:
    """Duration of the phases of an uninterrupted bake [s]."""

    start: float  # until the first clip
    clip: float  # from one to the next, mean
    results: float  # from the last clip to the end


def clip(number: int) -> str:
    """Where a clip is, under the folder of the results."""
    return f"{STEM}.clips/{number:04d}.usdc"


def bake(folder: Path, *more: object) -> int:
    """The exit status of a whole run into a folder."""
    process = start(*BAKE, "-o", f"{folder}/", *more)
    _, err = process.communicate(timeout=PATIENCE)
    if process.returncode not in (0, 5):
        print(err, file=sys.stderr)
    return process.returncode


def wait_for(path: Path, process: subprocess.Popen[str]) -> float:
    """When the file was there [s]; also where the process ended first."""
    while not path.exists() and process.poll() is None:
        time.sleep(0.001)
    return time.monotonic()


def judge(folder: Path) -> str:
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
    """Resume to the end; how the result differs from an uninterrupted bake, "" if it does not."""
    checkpoint, root = folder / f"{STEM}.checkpoint.npz", folder / f"{STEM}.usda"
    over = root.exists() and not checkpoint.exists()
    if not over and (status := bake(folder, "--resume")):
        return f"--resume ended with {status}"
    try:
        require_same(whole, folder)
    except AssertionError as error:
        return f"not the same bits: {error}"
    return ""


def kill(folder: Path, whole: Path, nearly: Path, target: Target) -> Kill:
    """One bake, its end, and its rest; `nearly` holds one that lacks its last clip."""
    if target.phase == RESULTS:
        shutil.copytree(nearly, folder)
    process = start(*BAKE, "-o", f"{folder}/", "--resume")
    if target.after:
        wait_for(folder / clip(target.after), process)
    time.sleep(target.moment)
    ended = process.poll() is not None
    process.kill()
    process.communicate(timeout=PATIENCE)
    names = sorted(p.name for p in folder.glob("*")) if folder.exists() else []
    final = tuple(
        n for n in names if "partial" not in n and n.startswith(STEM) and ".clips" not in n
    )
    clips = len([p for p in folder.glob("*.clips/*.usdc") if "partial" not in p.name])
    fault = judge(folder) or resume(folder, whole) or judge(folder)
    return Kill(target=target, ended=ended, clips=clips, final=final, fault=fault)


def measure(folder: Path) -> Pace:
    """The pace of a bake from its start to its end."""
    began = time.monotonic()
    process = start(*BAKE, "-o", f"{folder}/")
    first = wait_for(folder / clip(1), process)
    last = wait_for(folder / clip(CLIPS), process)
    process.communicate(timeout=PATIENCE)
    return Pace(
        start=first - began, clip=(last - first) / (CLIPS - 1), results=time.monotonic() - last
    )


def targets(kills: int, seed: int, pace: Pace) -> list[Target]:
    """When to kill: the phases in turn, and the clips of the middle one spread evenly."""
    random = np.random.default_rng(seed)
    phases = [PHASES[number % len(PHASES)] for number in range(kills)]
    middle = iter(np.linspace(1, CLIPS - 1, phases.count(MIDDLE)).round().astype(int))
    lengths = {START: pace.start, MIDDLE: pace.clip, RESULTS: pace.results}
    after = {START: lambda: 0, MIDDLE: lambda: int(next(middle)), RESULTS: lambda: CLIPS}
    return [
        Target(phase=phase, after=after[phase](), moment=float(random.uniform(0, lengths[phase])))
        for phase in phases
    ]


def run(folder: Path, kills: int, seed: int) -> list[Kill]:
    """All kills, two at a time.  Raises SystemExit where the bake fails by itself."""
    whole, nearly = folder / "whole", folder / "nearly"
    if bake(whole) or bake(nearly, "--slice", CLIPS - 1) != 5:
        raise SystemExit("the bake fails without being killed")
    pace = measure(folder / "timed")
    print(f"  {pace}", file=sys.stderr)

    def one(numbered: tuple[int, Target]) -> Kill:
        place = folder / f"kill{numbered[0]}"
        case = kill(place, whole, nearly, numbered[1])
        print(f"  {case}", file=sys.stderr, flush=True)
        if not case.fault:
            shutil.rmtree(place)
        return case

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(one, enumerate(targets(kills, seed, pace))))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all and print what came of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=9)
    args = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="gf-usd-kill-") as folder:
        found = run(Path(folder), args.kills, args.seed)
    if args.json:
        print(json.dumps({"kills": [asdict(case) for case in found], "seed": args.seed}))
    sys.exit(1 if any(case.fault for case in found) else 0)


if __name__ == "__main__":
    main()
