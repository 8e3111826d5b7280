"""Time and memory of a bake of captured Gaussians.

    python -m tools.bench.splats [--splats 150000] [--degree 3] [--frames 120]

The capture is made here: discs on a wavy hollow ball, with random harmonics.  Printed are CPU and
wall-clock seconds of the whole bake, the size of the cache with its clips, and the memory of the
process without mapped files: its largest value, and its growth from the first tenth of the frames
to the end.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import gf_usd
from gf_usd.core.asset import Splats
from gf_usd.readers.splats.write import ply_bytes


def main() -> None:
    """Make the capture, bake it and print what it took."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--splats", type=int, default=150_000)
    parser.add_argument("--degree", type=int, default=3, choices=range(4))
    parser.add_argument("--frames", type=int, default=120)
    options = parser.parse_args()
    used: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "ball.ply"
        path.write_bytes(ply_bytes(capture(options.splats, options.degree)))
        began, cpu = time.perf_counter(), time.process_time()
        result = gf_usd.bake(
            path,
            material="jelly",
            output=f"{name}/",
            frames=options.frames,
            progress=lambda done, total: used.append(anonymous()),
        )
        wall, cpu = time.perf_counter() - began, time.process_time() - cpu
        files = [result.cache, *(clip for bake in result.bakes for clip in bake.clips)]
        size = sum(path.stat().st_size for path in files)
    early = max(used[: max(1, len(used) // 10)])
    print(
        f"{options.splats} Gaussians of degree {options.degree}, {result.frames} frames,"
        f" {result.particles} particles: {cpu:.0f} CPU s, {wall:.0f} s on the clock,"
        f" cache {size / 1e9:.2f} GB, memory {max(used) / 1e9:.2f} GB,"
        f" grown by {(max(used) - early) / 1e9:.2f} GB"
    )


def anonymous() -> float:
    """[bytes] of this process in memory that are no file's (Linux)."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    line = next(line for line in status.splitlines() if line.startswith("RssAnon"))
    return 1024.0 * float(line.split()[1])


def capture(count: int, degree: int) -> Splats:
    """Discs on the surface r = .5 + .05 sin(5 x) sin(5 y), facing outward."""
    rng = np.random.default_rng(0)
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    radius = 0.5 + 0.05 * np.sin(5 * n[:, :1]) * np.sin(5 * n[:, 1:2])
    # half a turn about the axis between z and n takes z to n
    turn = np.concatenate([np.zeros((count, 1)), n + [0.0, 0.0, 1.0 + 1e-9]], axis=1)
    harmonics = 0.1 * rng.normal(size=(count, (degree + 1) ** 2, 3))
    wide = 2.0 / np.sqrt(count)
    return Splats(
        positions=radius * n,
        orientations=turn / np.linalg.norm(turn, axis=1, keepdims=True),
        scales=np.tile([wide, wide, 0.1 * wide], (count, 1)),
        opacities=np.full(count, 0.9),
        harmonics=harmonics,
    )


if __name__ == "__main__":
    main()
