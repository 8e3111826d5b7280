"""Run the experiments of the GaussianFlesh paper and write docs/reproduction.md.

    python -m tools.paper [--quick] [--seeds N] [--page] [--out FOLDER]

Every figure of the page is a result of these runs, which docs/reproduction/results.json.gz keeps;
--page only writes the page again.  --quick runs two seeds of a few frames, to see that all works.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any

from tools.paper.figures import curves, peak_picture, side_by_side
from tools.paper.page import page
from tools.paper.runs import Series, run

ROOT = Path(__file__).resolve().parents[2]
DIMENSIONLESS = ("rubber", "metal", "jelly")
ALPHAS = (0.0, 0.02, 0.04)
SHAPE = {"rubber": 0.02, "metal": 0.0, "jelly": 0.0}  # the paper's Procrustes strength
PRODUCTION_PARTICLES = 2000
QUICK_FRAMES = 75  # the first squash is at 55 or so

Job = tuple[str, str, dict[str, Any]]  # table, key, arguments of `run`


def jobs(seeds: Sequence[int], *, quick: bool) -> list[Job]:
    """Every run of every table; quick: past the first squash, rubber where one preset will do."""
    length = {"frames": QUICK_FRAMES} if quick else {}
    off = {"wls": False, "procrustes": 0.0, "clamp": "none", "stress_cap": "none"}
    own = {"preset": None, "fps": 60.0, "frames": QUICK_FRAMES, "skin": "embed"}
    own["particles"] = 300 if quick else PRODUCTION_PARTICLES
    found: list[Job] = []
    for seed in seeds:
        for look in DIMENSIONLESS:
            plain = {"material": look, "seed": seed}
            base = {**plain, "procrustes": SHAPE[look], **length}
            found.append(("table 1", look, base))
            if quick and look != "rubber":
                continue
            found.append(("neo-Hookean", look, {**base, "law": "neoHookean"}))
            found.append(("no options", look, {**base, **off}))
            found.append(("production", look, {**plain, **own}))
        rubber = {"material": "rubber", "seed": seed}
        shaped = {**rubber, "procrustes": SHAPE["rubber"]}
        for alpha in ALPHAS:
            options = {**rubber, "procrustes": alpha, "frames": 800, **length}
            found.append(("table 2", f"{alpha:.2f}", options))
        for solver, given in (("tl", shaped), ("ul", rubber)):
            options = {**given, "solver": solver, "frames": 3000, "drift_every": 25, **length}
            found.append(("table 3", solver, options))
        deformed = {**shaped, "asset": "deformed_sphere.usda", **length}
        found.append(("deformed", "rubber", deformed))
    return found


def work(job: Job) -> tuple[str, str, Series]:
    """One run, in a process of its own."""
    table, key, arguments = job
    return table, key, run(**arguments)


def work_quickly(job: Job) -> tuple[str, str, Series]:
    """As `work`, on a coarse isosurface."""
    table, key, arguments = job
    return table, key, run(**arguments, resolution=24)


def run_all(
    found: Sequence[Job], workers: int, quick: bool
) -> dict[str, dict[str, list[dict[str, Any]]]]:
    """Results by table and key, seeds in order."""
    out: dict[str, dict[str, list[dict[str, Any]]]] = {}
    with ProcessPoolExecutor(workers) as pool:
        for number, (table, key, series) in enumerate(
            pool.map(work_quickly if quick else work, found), 1
        ):
            out.setdefault(table, {}).setdefault(key, []).append(asdict(series))
            note = f": {series.failed}" if series.failed else ""
            print(f"{number}/{len(found)} {table} {key} seed {series.seed}{note}", file=sys.stderr)
    return out


def pictures(folder: Path, *, quick: bool) -> None:
    """Figures 1, 2, 3 and 5: at the hardest squash."""
    samples = ROOT / "samples"
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        looks = DIMENSIONLESS[:1] if quick else DIMENSIONLESS
        sphere = samples / "sphere.usda"
        side_by_side([peak_picture(sphere, k, here) for k in looks], folder / "figure1.jpg")
        if quick:
            return
        side_by_side(
            [peak_picture(samples / "deformed_sphere.usda", "rubber", here)], folder / "figure2.jpg"
        )
        side_by_side(
            [peak_picture(sphere, k, here, show="ellipsoids") for k in looks],
            folder / "figure3.jpg",
        )
        side_by_side([peak_picture(samples / "duck.usda", "rubber", here)], folder / "figure5.jpg")


def short(value: Any, name: str = "") -> Any:
    """Results with as many digits as are read: five, and all of J, whose standstill is judged."""
    if isinstance(value, dict):
        return {key: short(item, key) for key, item in value.items()}
    if isinstance(value, list):
        return [short(item, name) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) and name != "min_J" else value


def store(path: Path, results: dict[str, Any]) -> None:
    """Write results, the same bytes for the same results."""
    path.write_bytes(gzip.compress(json.dumps(results).encode(), mtime=0))


def commit() -> str:
    """The commit that the code is of, with a + where files were changed."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty=+", "--abbrev=10"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, keep the results, write the page and its figures."""
    parser = argparse.ArgumentParser(description="Run the experiments of the paper.")
    parser.add_argument("--quick", action="store_true", help="two seeds, few frames")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--page", action="store_true", help="only write the page again")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    args = parser.parse_args(arguments)
    folder = args.out / "reproduction"
    results = folder / "results.json.gz"
    if not args.page:
        seeds = range(2 if args.quick else args.seeds)
        tables = run_all(jobs(seeds, quick=args.quick), args.workers, args.quick)
        folder.mkdir(parents=True, exist_ok=True)
        command = "python -m tools.paper" + (" --quick" if args.quick else "")
        command += f" --seeds {args.seeds}" if args.seeds != 6 and not args.quick else ""
        about = {"command": command, "seeds": list(seeds), "commit": commit(),
                 "date": date.today().isoformat()}  # fmt: skip
        store(results, {"about": about, "tables": short(tables)})
        pictures(folder, quick=args.quick)
    kept = json.loads(gzip.decompress(results.read_bytes()))
    long = {key: Series(**runs[0]) for key, runs in kept["tables"]["table 3"].items()}
    names = {"tl": "Total Lagrangian", "ul": "Updated Lagrangian"}
    for file, title, unit, column, level in (
        ("figure4a.svg", "Drift of the mesh, mean, first seed", "m", "drift_mean", 0.079),
        ("figure4b.svg", "Least J, first seed", "J", "min_J", 1.0),
    ):
        lines = {names[key]: getattr(series, column) for key, series in long.items()}
        (folder / file).write_text(curves(title, "frame", unit, lines, level))
    (args.out / "reproduction.md").write_text(page(kept, folder))
    print(f"{args.out / 'reproduction.md'}", file=sys.stderr)


if __name__ == "__main__":
    main()
