"""Output of ``bake``: the plan, the progress, the summary."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from gf_usd.pipeline.result import BakeResult, VariantResult
    from gf_usd.pipeline.run import Prepared
    from gf_usd.prepare.plan import Plan


def show_plan(
    prepared: Prepared, *, max_hours: float, as_json: bool = False, err: bool = False
) -> None:
    """What would be done and what it would cost; max_hours is where `run` refuses."""
    from gf_usd.pipeline.budget import duration, shortcuts
    from gf_usd.prepare.plan import describe

    d = {**describe(prepared.plan), **prepared.cost}
    saved = shortcuts(prepared.cost, prepared.plan.materials)
    if as_json:
        typer.echo(json.dumps(d, indent=1))
        return
    contact = d["first_contact_frame"]
    too_long = d["estimated_seconds"] > 3600.0 * max_hours
    lines = [
        f"{d['source']}: {len(d['bodies'])} mesh(es), {d['volume_m3']:.4g} m^3,"
        f" radius {d['radius_m']:.4g} m",
        *(f"  {path}" for path in d["bodies"]),
        f"particles   {d['particles']}, {d['spacing_m']:.3g} m apart",
        f"frames      {d['frames']} at {d['fps']:g} fps from time code {d['start']:g}",
        "substeps    "
        + ", ".join(f"{n} a frame ({look})" for look, n in d["substeps_per_frame"].items()),
        f"drop        {d['drop_m']:.3g} m, "
        + (f"first contact at frame {contact}" if contact is not None else "no contact"),
        f"time        about {duration(d['estimated_seconds'])}"
        + (f": refused, it is more than --max-hours {max_hours:g}" if too_long else ""),
        f"memory      about {_bytes(d['estimated_memory_bytes'])}",
        f"disk        about {_bytes(d['estimated_bytes'])}",
        *(f"would write {path}" for path in d["outputs"]),
        *(f"note: {note}" for note in (*d["notes"], *saved)),
    ]
    typer.echo("\n".join(lines), err=err)


def announce(prepared: Prepared) -> None:
    """One line on stderr of what is about to be spent, and the notes."""
    from gf_usd.pipeline.budget import duration, shortcuts

    plan, cost = prepared.plan, prepared.cost
    substeps = cost["substeps_per_frame"]
    each = ", ".join(
        f"{n} ({look})" if len(substeps) > 1 else f"{n}" for look, n in substeps.items()
    )
    for note in (*plan.notes, *shortcuts(cost, plan.materials)):
        typer.echo(f"note: {note}", err=True)
    typer.echo(
        f"{len(plan.particles)} particles, {plan.settings.frames} frames, {each} substeps a frame:"
        f" about {duration(cost['estimated_seconds'])} and {_bytes(cost['estimated_bytes'])}",
        err=True,
    )


@contextmanager
def progress(plan: Plan, *, shown: bool) -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal, a plain line every tenth of the way elsewhere; both on stderr."""
    if not shown:
        yield lambda done, total: None
        return
    total = plan.settings.frames * len(plan.materials)
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


def summarize(result: BakeResult, plan: Plan) -> None:
    """Files, sizes and what was measured; what was noted only while it ran."""
    clips = [clip for bake in result.bakes for clip in bake.clips]
    files = [path for path in result.outputs if path.exists() and path not in clips]
    lines = [f"{path}  {_bytes(path.stat().st_size)}" for path in files]
    for folder in dict.fromkeys(clip.parent for clip in clips):
        sizes = [clip.stat().st_size for clip in clips if clip.parent == folder]
        lines.append(f"{folder}/  {len(sizes)} files, {_bytes(sum(sizes))}")
    lines.append(f"{result.particles} particles, {result.seconds:.1f} s")
    lines += [f"note: {note}" for note in result.notes if note not in plan.notes]
    for bake in result.bakes:
        lines.append(_measured(bake))
        lines += [f"warning: {bake.look}: {c.message}\n  hint: {c.hint}" for c in bake.warnings]
    lines += [
        f"check: {f['rule']} <{f['prim']}>: {f['message']}\n  fix: {f['fix']}"
        for f in result.findings
    ]
    typer.echo("\n".join(lines))


def _measured(bake: VariantResult) -> str:
    h = bake.health
    rebound = "no rebound" if h["restitution"] is None else f"restitution {h['restitution']:.2f}"
    overlap = h["deepest_overlap_spacings"]
    met = f", deepest overlap {overlap:.2f} spacings" if overlap else ""
    redone = f", {h['rollbacks']} times a frame was redone" if h["rollbacks"] else ""
    return (
        f"{bake.look}: {bake.frames} frames, {h['substeps']} substeps{redone}, {rebound}, deepest"
        f" penetration {h['deepest_penetration_spacings']:.2f} spacings"
        f" ({h['deepest_penetration_m']:.3g} m){met}, volume ratio J {h['min_J']:.2f} to"
        f" {h['max_J']:.2f}"
    )


def _bytes(n: int) -> str:
    for unit in ("B", "kB", "MB"):
        if n < 1000:
            return f"{n:.0f} {unit}"
        n = n / 1000  # type: ignore[assignment]
    return f"{n:.1f} GB"
