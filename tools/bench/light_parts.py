"""Contact of parts with less mass than a layer one spacing thick, in this or another checkout.

    python -m tools.bench.light_parts [--of FOLDER]

Bakes fins that end in knife edges, leaves that end in one under a ball, a box on two thin blades,
and a face that encloses nothing. A row for each: substeps, the most in a frame, CPU seconds of the
process, depths in spacings, and the greatest unexplained gain of energy in a frame.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from tools.bench.processes import ALONE, ROOT

Shape = tuple[np.ndarray, list[list[int]]]  # points (n, 3) [m] and faces
COLUMNS = ("bake", "substeps", "in a frame", "CPU s", "floor", "at the end", "bodies", "gain")


def box(low: Sequence[float], high: Sequence[float], cells: Sequence[int] = (1, 1, 1)) -> Shape:
    """A box whose faces are divided."""
    points: dict[tuple[int, ...], int] = {}
    faces = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, cells[axis]):
            for i, j in np.ndindex(cells[u], cells[v]):
                face = []
                for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    at = [side, side, side]
                    at[u], at[v] = i + du, j + dv
                    face.append(points.setdefault(tuple(at), len(points)))
                faces.append(face if side else face[::-1])
    share = np.array(list(points)) / np.array(cells)
    return np.array(low) + share * np.subtract(high, low), faces


def joined(*shapes: Shape) -> Shape:
    """Shells of one mesh."""
    points, faces = [], []
    for own, corners in shapes:
        start = sum(map(len, points))
        points.append(own)
        faces += [[start + k for k in face] for face in corners]
    return np.concatenate(points), faces


def fins() -> list[Shape]:
    """A box with two fins, from .05 m thick to a thousandth of that at their ends."""
    parts = [box((-0.5, 0.0, -0.5), (0.5, 1.0, 0.5), (4, 4, 4))]
    for low, high in ((0.4, 1.4), (-1.4, -0.4)):
        points, faces = box((low, 0.475, -0.3), (high, 0.525, 0.3), (10, 1, 6))
        points[:, 1] = 0.5 + (points[:, 1] - 0.5) * np.maximum(0.001, 1.4 - abs(points[:, 0]))
        parts.append((points, faces))
    return [joined(*parts)]


def leaves() -> list[Shape]:
    """Four leaves, .03 m thick in the middle, and a ball above them."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    shapes = [(ball.vertices + (0.0, 1.1, 0.0), ball.faces.tolist())]
    for k in range(4):
        points, faces = box((-0.7, -0.015, -0.4), (0.7, 0.015, 0.4), (14, 1, 8))
        x, z = points[:, 0].copy(), points[:, 2].copy()
        points[:, 1] *= np.maximum(0.03, 1.0 - (x / 0.7) ** 2 - (z / 0.4) ** 2)
        points[:, 1] += 0.015 + 0.1 * k
        c, s = np.cos(0.25 * np.pi * k), np.sin(0.25 * np.pi * k)
        points[:, 0], points[:, 2] = c * x - s * z, s * x + c * z
        shapes.append((points, faces))
    return shapes


def blades() -> list[Shape]:
    """A box on two blades, .005 m thick, which carry it."""
    body = box((-0.5, 0.5, -0.5), (0.5, 1.0, 0.5), (4, 4, 4))
    thin = [box((x - 0.0025, 0, -0.5), (x + 0.0025, 0.6, 0.5), (1, 6, 10)) for x in (-0.4, 0.4)]
    return [joined(body, *thin)]


def bare() -> list[Shape]:
    """A cube and a triangle that encloses nothing."""
    points, faces = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    edge = [int(np.abs(points - (0.0, 0.0, z)).sum(1).argmin()) for z in (0.0, 1.0)]
    return [(np.vstack([points, [[-1.0, 0.5, 0.5]]]), [*faces, [*edge, len(points)]])]


SCENES = (
    (fins, ("--particles", "2000", "--frames", "60", "--material", "jelly")),
    (fins, ("--particles", "2000", "--frames", "30", "--material", "clay")),
    (fins, ("--particles", "2000", "--frames", "40", "--solver", "ul")),
    (leaves, ("--particles", "3000", "--frames", "60")),
    (leaves, ("--particles", "3000", "--frames", "60", "--material", "jelly")),
    (leaves, ("--particles", "3000", "--frames", "40", "--material", "metal")),
    (blades, ("--particles", "2000", "--frames", "120")),
    (bare, ("--particles", "2000", "--frames", "60")),
)


def stage(shapes: Sequence[Shape]) -> str:
    """The text of a layer, in meters."""
    meshes = [
        f' def Mesh "M{k}" {{\n uniform token subdivisionScheme = "none"\n'
        f" int[] faceVertexCounts = {[len(face) for face in faces]}\n"
        f" int[] faceVertexIndices = {[corner for face in faces for corner in face]}\n"
        f" point3f[] points = {[tuple(p) for p in np.round(points, 6).tolist()]}\n }}\n"
        for k, (points, faces) in enumerate(shapes)
    ]
    head = '#usda 1.0\n(\n metersPerUnit = 1\n upAxis = "Y"\n)\n'
    return head + 'def Xform "W" {\n' + "".join(meshes) + "}\n"


def row(asset: Path, options: Sequence[str], checkout: Path) -> list[str]:
    """The cost of a bake and its deepest penetration.

    Raises SystemExit with its message where it fails.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    arguments = ["bake", str(asset), *options, "-o", f"{asset.parent}/", "--json", "--quiet"]
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", *arguments, "--threads", "1", "--overwrite"],
        capture_output=True, text=True, check=False,
        cwd=checkout, env={**os.environ, **ALONE, "PYTHONPATH": str(checkout)},
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(done.stderr.strip() or f"exit status {done.returncode}")
    took = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    health = json.loads(done.stdout)["bakes"][0]["health"]
    return [
        f"{health['substeps']:,}",
        f"{health['substeps_max_per_frame']:,}",
        f"{took:.1f}",
        *(
            f"{health[f'{name}_spacings']:.2f}"
            for name in ("deepest_penetration", "penetration_at_end", "deepest_overlap")
        ),
        f"{health['energy_gain_max_share']:.1g}",
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--of", type=Path, default=ROOT, help="checkout that bakes")
    checkout = parser.parse_args().of.resolve()
    print(f"| {' | '.join(COLUMNS)} |\n|---|{'---:|' * (len(COLUMNS) - 1)}")
    with tempfile.TemporaryDirectory() as folder:
        for make, options in SCENES:
            asset = Path(folder) / f"{make.__name__}.usda"
            asset.write_text(stage(make()), encoding="utf-8")
            values = row(asset, options, checkout)
            print(f"| {make.__name__} {' '.join(options[4:])} | {' | '.join(values)} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
