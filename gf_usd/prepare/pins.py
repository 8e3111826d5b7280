"""Pins of `--pin` and `--rigid`, and attachments of the stage: a box, or the volume of a prim."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import AttachedPoints, Goals, Pin, Region

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
    option: str = "--pin",
    bodies: Ints | None = None,
    without: Collection[str] = (),
) -> tuple[Pin, ...]:
    """The pins of each name: "box:x0,y0,z0,x1,y1,z1" [stage units], "paint:PRIMVAR", "joint:NAME"
    or a prim path.

    file : the USD form of the asset; rest : time code of the rest pose, None: the asset's own.
    option : --pin, or --rigid for regions that move by the forces on them.
    bodies : (S,) of each surface of the solid: a part of a surface pins the body of that surface
        only; None: there is one body.
    without : prim paths of meshes that are no part of the volume of a prim above them.

    Raises UsageError for a box that is none, InputError for a prim that is none or has no surface,
    and for a region that contains nothing of the body.
    """
    from gf_usd.geometry.regions import BOX, box_region, make_pin, make_rigid, part_of_joined
    from gf_usd.readers.usd_bake.regions import JOINT, PAINT, read_regions, read_weighted

    if not names:
        return ()
    times = [settings.time_code(i) for i in range(settings.frames)]

    def read(paths: Sequence[str]) -> tuple[Region, ...]:
        return read_regions(
            file, paths, asset.facts, rest=rest, times=times, option=option, without=without
        )

    boxes = [name for name in names if name.startswith(BOX)]
    weights = [name for name in names if name.startswith((PAINT, JOINT))]
    prims = [name for name in names if not name.startswith(BOX) and name not in weights]
    regions = {one.name: part_of_joined(one, solid) for one in (read(prims) if prims else ())}
    if boxes:
        # a capture has no surface in its stage, and its animation is not followed
        still = [s.points for s in asset.surfaces if s.splats is not None]
        moving = read([s.path for s in asset.surfaces if s.splats is None])
        length = max((len(body.path) for body in moving), default=1)
        points = np.concatenate([*(body.points for body in moving), *still])
        path = np.concatenate(
            [
                np.broadcast_to(one, (length, *one.shape[1:]))
                for one in (*(body.path for body in moving), *(at[None] for at in still))
            ],
            axis=1,
        )
        unit = asset.facts.units.length
        regions |= {name: box_region(name, unit, points, path, option) for name in boxes}
    filled = list(solid.filled)
    every = {name: (regions[name],) for name in regions} | {
        name: read_weighted(file, name, asset.facts, filled, rest=rest, times=times, option=option)
        for name in weights
    }
    found = [region for name in names for region in every[name]]
    for region in found:
        _require_overlap(region, asset, option)
    make = make_rigid if option == "--rigid" else make_pin
    return tuple(
        replace(
            make(region, solid, asset.surfaces),
            body=_body_of(region, solid, bodies), bodies=_bodies_under(region, solid, bodies),
        )
        for region in found
    )  # fmt: skip


def _body_of(region: Region, solid: Solid, bodies: Ints | None) -> int | None:
    """The body of the surface that a region is a part of; None: it is a volume of its own.

    bodies : (S,) of each surface.
    """
    part = region.kind == "patch" or any(region.name in group for group in solid.joined)
    if bodies is None or not part:
        return None
    return int(bodies[solid.filled[region.body or region.name]])


def _bodies_under(region: Region, solid: Solid, bodies: Ints | None) -> frozenset[int]:
    """The bodies of the filled meshes at the prim path of a region and below it.

    bodies : (S,) of each surface.
    """
    if bodies is None:
        return frozenset()
    above = f"{region.name.rstrip('/')}/"
    filled = solid.filled.items()
    return frozenset(int(bodies[k]) for path, k in filled if f"{path}/".startswith(above))


def attachment_pins(
    paths: Sequence[str],
    asset: Asset,
    solid: Solid,
    settings: Settings,
    file: Path,
    rest: float | None,
    bodies: Ints,
) -> tuple[tuple[Pin, ...], tuple[str, ...]]:
    """Pins from attachments of the stage, and notes; raises InputError as `read_attachments`.

    bodies : as in `make_pins`.
    """
    if not paths:
        return (), ()
    from gf_usd.geometry.regions import make_pin
    from gf_usd.readers.usd_physics.attachments import read_attachments, read_written_pins

    times = [settings.time_code(i) for i in range(settings.frames)]
    written = read_written_pins(file, paths, asset.facts, rest=rest, times=times)
    ours = {one.name for one in written}
    others = [path for path in paths if path not in ours]
    regions, notes = read_attachments(file, others, asset.facts, rest=rest, times=times)
    held = f"attachments pin parts of the body: {', '.join(paths)}"
    pins = [
        replace(
            make_pin(region, solid, asset.surfaces, "attachment"),
            body=_body_of(region, solid, bodies),
        )
        for region in regions
    ]
    for region in dict.fromkeys(one.region for one in written):
        mine = [one for one in written if one.region == region]  # one of each body
        name, length = mine[0].name, max(len(one.path) for one in mine)
        each = [np.broadcast_to(one.path, (length, *one.path.shape[1:])) for one in mine]
        path = np.concatenate(each, axis=1)
        option = f"<{name}>: the region"
        made = make_pins(
            [region], asset, solid, settings, file, rest=rest, option=option, bodies=bodies
        )
        # the attachments give its positions, however the surface of the stage moves
        pins += [replace(pin, name=name, anchors=path[0], path=path) for pin in made]
    return tuple(pins), (held, *notes)


def soft_attachment_goals(
    paths: Sequence[str],
    asset: Asset,
    settings: Settings,
    file: Path,
    rest: float | None,
    *,
    body: Mapping[str, int],
    copies: Mapping[str, Ints],
) -> Goals | None:
    """Springs from soft attachments of the stage; raises InputError as `read_attachments`.

    body : of each surface, by prim path; copies : of cells, of the points of surfaces.
    """
    from gf_usd.readers.usd_physics.attachments import read_soft_attachments

    times = [settings.time_code(i) for i in range(settings.frames)]
    found = read_soft_attachments(file, paths, asset.facts, rest=rest, times=times)
    if not found:
        return None
    length = max(len(one.path) for one in found)
    counts = [len(one.points) for one in found]
    cells = [copies[one.body][one.points] if one.body in copies else None for one in found]
    known = [c for c in cells if c is not None]
    attached = AttachedPoints(
        X=np.concatenate([one.X for one in found]),
        path=np.concatenate(
            [np.broadcast_to(one.path, (length, *one.path.shape[1:])) for one in found], axis=1
        ),
        stiffness=np.repeat([one.stiffness for one in found], counts),
        damping=np.repeat([one.damping for one in found], counts),
        body=np.repeat([body.get(one.body, 0) for one in found], counts),
        cell_copy=np.concatenate(known) if len(known) == len(cells) else None,
    )
    return replace(FREE, attached=attached)


def _rest_pose(X: Floats) -> Callable[[float], Floats]:
    return lambda frame: X


def _no_rate(X: Floats) -> Floats:
    return np.zeros(len(X))


# Springs that pull nothing.
FREE = Goals(pose=_rest_pose, rate=_no_rate, moving=False)


def _require_overlap(region: Region, asset: Asset, option: str) -> None:
    """Raise InputError where a region does not touch the asset."""
    points = np.concatenate([s.points for s in asset.surfaces])
    low, high = points.min(0), points.max(0)
    box = region.points[np.unique(region.triangles)]
    if (box.max(0) < low).any() or (box.min(0) > high).any():
        unit = asset.facts.units.length
        raise InputError(
            f"{asset.facts.path}: {option} {region.name} does not touch the asset, which lies"
            f" between {np.round(low / unit, 4).tolist()} and {np.round(high / unit, 4).tolist()}"
            " (stage units)",
            "give a region that overlaps it",
        )
