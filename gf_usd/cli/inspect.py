"""gf-usd inspect: what would be baked, and what is wrong with it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from gf_usd.cli.options import (
    Combine,
    Drop,
    Fps,
    Frames,
    LimitsOf,
    Material,
    MaterialBoxes,
    MaterialLabels,
    MetersPerUnit,
    Particles,
    Prims,
    Seed,
    Solver,
    Spacing,
    Start,
    UpAxis,
)
from gf_usd.core.errors import InputError


def inspect(
    asset: Annotated[Path, typer.Argument(help="The asset; nothing is written.")],
    material: Material = None,
    particles: Particles = None,
    spacing: Spacing = None,
    frames: Frames = None,
    fps: Fps = None,
    start: Start = None,
    drop: Drop = None,
    prim: Prims = None,
    material_box: MaterialBoxes = None,
    material_label: MaterialLabels = None,
    meters_per_unit: MetersPerUnit = None,
    up_axis: UpAxis = None,
    combine: Combine = False,
    solver: Solver = None,
    seed: Seed = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Show what bake --repair would do.")
    ] = False,
    limits: LimitsOf = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
) -> None:  # fmt: skip
    """Look before you bake: meshes, holes, units, thin parts, particles, time, memory, disk.

    Exit status 0 if the asset can be baked, 3 if bake would refuse it, with the same words.
    """
    from gf_usd.pipeline.inspect import inspect as inspect_asset
    from gf_usd.system.sandbox import parse_limits

    bounds = parse_limits(limits)
    try:
        seen = inspect_asset(
            asset, material=material, prims=prim or (), repair=repair,
            meters_per_unit=meters_per_unit, up_axis=up_axis, particles=particles,
            spacing=spacing, frames=frames, fps=fps, start=start, drop=drop, solver=solver,
            seed=seed, combine=combine, material_boxes=tuple(material_box or ()),
            material_labels=tuple(material_label or ()), limits=bounds,
        )  # fmt: skip
    except InputError as error:
        if as_json:
            out = {"file": str(asset), "bakeable": False}
            out["refusal"] = {"message": error.message, "hint": error.hint}
            typer.echo(json.dumps(out, indent=1))
        raise
    if as_json:
        typer.echo(json.dumps(seen.as_json(), indent=1))
    else:
        from gf_usd.cli.inspect_page import show

        show(seen)
    if seen.refusal is not None:
        raise seen.refusal
