"""gf-usd bake: the main job."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gf_usd.cli import exit
from gf_usd.cli.events import STDOUT, event_stream
from gf_usd.cli.help import HelpAll
from gf_usd.cli.quiet import QuietExceptJson
from gf_usd.cli.worker import read_ahead
from gf_usd.core import __version__
from gf_usd.core.errors import UsageError

if TYPE_CHECKING:
    from gf_usd.pipeline.cost.forecast import Activity
    from gf_usd.pipeline.prepared import Prepared
    from gf_usd.pipeline.result import BakeResult


def bake(
    asset: Annotated[Path, typer.Argument(help="The asset file; it is never modified.")],
    *,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="Show what the bake would do and what it would cost, without baking."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    events: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-|N",
            help="Write events to this file, one JSON object per line; - is stdout, a number is"
            " an open file descriptor.",
            show_default="none",
        ),
    ] = None,
    quiet: QuietExceptJson = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print the plan before baking.")
    ] = False,
    serve: Annotated[
        bool,
        typer.Option(
            "--serve",
            help="Bake in a warm process of a running gf-usd serve, which saves start-up time.",
        ),
    ] = False,
    help_all: HelpAll = False,
    **options: Any,
) -> None:
    """Turn an asset into a soft body: fill it with particles, simulate it, and write USD layers.

    Writes NAME.MATERIAL.usda (open this one), NAME.MATERIAL.cache.usdc and
    NAME.MATERIAL.report.json; the asset file does not change.  A mesh file (obj, ply, stl, off,
    glb, gltf, fbx) is also converted to NAME.source.usdc, and its packed textures are written to
    NAME.textures/.  With --max-edge-length the divided meshes are in NAME.MATERIAL.source.usdc.
    """
    if as_json and events == STDOUT:
        raise UsageError(
            "--json and --events - would both write to stdout", "give a file with --events"
        )
    if serve:
        if dry_run or verbose:
            raise UsageError("--serve cannot show a plan", "leave out --dry-run and --verbose")
        from gf_usd.cli.serve import bake_by_server

        bake_by_server(asset, options, as_json=as_json, quiet=quiet, events=events)
        return
    from gf_usd.system.sandbox import parse_limits

    options["limits"] = parse_limits(options["limits"])
    if options["limits"] is not None:
        read_ahead()
    from gf_usd.cli.console import announce, progress, show_plan, summarize
    from gf_usd.pipeline.measures.refine import Refining
    from gf_usd.pipeline.prepared import prepare
    from gf_usd.pipeline.result import require_healthy
    from gf_usd.pipeline.run.run import run

    taken = ("strict", "max_hours", "slice", "until")
    strict, max_hours, slice, until = (options.pop(name) for name in taken)
    options["overwrite"] |= dry_run  # which replaces nothing
    refining = Refining(until, max_hours, options)
    shown = not quiet and not dry_run
    with event_stream(events) as emit:
        emit("started", asset=str(asset), version=__version__, pid=os.getpid())
        printed: list[str] = []

        def remark(text: str) -> None:
            printed.append(text)
            emit("note", message=text)
            if not quiet:
                typer.echo(f"note: {text}", err=True)

        with progress(shown=shown) as show:
            while True:
                prepared = prepare(asset, watch=show, **refining.options)
                plan = prepared.plan
                exit.watch(plan.outputs.checkpoints, plan.outputs.root)
                if events is not None:
                    _emit_plan(emit, prepared)
                if dry_run:
                    if as_json or events != STDOUT:
                        show_plan(prepared, as_json=as_json, max_hours=max_hours)
                    return
                if verbose:
                    show_plan(prepared, err=True, max_hours=max_hours)
                if not quiet:
                    announce(prepared)
                on_frame = partial(_emit_frame, emit, len(plan.particles))
                result = run(
                    prepared, on_frame, max_hours=refining.hours, slice=slice, remark=remark,
                    watch=show,
                )  # fmt: skip
                again = refining.bake_again(result, plan.asset.facts.units.length)
                for text in refining.notes[-1:]:
                    remark(text)
                if not again:
                    break
            result = replace(result, notes=(*result.notes, *refining.notes))
            if plan.outputs.sheet:
                _draw_sheet(result, plan.outputs.sheet, show)
        new = [note for note in result.notes[len(plan.notes) :] if note not in printed]
        _emit_result(emit, result, new)
        if as_json:
            typer.echo(json.dumps(result.as_json(), indent=1))
        elif not quiet and events != STDOUT:
            summarize(result, plan, show.text())
        require_healthy(result, strict=strict)


def _emit_plan(emit: Callable[..., None], prepared: Prepared) -> None:
    """What will be baked, its cost, and notes on it."""
    from gf_usd.prepare.plan import describe

    emit("plan", **describe(prepared.plan), **prepared.cost)
    for note in prepared.plan.notes:
        emit("note", message=note)


def _emit_result(emit: Callable[..., None], result: BakeResult, notes: Sequence[str]) -> None:
    """The result, after its warnings and those of its notes that were not emitted before."""
    from gf_usd.pipeline.health.warnings import warnings_json

    for note in notes:
        emit("note", message=note)
    for warning in warnings_json(result.warnings):
        emit("warning", **warning)
    emit("finished", **result.as_json())


def _draw_sheet(result: BakeResult, sheet: Path, show: Callable[[Activity], None]) -> None:
    """The contact sheet of --material-sweep."""
    from gf_usd.api.drawing.sweep import draw_sweep
    from gf_usd.pipeline.cost.forecast import DRAWING, Activity

    show(Activity(stage=DRAWING, what=sheet.name))
    draw_sweep(result, sheet)


def _emit_frame(emit: Callable[..., None], particles: int, done: int, total: int) -> None:
    emit("frame", done=done, total=total, particles=particles)
