"""The cost of self-contact without touching parts, and the overlap of ducks of jelly in a pile.

    python -m tools.bench.self_contact [--pairs N]
    python -m tools.bench.self_contact --pile

The first bakes the duck with and without self-contact, the two in turn: CPU seconds of whole
processes, and the median of the ratios of the pairs, which other load of the machine hardly
affects. The second bakes the first frames of ten ducks that are all of jelly.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tools.bench.processes import ALONE, ROOT

DUCK, DUCKS = ROOT / "samples" / "duck.usda", ROOT / "samples" / "ten_ducks.usda"
PILE = 42  # frames, up to the deepest overlap


def bake(asset: Path, *options: str) -> tuple[dict[str, Any], float]:
    """The report of a bake, and its CPU seconds, those of its children included.

    Raises SystemExit with its message where it fails.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        arguments = ("bake", str(asset), *options, "-o", f"{folder}/", "--json", "--quiet")
        done = subprocess.run(
            [sys.executable, "-m", "gf_usd", *arguments],
            capture_output=True, text=True, check=False,
            cwd=ROOT, env={**os.environ, **ALONE},
        )  # fmt: skip
    if done.returncode:
        raise SystemExit(done.stderr.strip() or f"exit status {done.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return json.loads(done.stdout), used


def ratio(pairs: int) -> None:
    """Print a row a pair, and the median."""
    bake(DUCK, "--material", "rubber", "--frames", "2")  # compiles the kernels
    seen = []
    print("| with [CPU s] | without | ratio |\n|---:|---:|---:|")
    for number in range(pairs):
        made = {}
        for word in ((), ("--no-self-contact",))[:: -1 if number % 2 else 1]:
            made[bool(word)] = bake(DUCK, "--material", "rubber", *word)[1]
        seen.append(made[False] / made[True])
        print(f"| {made[False]:.1f} | {made[True]:.1f} | {seen[-1]:.2f} |", flush=True)
    print(f"\nmedian of the ratios: {statistics.median(seen):.2f}")


def pile() -> None:
    """Print the deepest overlap of the pile."""
    report, seconds = bake(DUCKS, "--material", "jelly", "--frames", str(PILE))
    health = report["bakes"][0]["health"]
    for name, value in (
        ("particles", report["particles"]),
        ("frames", health["frames"]),
        ("CPU seconds", round(seconds)),
        ("deepest overlap [spacings]", round(health["deepest_overlap_spacings"], 3)),
        ("samples released", health["released_max"]),
        ("share of the energy that new planes gave", f"{health['planes_gain_share']:.2g}"),
        ("smallest J", round(health["min_J"], 3)),
    ):
        print(f"{name}: {value}")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--pile", action="store_true", help="the pile, instead of the ratio")
    args = parser.parse_args()
    if args.pile:
        pile()
    else:
        ratio(args.pairs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
