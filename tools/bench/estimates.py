"""How accurate the estimated time of a bake is: the table of docs/performance.md, Estimates.

    python -m tools.bench.estimates [--only TEXT]... [--json FILE]

Pairs of an asset and a preset are baked with about a thousand particles on one thread, each
in a separate process. The estimate is the one that the bake reports before it begins; for bakes
that end at rest, the usual time. It is compared with the CPU seconds of all its processes, which
other programs on the machine affect less than the elapsed time. Kernels are compiled before: one
pair of each law is baked first without being measured.  Exit status 1 if fewer than 90 % are within
a factor of two.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.bench import estimate_assets
from tools.bench.commands import children_cpu

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "samples"
FACTOR, SHARE = 2.0, 0.9  # that are required
PARTICLES = 1000
UNSOUND = 4  # exit status of a bake that is complete, but has an error of contact


@dataclass(frozen=True, kw_only=True)
class Pair:
    """An asset and a preset."""

    asset: str  # of ASSETS
    preset: str
    options: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return " ".join((self.asset, self.preset, *self.options))


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a bake was estimated to take, and what it took."""

    pair: Pair
    estimate: float  # [s]
    took: float  # [s] of the CPU
    passed: float  # [s]
    substeps: int
    foretold: float  # substeps

    @property
    def ratio(self) -> float:
        return self.took / self.estimate


def _mesh(path: Path, make: str, **size: Any) -> None:
    """A closed surface of trimesh, in meters."""
    import trimesh

    made = getattr(trimesh.creation, make)(**size)
    made.export(path)


def _chair(path: Path) -> None:
    """Six boxes that overlap: a seat, a back, and legs a fifteenth as wide as the seat."""
    import trimesh

    wide, leg = 0.6, 0.04
    ends = (0.0, wide - leg)
    boxes = [
        ((0.0, 0.4, 0.0), (wide, 0.45, wide)),
        ((0.0, 0.44, 0.0), (wide, 0.9, leg)),
        *(((x, 0.0, z), (x + leg, 0.41, z + leg)) for x in ends for z in ends),
    ]
    trimesh.util.concatenate([trimesh.creation.box(bounds=one) for one in boxes]).export(path)


# Files that are made for this, in meters: how each is written into a folder.
MADE: Mapping[str, Callable[[Path], None]] = {
    "chair.obj": _chair,
    "ball.obj": lambda path: _mesh(path, "icosphere", subdivisions=3, radius=0.3),
    "cube.stl": lambda path: _mesh(path, "box", extents=(0.5, 0.5, 0.5)),
    "ring.ply": lambda path: _mesh(path, "torus", major_radius=0.4, minor_radius=0.15),
    "rod.obj": lambda path: _mesh(path, "cylinder", radius=0.1, height=1.0),
    "lamp.usda": estimate_assets.lamp,
    "chain.usda": estimate_assets.chain,
    "gears.usda": estimate_assets.gears,
    "pot.usda": estimate_assets.pot,
    "hit.usda": estimate_assets.hit,
    "slab.glb": lambda path: _mesh(path, "box", extents=(1.0, 0.15, 0.8)),
}
# Those that touch themselves or each other, with kernels of their own.
MEETING = {"chair.obj", "chain.usda", "gears.usda", "pot.usda", "hit.usda"}
FLAT = ("--drop", "1r")
SHORT = ("--frames", "7")
PAIRS = (
    Pair(asset="duck.usda", preset="rubber"),
    Pair(asset="duck.usda", preset="jelly"),
    Pair(asset="duck.usda", preset="metal"),
    Pair(asset="duck.usda", preset="foam"),
    Pair(asset="duck.usda", preset="gelatin"),
    Pair(asset="duck.usda", preset="mild-steel", options=("--frames", "5")),
    Pair(asset="sphere.usda", preset="rubber"),
    Pair(asset="sphere.usda", preset="clay"),
    Pair(asset="sphere.usda", preset="jelly", options=("--frames", "200")),
    Pair(asset="sphere.usda", preset="natural-rubber"),
    Pair(asset="sphere.usda", preset="wet-clay"),
    Pair(asset="creature.usda", preset="rubber"),
    Pair(asset="creature.usda", preset="soft-silicone"),
    Pair(asset="creature.usda", preset="dented"),
    Pair(asset="ten_ducks.usda", preset="rubber"),
    Pair(asset="ten_ducks.usda", preset="jelly"),
    Pair(asset="ball.obj", preset="metal"),
    Pair(asset="ball.obj", preset="dough"),
    Pair(asset="ball.obj", preset="styrofoam"),
    Pair(asset="ball.obj", preset="hard-rubber", options=FLAT),
    Pair(asset="cube.stl", preset="rubber"),
    Pair(asset="cube.stl", preset="modelling-clay"),
    Pair(asset="cube.stl", preset="lead", options=(*FLAT, "--frames", "10")),
    Pair(asset="ring.ply", preset="rubber"),
    Pair(asset="ring.ply", preset="neoprene"),
    Pair(asset="ring.ply", preset="polyurethane-foam", options=FLAT),
    Pair(asset="rod.obj", preset="silicone"),
    Pair(asset="rod.obj", preset="wax", options=(*FLAT, "--frames", "20")),
    Pair(asset="slab.glb", preset="jelly"),
    Pair(asset="slab.glb", preset="foam"),
    Pair(asset="chair.obj", preset="rubber", options=("--frames", "48")),
    Pair(asset="chair.obj", preset="jelly", options=("--frames", "48")),
    Pair(
        asset="lamp.usda",
        preset="rubber",
        options=("--pin", "/Asset/Lamp/Top", "--floor", "none", "--frames", "60"),
    ),
    Pair(asset="chain.usda", preset="rubber", options=("--pin", "/Asset/L0", "--frames", "36")),
    Pair(
        asset="chain.usda", preset="hard-rubber", options=("--pin", "/Asset/L0", "--frames", "10")
    ),
    Pair(asset="gears.usda", preset="rubber", options=(*FLAT, "--frames", "24")),
    Pair(asset="pot.usda", preset="clay", options=(*FLAT, "--frames", "24")),
    Pair(asset="hit.usda", preset="rubber", options=("--floor", "0", "--frames", "24")),
)


