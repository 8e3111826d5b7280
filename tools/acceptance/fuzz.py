"""Mutate small files by seed and read each in a child process: `python -m tools.acceptance.fuzz`.

With --options no file is mutated: valid and invalid options of a bake are combined and planned.
With --bake two frames are baked with each value of each option, each in a separate process. Exit
status 1 if a reader or a bake crashed, hung, used too much memory or raised an error of another
class than those of gf-usd; --keep keeps such files.
"""

from __future__ import annotations

import argparse
import contextlib
import pickle
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "helpers"))
from hostile_files import broken, sound
from hostile_options import OPTIONS, asset, drawn, planned
from isolated_tasks import stopped

from gf_usd.system import usd_schema as schema  # noqa: F401  (registers itself before any stage opens)
from gf_usd.system.sandbox import Limits

PATIENCE = 60  # [s] for a plan
TOGETHER = 25  # cases of one child
LONGEST = 300  # [s] of a bake
ENDS = ("baked", "refused in words", "refused as too long")
BAKE = """
import pickle, sys
import gf_usd
path, options = pickle.load(sys.stdin.buffer)
small = {} if {"particles", "spacing"} & set(options) else {"particles": 100}
try:
    gf_usd.bake(path, **{"frames": 2, "max_hours": 0.05, **small, **options})
    print("baked")
except gf_usd.GfUsdError as error:
    assert error.message and error.hint, repr(error)
    print("refused as too long" if "max_hours" in error.hint else "refused in words")
"""
EACH = Limits(time=10.0, memory=8e9, output=1e8)


def main() -> int:
    """Run the cases and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=240.0, help="stop after this time [s]")
    parser.add_argument("--options", action="store_true", help="combine options instead")
    parser.add_argument("--bake", action="store_true", help="bake with each value of each option")
    parser.add_argument("--keep", type=Path, help="folder for the files that were findings")
    args = parser.parse_args()
    until = time.monotonic() + args.seconds
    if args.options:
        return run_options(args.seed, args.count, until)
    if args.bake:
        return run_bakes(args.count, until)
    ends: Counter[str] = Counter()
    findings: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        files = sound(Path(scratch) / "sound")
        contents = [(file.suffix, file.read_bytes()) for file in files]
        for first in range(0, args.count, TOGETHER):
            if time.monotonic() > until:
                break
            cases = []
            for number in range(first, min(first + TOGETHER, args.count)):
                dice = random.Random(f"{args.seed}:{number}")
                suffix, content = dice.choice(contents)
                cases.append(Path(scratch) / f"case{number}{suffix}")
                cases[-1].write_bytes(broken(content, suffix, dice))
            found = stopped(cases, EACH)
            for case in cases:
                end = found.get(case)
                ends["read or refused in words" if end is None else "finding"] += 1
                if end is not None:
                    findings[f"{case.suffix}: {_general(end, case)}"] += 1
                    if args.keep is not None:
                        args.keep.mkdir(parents=True, exist_ok=True)
                        (args.keep / case.name).write_bytes(case.read_bytes())
                case.unlink()
    print(f"seed {args.seed}: {sum(ends.values())} cases; {dict(ends)}")
    for message, times in findings.most_common():
        print(f"{times:6d}  {message}")
    return 1 if findings else 0


def run_options(seed: int, count: int, until: float) -> int:
    """Plan combinations of options; the first error that is not ours ends it, with its options."""
    ends: Counter[str] = Counter()
    options = {}

    def hang(number: int, frame: object) -> None:
        raise TimeoutError(f"no plan in {PATIENCE} s")

    signal.signal(signal.SIGALRM, hang)
    with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):
        path = asset(Path(scratch))
        for number in range(count):
            if time.monotonic() > until:
                break
            options = drawn(random.Random(f"{seed}:options:{number}"))
            signal.alarm(PATIENCE)
            try:
                ends["planned" if planned(path, options) else "refused in words"] += 1
            finally:
                signal.alarm(0)
                if sys.exc_info()[0] is not None:
                    print(f"seed {seed}, case {number} of {dict(ends)}: {options}")
        left = [found.name for found in Path(scratch).iterdir() if found != path]
    print(f"seed {seed}: {sum(ends.values())} combinations; {dict(ends)}; left behind: {left}")
    return 1 if left else 0


def run_bakes(count: int, until: float) -> int:
    """Bake with each value of each option, up to a count and a time."""
    ends: Counter[str] = Counter()
    cases = [{name: value} for name, tried in OPTIONS.items() for value in tried]
    for options in cases[:count]:
        if time.monotonic() > until:
            break
        with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):
            path = asset(Path(scratch))
            end = baked(path, options)
        if end not in ENDS:
            print(f"{options}: {end}")
        ends[end if end in ENDS else "finding"] += 1
    print(f"{sum(ends.values())} of {len(cases)} values; {dict(ends)}")
    return 1 if ends["finding"] else 0


def baked(path: Path, options: dict[str, Any]) -> str:
    """One of ENDS, or the end of what the process printed."""
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", BAKE]
    task = pickle.dumps((str(path), options))
    try:
        done = subprocess.run(
            command, input=task, capture_output=True, timeout=LONGEST, check=False
        )
    except subprocess.TimeoutExpired:
        return f"it took more than {LONGEST} s"
    last = done.stdout.decode().strip().rpartition("\n")[2]
    if done.returncode == 0 and last in ENDS:
        return last
    return f"exit status {done.returncode}: {done.stderr.decode()[-400:]}"


def _general(message: str, case: Path) -> str:
    """What a child met, without what differs from case to case."""
    return re.sub(r"\d{3,}", "N", message.replace(str(case), "").strip(": "))


if __name__ == "__main__":
    sys.exit(main())
