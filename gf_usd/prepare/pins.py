"""Pins from `--pin`: a box, or the volume that a prim of the asset bounds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError
from gf_usd.core.frames import Settings
from gf_usd.core.stage import Pin, Region

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


def make_pins(
    names: Sequence[str],
    asset: Asset,
    solid: Solid,
    settings: Settings,
    file: Path,
    *,
    rest: float | None,
) -> tuple[Pin, ...]:
    """One pin for each name: "box:x0,y0,z0,x1,y1,z1" [stage units] or a prim path.

    file : the USD form of the asset; rest : time code of the rest pose, None: the asset's own.

    Raises UsageError for a box that is none, InputError for a prim that is none or has no surface,
    and for a region that holds nothing of the body.
    """
    from gf_usd.geometry.regions import BOX, box_region, make_pin
    from gf_usd.readers.usd_bake.regions import read_regions

    if not names:
        return ()
    times = [settings.time_code(i) for i in range(settings.frames)]

    def read(paths: Sequence[str]) -> tuple[Region, ...]:
        return read_regions(file, paths, asset.facts, rest=rest, times=times)

    boxes = [name for name in names if name.startswith(BOX)]
    prims = [name for name in names if not name.startswith(BOX)]
    regions = {region.name: region for region in read(prims)} if prims else {}
    if boxes:
        bodies = read([s.path for s in asset.surfaces])
        length = max(len(body.path) for body in bodies)
        points = np.concatenate([body.points for body in bodies])
        path = np.concatenate(
            [np.broadcast_to(b.path, (length, *b.path.shape[1:])) for b in bodies], axis=1
        )
        unit = asset.facts.units.length
        regions |= {name: box_region(name, unit, points, path) for name in boxes}
    for name in names:
        _require_hold(regions[name], asset)
    return tuple(make_pin(regions[name], solid) for name in names)


def _require_hold(region: Region, asset: Asset) -> None:
    """Raise InputError where a region does not even touch the asset."""
    points = np.concatenate([s.points for s in asset.surfaces])
    low, high = points.min(0), points.max(0)
    box = region.points[np.unique(region.triangles)]
    if (box.max(0) < low).any() or (box.min(0) > high).any():
        unit = asset.facts.units.length
        raise InputError(
            f"{asset.facts.path}: --pin {region.name} does not touch the asset, which lies between"
            f" {np.round(low / unit, 4).tolist()} and {np.round(high / unit, 4).tolist()}"
            " (stage units)",
            "give a region that overlaps it",
        )
