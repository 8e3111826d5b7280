"""gf-usd bake: the main job."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from gf_usd.cli import exit


def bake(
    asset: Annotated[Path, typer.Argument(help="The asset; it is never written to.")],
    *,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be done and what it would cost.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only errors and JSON.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show the plan first.")] = False,
    **options: Any,
) -> None:
    """Make an asset soft: fill it with particles, let it fall, write layers over it.

    Writes NAME.MATERIAL.usda (open this one), NAME.MATERIAL.cache.usdc and
    NAME.MATERIAL.report.json; the asset itself is left as it is.  A mesh file (obj, ply, stl, off,
    glb, gltf, fbx) also becomes NAME.source.usdc, with NAME.textures/ where pictures were in it.
    """
    from gf_usd.cli.console import announce, progress, show_plan, summarise
    from gf_usd.pipeline.result import require_healthy
    from gf_usd.pipeline.run import prepare, run
    from gf_usd.system.sandbox import parse_limits

    strict, max_hours, slice = (options.pop(name) for name in ("strict", "max_hours", "slice"))
    options["limits"] = parse_limits(options["limits"])
    options["overwrite"] |= dry_run  # which replaces nothing
    plan = prepare(asset, **options)
    exit.watch(plan.outputs.checkpoints)
    if dry_run:
        show_plan(plan, as_json=as_json, max_hours=max_hours)
        return
    if verbose:
        show_plan(plan, err=True, max_hours=max_hours)
    if quiet:
        result = run(plan, max_hours=max_hours, slice=slice)
    else:
        announce(plan)
        with progress(plan) as advance:
            result = run(plan, advance, max_hours=max_hours, slice=slice)
    if as_json:
        typer.echo(json.dumps(result.as_json(), indent=1))
    elif not quiet:
        summarise(result, plan)
    if strict:
        require_healthy(result)
