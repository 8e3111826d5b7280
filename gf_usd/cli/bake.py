"""gf-usd bake: the main job."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from gf_usd.bake import BakeResult, Plan


def bake(
    asset: Annotated[Path, typer.Argument(help="The asset; it is never written to.")],
    material: Annotated[
        str, typer.Option("--material", "-m", help="A preset, see gf-usd materials.")
    ] = "rubber",
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", help="Root layer, or a folder if it ends in / or is one.",
            show_default="NAME.MATERIAL.usda in this folder",
        ),
    ] = None,
    particles: Annotated[
        int | None, typer.Option(help="About how many particles.", show_default="8000")
    ] = None,
    spacing: Annotated[
        float | None, typer.Option(help="Distance of particles [stage units].")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(help="How many frames.", show_default="13.6 T of the body")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(help="Frames per second.", show_default="the asset's, else 24"),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(help="First time code.", show_default="the asset's start, else 1"),
    ] = None,
    drop: Annotated[
        str | None,
        typer.Option(
            help="Height of the fall [stage units], or in radii of the body: 3r.",
            show_default="3r, or 0 where the stage holds physics",
        ),
    ] = None,
    gravity: Annotated[
        str | None,
        typer.Option(help="[m/s^2] downward, or x,y,z.", show_default="9.81"),
    ] = None,
    law: Annotated[
        str | None,
        typer.Option(help="corotated or neoHookean.", show_default="the material's"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the random sampling.")] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    threads: Annotated[
        int | None, typer.Option(help="CPU threads.", show_default="all")
    ] = None,
    prim: Annotated[
        list[str] | None,
        typer.Option(help="Prim path to bake, repeatable.", show_default="the default prim"),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be done and what it would cost.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:  # fmt: skip
    """Make an asset soft: fill it with particles, let it fall, write layers over it.

    Writes NAME.MATERIAL.usda (open this one), NAME.MATERIAL.cache.usdc and
    NAME.MATERIAL.report.json; the asset itself is left as it is.
    """
    from gf_usd.bake import prepare, run

    plan = prepare(
        asset, material=material, output=output, law=law, prims=prim or (), overwrite=overwrite,
        particles=particles, spacing=spacing, frames=frames, fps=fps, start=start, drop=drop,
        gravity=gravity, seed=seed, device=device, threads=threads,
    )  # fmt: skip
    if dry_run:
        _show_plan(plan, as_json)
        return
    with _progress(plan) as advance:
        result = run(plan, advance)
    if as_json:
        typer.echo(json.dumps(_result(result), indent=1))
    else:
        _summarise(result)


def _show_plan(plan: Plan, as_json: bool) -> None:
    d = plan.describe()
    if as_json:
        typer.echo(json.dumps(d, indent=1))
        return
    contact = d["first_contact_frame"]
    lines = [
        f"{d['source']}: {len(d['bodies'])} mesh(es), {d['volume_m3']:.4g} m^3,"
        f" radius {d['radius_m']:.4g} m",
        *(f"  {path}" for path in d["bodies"]),
        f"particles   {d['particles']}, {d['spacing_m']:.3g} m apart",
        f"frames      {d['frames']} at {d['fps']:g} fps from time code {d['start']:g}",
        f"substeps    {d['substeps_per_frame']} a frame",
        f"drop        {d['drop_m']:.3g} m, "
        + (f"first contact at frame {contact}" if contact is not None else "no contact"),
        f"time        about {d['estimated_seconds']:.0f} s",
        f"disk        about {_bytes(d['estimated_bytes'])}",
        *(f"would write {path}" for path in d["outputs"]),
        *(f"note: {note}" for note in d["notes"]),
    ]
    typer.echo("\n".join(lines))


@contextmanager
def _progress(plan: Plan) -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal, a plain line every tenth of the way elsewhere; both on stderr."""
    total = plan.settings.frames
    for note in plan.notes:
        typer.echo(f"note: {note}", err=True)
    if not sys.stderr.isatty():
        step = max(1, total // 10)

        def plain(done: int, total: int) -> None:
            if done % step == 0 or done == total:
                typer.echo(f"frame {done}/{total}, {len(plan.particles)} particles", err=True)

        yield plain
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Left

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Left())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(f"{len(plan.particles)} particles", total=total)
        yield lambda done, total: bar.update(task, completed=done)


def _summarise(result: BakeResult) -> None:
    h = result.health
    rebound = "no rebound" if h["restitution"] is None else f"{h['restitution']:.2f}"
    sizes = [(p, p.stat().st_size) for p in (result.root, result.cache, result.report)]
    lines = [
        *(f"{path}  {_bytes(size)}" for path, size in sizes),
        f"{result.frames} frames, {result.particles} particles, {h['substeps']} substeps"
        f" in {result.seconds:.1f} s",
        f"restitution {rebound}, deepest penetration"
        f" {h['deepest_penetration_spacings']:.2f} spacings"
        f" ({h['deepest_penetration_m']:.3g} m), volume ratio J {h['min_J']:.2f} to"
        f" {h['max_J']:.2f}",
    ]
    if h["inverted_particle_frames"]:
        lines.append(
            f"warning: particles were turned inside out in {h['inverted_particle_frames']}"
            " particle-frames (they recover; see the report)"
        )
    if h["rollbacks"]:
        lines.append(f"note: {h['rollbacks']} times a frame was redone with half the step")
    typer.echo("\n".join(lines))


def _result(result: BakeResult) -> dict[str, Any]:
    return {
        "root": str(result.root),
        "cache": str(result.cache),
        "report": str(result.report),
        "frames": result.frames,
        "particles": result.particles,
        "seconds": result.seconds,
        "settings": asdict(result.settings),
        "material": asdict(result.material),
        "health": result.health,
        "notes": list(result.notes),
    }


def _bytes(n: int) -> str:
    for unit in ("B", "kB", "MB"):
        if n < 1000:
            return f"{n:.0f} {unit}"
        n = n / 1000  # type: ignore[assignment]
    return f"{n:.1f} GB"
