"""Bake every sample with every preset, with few particles.

    python -m tools.acceptance.presets [--only TEXT]... [--particles N]

Every combination is baked in a separate process, from slightly above the floor until it has landed,
and must end with exit status 0. (The ten ducks remain in flight: their fall into the bowl takes too
long for a row, which therefore has the warning `untouched`.) A preset may be refused with a message
if it is too soft for a body of that size, or if it flows without limit and the stage has obstacles;
anything else is a failure.  Prints a row for each: CPU seconds, substeps and warnings.  Exit status
1 if there was a failure.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.presets import find_preset, presets
from tools.bench.commands import children_cpu

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
ASSETS = ("sphere.usda", "duck.usda", "creature.usda", "deformed_sphere.usda", "ten_ducks.usda")
# Refusals that are meant: exit status and part of the message.
REFUSED = ((3, "cannot carry its own weight"),)
# The first contact is before the third frame, and before the seventh for grains, whose outermost
# are half a spacing below the surface.
DROP, FRAMES, FLOWING_FRAMES = "0.02r", 4, 7


def bake(asset: str, preset: str, particles: int, out: Path) -> tuple[bool, str]:
    """Whether one combination passed, and its result as text."""
    frames = FLOWING_FRAMES if LAWS[find_preset(preset).law].unbounded else FRAMES
    before = children_cpu()
    done = subprocess.run(
        [
            *(sys.executable, "-m", "gf_usd", "bake", str(SAMPLES / asset), "-m", preset),
            *("--particles", str(particles), "--frames", str(frames), "--drop", DROP),
            *("--threads", "1", "--json", "--quiet", "--overwrite", "-o", f"{out}/"),
        ],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    took = children_cpu() - before
    if done.returncode:
        message = done.stderr.strip().replace("\n\n", "; ")
        good = any(done.returncode == status and refusal in message for status, refusal in REFUSED)
        return good, f"status {done.returncode}: {message}"
    result = json.loads(done.stdout)
    health = result["bakes"][0]["health"]
    warned = ", ".join(row["about"] for row in result["warnings"]) or "no warning"
    broken = health["inverted_at_end"] or result["check"]
    return not broken, f"{took:.1f} s, {health['substeps']} substeps, {warned}"


def main() -> int:
    parser = argparse.ArgumentParser(description="Bake every sample with every preset.")
    parser.add_argument("--only", action="append", default=[], help="combinations with this text")
    parser.add_argument("--particles", type=int, default=300, help="of each bake")
    given = parser.parse_args()
    failed = 0
    for asset in ASSETS:
        for preset in presets():
            name = f"{asset} {preset}"
            if given.only and not any(text in name for text in given.only):
                continue
            with tempfile.TemporaryDirectory() as out:
                good, message = bake(asset, preset, given.particles, Path(out))
            failed += not good
            print(f"{'ok' if good else 'FAILED':6} {name}: {message}", flush=True)
    print(f"{failed} failed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
