"""The savings of each option for smaller caches: tables of docs/guide/smaller-caches.md.

    python -m tools.bench.storage                            the duck and the creature
    python -m tools.bench.storage spot_control_mesh.obj      and another asset

The first table has crates with the same array of vectors in several forms. The second has bakes of
few particles: bytes of the full cache, and the share of it with each option.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Vt

import gf_usd
from tools.bench.commands import DUCK, ROOT

POINTS, SAMPLES = 2000, 24
PARTICLES = 2000
Types = Sdf.ValueTypeNames
FEW = {"precision": "0.5%", "adaptive_samples": True}
OPTIONS: dict[str, dict[str, Any]] = {
    "`--precision 0.5%`": {"precision": "0.5%"},
    "`--no-velocities`": {"no_velocities": True},
    "`--precision 0.5% --adaptive-samples`": FEW,
    "both": {**FEW, "no_velocities": True},
    "both, `--only mesh`": {**FEW, "no_velocities": True, "only": "mesh"},
}
SCENES: dict[str, dict[str, Any]] = {
    "of 24 frames": {"frames": 24},
    "of jelly, `--frames rest:400`": {"frames": "rest:400", "material": "jelly"},
    "of 24 frames, `--time-scale 0.1`": {"frames": 24, "time_scale": 0.1},
}


def crate(folder: Path, kind: Any, arrays: Sequence[Any]) -> int:
    """[bytes] of a crate with one attribute that has these samples."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    Sdf.AttributeSpec(Sdf.CreatePrimInLayer(layer, "/x"), "a", kind)
    for time, array in enumerate(arrays):
        layer.SetTimeSample("/x.a", time, array)
    path = folder / "one.usdc"
    layer.Export(str(path))
    return path.stat().st_size


def form_table(folder: Path) -> list[str]:
    """One line for each form of the same samples."""
    rng = np.random.default_rng(0)
    curve = [rng.normal(size=(POINTS, 3)) for _ in range(SAMPLES)]

    def forms(make: Callable[[Any], Any], dtype: Any, scale: float = 0.0) -> list[Any]:
        steps = [np.round(scale * x) if scale else x for x in curve]
        return [make(np.ascontiguousarray(x, dtype)) for x in steps]

    flat = [np.ravel(x) for x in curve]
    vectors, halves = Vt.Vec3fArray.FromNumpy, Vt.Vec3hArray.FromNumpy
    floats = Vt.FloatArray.FromNumpy
    rows = {
        "`point3f[]`": (Types.Point3fArray, forms(vectors, np.float32)),
        "`point3f[]` of whole numbers": (Types.Point3fArray, forms(vectors, np.float32, 100.0)),
        "`half3[]`": (Types.Half3Array, forms(halves, np.float16)),
        "`float[]`": (Types.FloatArray, [floats(x.astype(np.float32)) for x in flat]),
        "`float[]` of whole numbers to 400": (
            Types.FloatArray,
            [floats(np.round(100.0 * x).astype(np.float32)) for x in flat],
        ),
        "`float[]` of 30 values": (
            Types.FloatArray,
            [floats((0.3 * np.round(4.0 * x)).astype(np.float32)) for x in flat],
        ),
        "`point3f[]`, all samples equal": (
            Types.Point3fArray,
            [vectors(curve[0].astype(np.float32))] * SAMPLES,
        ),
    }
    lines = ["| samples | bytes | of `point3f[]` |", "|---|---:|---:|"]
    sizes = {name: crate(folder, kind, arrays) for name, (kind, arrays) in rows.items()}
    whole = sizes["`point3f[]`"]
    return [
        *lines,
        *(f"| {name} | {size:,} | {size / whole:.2f} |" for name, size in sizes.items()),
    ]


def bake_lines(asset: Path, scene: str, folder: Path) -> str:
    """One line of a bake with each set of options."""

    def made(options: Mapping[str, Any]) -> gf_usd.BakeResult:
        return gf_usd.bake(
            asset, output=folder / "bake.usda", particles=PARTICLES, threads=1, overwrite=True,
            **SCENES[scene], **options,
        )  # fmt: skip

    whole = made({}).cache.stat().st_size
    cells, worst = [], ""
    for options in OPTIONS.values():
        result = made(options)
        cells.append(f"{result.cache.stat().st_size / whole:.2f}")
        storage = result.bakes[0].storage or {}
        off = storage["errors"].get("positions_m")
        if options == FEW:
            counts = storage["samples"].values()
            left = sum(one["of"] - one["kept"] for one in counts)
            worst = f"{left} of {sum(one['of'] for one in counts)} | " + (
                f"{1e3 * off:.2g} mm" if off else "0"
            )
    name = asset.stem.replace("_", " ")
    return f"| {name} {scene} | {whole / 1e6:.2f} MB | {' | '.join(cells)} | {worst} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("assets", nargs="*", type=Path, help="further files to bake")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("\n".join(form_table(folder)), end="\n\n")
        print(f"| bake | all | {' | '.join(OPTIONS)} | samples left out | error of points |")
        print("|---|---:|" + "---:|" * (len(OPTIONS) + 2))
        pairs = [(DUCK, scene) for scene in SCENES]
        pairs += [
            (asset, "of 24 frames") for asset in (ROOT / "samples" / "creature.usda", *args.assets)
        ]
        for asset, scene in pairs:
            print(bake_lines(asset, scene, folder), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