def make(folder: Path, asset: str) -> Path:
    """The file of an asset, written if it is not one of the samples."""
    if asset not in MADE:
        return SAMPLES / asset
    path = folder / asset
    if not path.exists():
        MADE[asset](path)
    return path


def bake(pair: Pair, folder: Path) -> Outcome:
    """One bake, measured."""
    events, out = folder / "events.ndjson", folder / "out"
    arguments = [
        *("bake", str(make(folder, pair.asset)), "--material", pair.preset, "--quiet"),
        *("--particles", str(PARTICLES), "--threads", "1", "--max-hours", "1000", "--overwrite"),
        *("--events", str(events), "-o", f"{out}/", *pair.options),
    ]
    out.mkdir(exist_ok=True)
    before, began = children_cpu(), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", *arguments], capture_output=True, text=True, check=False
    )
    took, passed = children_cpu() - before, time.perf_counter() - began
    if done.returncode == UNSOUND:  # complete, so that its time counts as any other's
        print(f"{pair.name}: {done.stderr.strip()}", file=sys.stderr, flush=True)
    elif done.returncode:
        raise SystemExit(f"{pair.name}: {done.stderr}")
    by_event = {row["event"]: row for row in map(json.loads, events.read_text().splitlines())}
    plan, finished = by_event["plan"], by_event["finished"]
    (each,) = plan["per_material"]
    return Outcome(
        pair=pair,
        estimate=float(plan["usual_seconds"]),
        took=took,
        passed=passed,
        substeps=int(finished["bakes"][0]["health"]["substeps"]),
        foretold=float(each.get("substeps", each["substeps_per_frame"] * (plan["frames"] - 1))),
    )


def warm(pairs: Sequence[Pair], folder: Path) -> None:
    """Have the kernels of every law compiled."""
    from gf_usd.core.materials.presets import find_preset

    seen = set()
    for pair in pairs:
        law = find_preset(pair.preset).material(0.1).law
        # Self-contact and several bodies have kernels of their own.
        kind = law, pair.asset in {*MADE, "sphere.usda"} - MEETING
        if kind not in seen:
            seen.add(kind)
            bake(Pair(asset=pair.asset, preset=pair.preset, options=("--frames", "2")), folder)


def table(outcomes: Sequence[Outcome]) -> str:
    """Rows of Markdown."""
    lines = [
        "| asset | preset | estimate [s] | taken [s] | ratio | substeps, foretold | done |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for one in outcomes:
        preset = " ".join((one.pair.preset, *one.pair.options))
        lines.append(
            f"| {one.pair.asset} | {preset} | {one.estimate:.1f} | {one.took:.1f}"
            f" | {one.ratio:.2f} | {one.foretold:.0f} | {one.substeps} |"
        )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare estimates with the time that bakes take.")
    parser.add_argument("--only", action="append", default=[], help="pairs with this in the name")
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    parser.add_argument("--warm", action="store_true", help="kernels are compiled already")
    given = parser.parse_args()
    pairs = [p for p in PAIRS if not given.only or any(text in p.name for text in given.only)]
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if not given.warm:
            warm(pairs, folder)
        for pair in pairs:
            one = bake(pair, folder)
            outcomes.append(one)
            print(
                f"{pair.name}: {one.estimate:.1f} s estimated, {one.took:.1f} s taken"
                f" ({one.ratio:.2f}), {one.substeps} substeps of {one.foretold:.0f},"
                f" {one.passed:.1f} s passed",
                file=sys.stderr, flush=True,
            )  # fmt: skip
            if given.json:
                given.json.write_text(
                    json.dumps([vars(o) | {"pair": o.pair.name} for o in outcomes])
                )
    print(table(outcomes))
    within = sum(1.0 / FACTOR <= one.ratio <= FACTOR for one in outcomes)
    print(f"\n{within} of {len(outcomes)} within a factor of {FACTOR:g}")
    return int(within < SHARE * len(outcomes))


if __name__ == "__main__":
    sys.exit(main())
