"""Memory of writing a long cache: frames of particles without a simulation.

    python -m tools.bench.long_cache --particles 100000 --frames 1000 --folder /big/disk

Prints JSON.  Memory is that of this process as reported by the kernel: `anonymous` is allocated
memory, `resident` also includes mapped files.  `growth` is the most after the first tenth of the
frames less the most before.  The files are removed unless --keep is given.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gf_usd.core.asset import Asset
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import BakedFrame, BakeInfo, GaussianPose, Health, MeshPose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.layers.cache import CacheWriter
from gf_usd.readers import read_asset

BOX = """#usda 1.0
( metersPerUnit = 1 )
def Mesh "Box"
{
    uniform token subdivisionScheme = "none"
    point3f[] points = [
        (0,0,0), (1,0,0), (1,1,0), (0,1,0), (0,0,1), (1,0,1), (1,1,1), (0,1,1)
    ]
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0,3,2,1, 4,5,6,7, 0,1,5,4, 1,2,6,5, 2,3,7,6, 3,0,4,7]
}
"""


@dataclass
class Memory:
    """Peak values [bytes], before and after a given time."""

    before: dict[str, int]
    after: dict[str, int]

    def look(self, *, early: bool) -> None:
        most = self.before if early else self.after
        for name, value in memory().items():
            most[name] = max(most.get(name, 0), value)


def memory() -> dict[str, int]:
    """Anonymous and resident memory [bytes] of this process, from /proc."""
    rows = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    sizes = {row.split(":")[0]: row.split(":")[1] for row in rows}
    names = {"anonymous": "RssAnon", "resident": "VmRSS"}
    return {name: int(sizes[key].split()[0]) * 1024 for name, key in names.items()}


def cloud(count: int) -> Particles:
    """Particles in the box."""
    rng = np.random.default_rng(1)
    spacing = count ** (-1.0 / 3.0)
    turn = rng.normal(size=(count, 4))
    return Particles(
        X=rng.random((count, 3)),
        V0=np.full(count, spacing**3),
        material=np.zeros(count, int),
        orientation=turn / np.linalg.norm(turn, axis=1, keepdims=True),
        scale=spacing * rng.uniform(0.2, 1.0, (count, 3)),
        color=rng.random((count, 3)),
        opacity=np.ones(count),
        surface=np.zeros(count, int),
        spacing=spacing,
        volume=1.0,
        lattice=spacing,
        corner=np.zeros(3),
    )


def stream(asset: Asset, particles: Particles, settings: Settings) -> Iterator[BakedFrame]:
    """Frames of which no two are alike, or identical arrays would be stored once."""
    mesh = asset.surfaces[0]
    for index in range(settings.frames):
        t = index / settings.fps
        shift = np.array([t, -0.5 * t * t, np.sin(t)])
        yield BakedFrame(
            index=index,
            time_code=settings.time_code(index),
            meshes={mesh.path: MeshPose(points=mesh.points + shift, velocities=mesh.points * t)},
            gaussians=GaussianPose(
                positions=particles.X + shift,
                velocities=particles.X * t,
                orientations=np.roll(particles.orientation, index, axis=0),
                scales=particles.scale * (1.0 + 0.1 * np.sin(t)),
            ),
            health=Health(),
        )


def write(folder: Path, particles: int, frames: int, choices: Choices) -> dict[str, object]:
    """Write a cache into a folder and say what it took."""
    source = folder / "box.usda"
    source.write_text(BOX, encoding="utf-8")
    asset, body = read_asset(source), cloud(particles)
    settings = Settings(
        frames=frames, fps=24.0, time_codes_per_second=24.0, start=1.0,
        gravity=(0.0, -9.81, 0.0), up=(0.0, 1.0, 0.0),
    )  # fmt: skip
    material = Material(
        name="rubber", law="neoHookean", density=1100.0, youngs_modulus=1e5, poissons_ratio=0.45
    )
    info = BakeInfo(
        look="rubber", materials=(material,), settings=settings, command="", version="",
        input_hash="",
    )  # fmt: skip
    seen, began = Memory({}, {}), time.perf_counter()
    with CacheWriter(folder / "box.cache.usdc", asset, body, info, choices=choices) as cache:
        for frame in stream(asset, body, settings):
            cache.write(frame)
            seen.look(early=frame.index < frames / 10)
        summary = cache.close()
    seen.look(early=False)
    return {
        "particles": particles,
        "frames": frames,
        "clips": max(0, len(summary.clips) - 1),
        "seconds": round(time.perf_counter() - began, 1),
        "bytes": summary.bytes,
        "most": seen.after,
        "growth": {name: seen.after[name] - seen.before[name] for name in seen.after},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--clip-frames", type=int, default=0, help="0: one file")
    parser.add_argument("--half", action="store_true")
    parser.add_argument("--folder", type=Path, help="where to write; default a temporary one")
    parser.add_argument("--keep", action="store_true")
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(dir=args.folder, prefix="gf-usd-"))
    choices = Choices(clip_frames=args.clip_frames, half=args.half)
    try:
        print(json.dumps(write(folder, args.particles, args.frames, choices), indent=1))
    finally:
        if not args.keep:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
