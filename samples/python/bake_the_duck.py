"""Bake a duck as rubber and as a material of your own, look at it, and check the result.

python samples/python/bake_the_duck.py samples/duck.usda out/
"""

from __future__ import annotations

import sys
from pathlib import Path

import gf_usd


def main(duck: Path, folder: Path, particles: int | None = None) -> gf_usd.BakeResult:
    soft = gf_usd.Material(
        name="soft-foam",
        law="neoHookean",
        density=80.0,  # [kg/m^3]
        youngs_modulus=2e4,  # [Pa]
        poissons_ratio=0.25,
        damping_time=1e-3,  # [s]
    )
    seen = gf_usd.inspect(duck, particles=particles)
    if seen.refusal is not None:
        raise SystemExit(str(seen.refusal))
    result = gf_usd.bake(
        duck,
        material=["rubber", soft],
        output=folder,
        particles=particles,
        drop="3r",  # three radii of the body
        range=(1, 24),
        overwrite=True,
    )
    for bake in result.bakes:
        print(bake.variant, "bounces back with", bake.health["restitution"], "of its speed")
    for name, warning in result.warnings:
        print(f"{name}: {warning.message} ({warning.hint})")
    picture = gf_usd.preview(result.root, folder / "duck.png", frame=12, size=(480, 360))
    print(picture.path, "and", result.root, "are written")
    for finding in gf_usd.check(result.root).findings:
        print(finding.severity, finding.prim_path, finding.message)
    return result


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
