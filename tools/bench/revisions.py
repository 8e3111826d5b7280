"""The cost of elastic bodies, or of a whole bake, at two revisions of the source, in turns.

    python -m tools.bench.revisions OLD [NEW] [--particles N] [--turns N]
    python -m tools.bench.revisions OLD [NEW] [--turns N] --bake ASSET [OPTION ...]

With --bake, which comes last: CPU seconds of all processes of `gf-usd bake ASSET OPTION ...`; both
revisions read the same asset and have baked it once before.  Without it: CPU time of a substep on
one thread, with compiled kernels, of a ball whose halves rotate in opposite directions, without
contact, in a process of each revision that waits while the other measures.

Other load of the machine changes more between turns than within one: the result is the median of
the ratios and, for a busy machine, the ratio of the fastest tenths, which other programs affect
least.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median, quantiles

ROOT = Path(__file__).resolve().parent.parent.parent
LAWS = ("corotated", "neoHookean")
Turn = tuple[float, float]  # old and new
CHILD = """
import sys, time
from dataclasses import replace
import numpy as np
from gf_usd import Settings
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from tools.bench.solver import ball, twist

law, n = sys.argv[1], int(sys.argv[2])
settings = Settings(
    frames=10**6, fps=60.0, time_codes_per_second=60.0, start=1.0, gravity=(0.0, 0.0, 0.0),
    up=(0.0, 1.0, 0.0), floor=None, filter_rate=10.0 * np.sqrt(9.81), threads=1, substeps=100,
)
rubber = replace(DIMENSIONLESS["rubber"].material(1.0), law=law)
solver = TotalLagrangian(ball(n), [rubber], settings, velocity=twist)
frames = solver.frames()
next(frames)
for _ in sys.stdin:
    began = time.process_time()
    substeps = next(frames).health.substeps
    print(1e9 * (time.process_time() - began) / substeps / len(solver.particles), flush=True)
"""


@contextlib.contextmanager
def checked_out(revision: str, folder: Path) -> Iterator[Path]:
    """A working tree of a revision, for a while."""
    path = folder / revision.replace("/", "-")
    git = ["git", "-C", str(ROOT), "worktree"]
    subprocess.run([*git, "add", "--detach", str(path), revision], check=True, capture_output=True)
    try:
        yield path
    finally:
        subprocess.run([*git, "remove", "--force", str(path)], check=True)


def environment(tree: Path) -> dict[str, str]:
    # its modules are compiled once, as those of an installed version are
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "PYTHONPATH": str(tree)}


def substeps(trees: Sequence[Path], law: str, n: int, turns: int) -> list[Turn]:
    """ns of CPU a particle-substep, old and new, by turn."""
    children = [
        subprocess.Popen(
            [sys.executable, "-c", CHILD, law, str(n)], cwd=tree, env=environment(tree), text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        for tree in trees
    ]  # fmt: skip
    seen = []
    for _ in range(turns + 1):
        turn = []
        for child in children:
            assert child.stdin
            assert child.stdout
            child.stdin.write("\n")
            child.stdin.flush()
            line = child.stdout.readline()
            while line.startswith("[Taichi]"):
                line = child.stdout.readline()
            turn.append(float(line))
        seen.append((turn[0], turn[1]))
    for child in children:
        child.communicate()
    return seen[1:]  # the first is not warm


def bakes(trees: Sequence[Path], asset: str, options: Sequence[str], turns: int) -> list[Turn]:
    """CPU seconds of a bake, old and new, by turn.

    Raises SystemExit with the messages of a bake that fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        seen = [
            tuple(_bake_seconds(tree, [asset, *options], folder) for tree in trees)
            for _ in range(turns + 1)
        ]
    return [(old, new) for old, new in seen[1:]]  # the first compiles kernels


def _bake_seconds(tree: Path, arguments: Sequence[str], folder: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    # -P: not the modules of the working directory
    done = subprocess.run(
        [sys.executable, "-P", "-m", "gf_usd", "bake", *arguments, "-o", f"{folder}/{tree.name}/"],
        check=False, env=environment(tree), capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"the bake with {tree.name} failed:\n{done.stderr}")
    shutil.rmtree(f"{folder}/{tree.name}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def bake_table(old: str, new: str, seen: Sequence[Turn]) -> list[str]:
    """A line for each turn [s], and the medians of the times and of the ratios."""
    lines = [f"| turn | {old} | {new} | new / old |", "|---|---:|---:|---:|"]
    lines += [f"| {k} | {a:.1f} s | {b:.1f} s | {b / a:.3f} |" for k, (a, b) in enumerate(seen, 1)]
    before, after = (median(turn[k] for turn in seen) for k in (0, 1))
    ratio = median(b / a for a, b in seen)
    return [*lines, f"| median | {before:.1f} s | {after:.1f} s | {ratio:.3f} |"]


def row(what: str, unit: str, seen: list[Turn]) -> str:
    """A line of the table: medians, their ratio with its quartiles, that of the fastest tenths."""
    old, new = (median(turn[k] for turn in seen) for k in (0, 1))
    low, middle, high = quantiles([new / old for old, new in seen], n=4)
    fast = [quantiles([turn[k] for turn in seen], n=10)[0] for k in (0, 1)]
    cells = [f"{old:.1f} {unit}", f"{new:.1f} {unit}", f"{middle:.3f}", f"{low:.3f} to {high:.3f}"]
    return f"| {what} | {' | '.join(cells)} | {fast[1] / fast[0]:.3f} |"


def main() -> int:
    parser = argparse.ArgumentParser(description="What bodies or a bake cost at two revisions.")
    parser.add_argument("old")
    parser.add_argument("new", nargs="?", default="HEAD")
    parser.add_argument("--particles", type=int, default=4000)
    parser.add_argument("--turns", type=int, help="default: 101, 3 of a bake")
    parser.add_argument("--bake", nargs=argparse.REMAINDER, metavar="ASSET OPTION")
    args = parser.parse_args()
    if args.bake == []:
        parser.error("--bake needs an asset")
    with tempfile.TemporaryDirectory() as temporary, contextlib.ExitStack() as stack:
        folder = Path(temporary)
        trees = [stack.enter_context(checked_out(r, folder)) for r in (args.old, args.new)]
        if args.bake:
            asset, *more = args.bake
            seen = bakes(
                trees, str(Path(asset).resolve()), more, 3 if args.turns is None else args.turns
            )
            print("\n".join(bake_table(args.old, args.new, seen)))
            return 0
        print(f"| | {args.old} | {args.new} | new / old | half of the turns | fastest tenths |")
        print("|---|---:|---:|---:|---:|---:|")
        for law in LAWS:
            seen = substeps(trees, law, args.particles, 101 if args.turns is None else args.turns)
            print(row(f"{law}, a particle-substep", "ns", seen), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
