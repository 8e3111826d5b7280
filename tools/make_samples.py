"""Write the samples: a duck, its capture, two spheres, a rigged creature, and five shots.

    python tools/make_samples.py [--out FOLDER]

The shapes are this project's own work, computed from the formulas in samples/duck.py,
sphere.py, creature.py, bowl.py and flowing.py; running it again gives the same bytes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tools.samples.capture import write_capture
from tools.samples.creature_usd import write_creature
from tools.samples.duck import MATERIAL_OF, duck, duck_atlas, duck_quads
from tools.samples.flowing import write_sandcastle, write_snowball, write_toothpaste
from tools.samples.implicit import unit_normals
from tools.samples.quads import Quads
from tools.samples.shot import write_shot
from tools.samples.sphere import deformed, level, sphere_atlas, sphere_quads
from tools.samples.ten_ducks import write_ten_ducks
from tools.samples.usd import Look, Sample, file_name, write_sample

SAMPLES = Path(__file__).resolve().parent.parent / "samples"


def duck_sample() -> Sample:
    """A bath duck, 10 cm long, in centimeters, sitting on y = 0 and facing +Z."""
    mesh = duck_quads()
    parts = np.array([MATERIAL_OF[part] for part in mesh.parts])
    return Sample(
        name="Duck",
        doc="A rubber duck, 10 cm long: one watertight quad mesh. Y up, facing +Z.",
        meters_per_unit=0.01,
        mesh=Quads(points=mesh.points, faces=mesh.faces, parts=parts),
        normals=unit_normals(duck, mesh.points),
        atlas=duck_atlas(mesh),
        looks={
            "body": Look(color=(0.93, 0.60, 0.015), roughness=0.38, clearcoat=0.25),
            "beak": Look(color=(0.88, 0.17, 0.012), roughness=0.38, clearcoat=0.25),
            "eyes": Look(color=(0.006, 0.006, 0.008), roughness=0.08, clearcoat=1.0),
        },
    )


def sphere_samples() -> tuple[Sample, Sample]:
    """The unit sphere and the deformed sphere of the same volume, in meters, about the origin."""
    sphere = sphere_quads()
    lumpy, scale = deformed(sphere)
    atlas = sphere_atlas(sphere)
    return (
        Sample(
            name="Sphere",
            doc="A sphere of radius 1 m about the origin: a cube-sphere of 1536 quads. Y up.",
            meters_per_unit=1.0,
            mesh=sphere,
            normals=sphere.points,
            atlas=atlas,
            looks={"body": Look(color=(0.05, 0.30, 0.55), roughness=0.35, clearcoat=0.25)},
        ),
        Sample(
            name="DeformedSphere",
            doc="A lopsided peanut with the topology and volume of sphere.usda. Meters, Y up.",
            meters_per_unit=1.0,
            mesh=lumpy,
            normals=unit_normals(level, lumpy.points / scale),
            atlas=atlas,
            looks={"body": Look(color=(0.58, 0.11, 0.09), roughness=0.35, clearcoat=0.25)},
        ),
    )


def main() -> None:
    """Write every sample into the folder of --out."""
    parser = argparse.ArgumentParser(description="Write the sample assets.")
    parser.add_argument("--out", type=Path, default=SAMPLES, help="folder (default: samples)")
    folder: Path = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    swimmer = duck_sample()
    for sample in (swimmer, *sphere_samples()):
        path = folder / file_name(sample)
        write_sample(path, sample)
        print(f"{path}: {len(sample.mesh.faces)} quads, {path.stat().st_size / 1e3:.0f} kB")
    path = folder / "duck_capture.spz"
    count = write_capture(path, swimmer)
    print(f"{path}: {count} Gaussians, {path.stat().st_size / 1e3:.0f} kB")
    path = folder / "creature.usda"
    mesh = write_creature(path)
    print(f"{path}: {len(mesh.faces)} quads, {path.stat().st_size / 1e3:.0f} kB")
    path = folder / "shot.usda"
    write_shot(path)
    print(path)
    path = folder / "ten_ducks.usda"
    write_ten_ducks(path, "./duck.usda")
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
    write_sandcastle(folder / "sandcastle.usda", "./duck.usda")
    write_snowball(folder / "snowball.usda")
    write_toothpaste(folder / "toothpaste.usda")
    for name in ("sandcastle", "snowball", "toothpaste"):
        path = folder / f"{name}.usda"
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
