"""The surface of flowing bodies: its cost, and its distance from the boundary of the material.

    python -m tools.bench.surfaces [--particles 4000,20000,...]

CPU seconds of one frame on one thread, with compiled kernels, the least of three; of balls that
particles fill at random, one in each cell of a lattice, and of spray, where they are three spacings
apart.  Volume is that inside the surface over that of the particles; memory is the peak of the
process, which the largest decides.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

from gf_usd.physics.output.surface import surface
from gf_usd.system.taichi_runtime import init_taichi

APART = 3.0  # spacings between the particles of spray


def ball(count: int) -> np.ndarray:
    """(N, 3) about so many particles, a spacing of 1 apart."""
    radius = np.cbrt(0.75 / np.pi * count)
    reach = int(np.ceil(radius)) + 1
    cells = np.stack(np.meshgrid(*[np.arange(-reach, reach)] * 3, indexing="ij"), -1).reshape(-1, 3)
    x = cells + np.random.default_rng(0).random(cells.shape)
    return x[np.linalg.norm(x, axis=1) < radius]


def row(name: str, x: np.ndarray) -> str:
    """A row of the table."""
    volumes = np.ones(len(x))
    carried = np.ones((len(x), 6))
    seconds = []
    for _ in range(3):
        began = time.process_time()
        found = surface(x, volumes, carried)
        seconds.append(time.process_time() - began)
    a, b, c = (found.points[found.triangles[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0 / len(x)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    return (
        f"| {name} | {len(x)} | {len(found.points)} | {len(found.triangles)} | {volume:.3f}"
        f" | {min(seconds):.2f} | {peak:.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--particles", default="1,1000,4000,8000,20000,100000", metavar="N,...")
    counts = [int(text) for text in parser.parse_args().particles.split(",")]
    init_taichi(threads=1)
    surface(np.zeros((1, 3)), np.ones(1), np.ones((1, 6)))
    print("| particles are | particles | vertices | triangles | volume | CPU s | GB |")
    print("|---|---|---|---|---|---|---|")
    for count in counts:
        print(row("a ball", ball(count) if count > 1 else np.full((1, 3), 0.3)), flush=True)
    print(row("spray", APART * ball(8000)), flush=True)


if __name__ == "__main__":
    sys.exit(main())
