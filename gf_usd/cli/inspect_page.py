"""The text of an inspection, with the verdict last, at the bottom of the terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from gf_usd.cli.console import drop_of, frames_of, landing_of
from gf_usd.core.errors import counted
from gf_usd.core.units import (
    bytes_text,
    code_text,
    length_text,
    number_text,
    percent_text,
    volume_text,
)
from gf_usd.geometry.diagnosis import faults
from gf_usd.pipeline.cost.budget import rough_range
from gf_usd.prepare.asset_size import size

if TYPE_CHECKING:
    from gf_usd.geometry.diagnosis import Diagnosis
    from gf_usd.geometry.thin.parts import Part
    from gf_usd.pipeline.inspect import Inspection


MOST_MESHES, MOST_PARTS, MOST_LINES = 24, 8, 12  # rows shown; --json has all of them
FLAT = 1e-9  # of (area)^(3/2): a volume below it is rounding
FILLS = {  # as shown, by what `Inspection.fill_of` returns
    "filled": "filled",
    "rides along": "[yellow]follows the solid[/]",
    "stays": "[yellow]stays as it is[/]",
    "refused": "[red]refused[/]",
}
PLAIN_WIDTH = 10_000  # columns if the page goes to a file: one line per entry, for grep


def show(seen: Inspection) -> None:
    """Print the page on stdout."""
    terminal = sys.stdout.isatty()
    console = Console(width=None if terminal else PLAIN_WIDTH, highlight=False)
    console.print(f"[bold]{escape(str(seen.asset.facts.path))}[/]")
    _facts(console, seen)
    _meshes(console, seen)
    _body(console, seen)
    _advice(console, seen)
    _parts(console, seen)
    _lines(console, "skipped", _skipped(seen))
    _lines(console, "note", _notes(seen))
    for warning in seen.warnings:
        console.print(f"[yellow]warning:[/] {escape(warning)}")
    if seen.refusal is None:
        console.print("[green]can be baked[/]")


def _facts(console: Console, seen: Inspection) -> None:
    f = seen.asset.facts
    wide = " x ".join(map(number_text, size(seen.asset)))
    codes, frames = f.time_codes_per_second, f.frames_per_second or f.time_codes_per_second
    rate = "no frame rate" if not frames else f"{frames:g} fps"
    if codes != frames:
        rate += f" and {codes:g} time codes per second"
    span = (
        ""
        if f.start_time_code is None or f.end_time_code is None
        else f", {code_text(f.start_time_code)} to {code_text(f.end_time_code)}"
    )
    console.print(
        f"1 unit = {f.units.meters_per_unit:g} m ({_from(f.unit_from)}), {f.up_axis} up"
        f" ({_from(f.axis_from)}), {rate}{span}; {wide} m"
    )


def _from(source: str) -> str:
    return {"file": "from the file", "assumed": "[yellow]assumed[/]", "option": "as requested"}[
        source
    ]


def _meshes(console: Console, seen: Inspection) -> None:
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("mesh", overflow="fold")
    table.add_column("points", justify="right")
    for title in ("faces", "closed", "shells", "volume", "winding", "fill"):
        table.add_column(title)
    rows = seen.diagnoses[:MOST_MESHES]
    for mesh in rows:
        fill = seen.fill_of(mesh.path)[0]
        table.add_row(
            escape(mesh.path),
            str(mesh.points),
            _faces(mesh),
            _closed(mesh),
            str(len(mesh.shells)),
            volume_text(0.0 if mesh.volume <= FLAT * mesh.area**1.5 else mesh.volume),
            _winding(mesh),
            FILLS[fill],
        )
    console.print(table)
    if len(seen.diagnoses) > len(rows):
        more = counted(len(seen.diagnoses) - len(rows), "more mesh", "more meshes")
        console.print(f"and {more} (--json lists all)")


def _faces(mesh: Diagnosis) -> str:
    named = [
        f"{n} {what if n != 1 else what[:-1]}"
        for what, n in mesh.face_sizes.items()
        if n and what != "ngons"
    ]
    ngons = mesh.face_sizes["ngons"]
    if ngons:
        named.append(f"{ngons} n-gon{'' if ngons == 1 else 's'} (to {mesh.largest_face} corners)")
    return ", ".join(named)


def _closed(mesh: Diagnosis) -> str:
    if not mesh.shells:
        return "[red]no face with an area[/]"
    if mesh.watertight:
        return "watertight"
    if not mesh.holes:
        return f"[yellow]{counted(mesh.boundary_edges, 'boundary edge')}[/]"
    share = percent_text(mesh.hole_share)
    return f"[yellow]{counted(len(mesh.holes), 'hole')}, {share} of the area[/]"


def _winding(mesh: Diagnosis) -> str:
    kinds: dict[str, int] = {}
    for shell in mesh.shells:
        kinds[shell.winding] = kinds.get(shell.winding, 0) + 1
    if len(kinds) == 1:
        return next(iter(kinds))
    return ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items(), key=lambda kv: -kv[1]))


def _body(console: Console, seen: Inspection) -> None:
    plan, cost = seen.plan, seen.cost
    if plan is None or cost is None:
        return
    p, s = plan.particles, plan.settings
    forecast = {"frames": s.frames, **cost}
    drop = drop_of(plan, f"drop {length_text(plan.drop)}", "no drop")
    console.print(
        f"\n{len(p)} particles, {length_text(p.spacing)} apart, fill {volume_text(p.volume)}"
        f" (as much as a ball of radius {length_text(p.radius)}); {frames_of(forecast)} at"
        f" {s.fps:g} fps, {drop}, {landing_of(plan, cost)}"
    )
    if (thick := seen.thickness) is not None:
        console.print(
            f"5 % of the surface is at most {length_text(thick.thin)} thick "
            f"({thick.across(p.spacing):.1f} particles across); median {length_text(thick.median)}"
        )
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("material")
    early = cost["ends_early"]
    times = ("usual time", "longest time") if early else ("time (about)",)
    disk = "disk (at most)" if early else "disk (about)"
    for title in ("substeps per frame", *times, "memory (about)", disk):
        table.add_column(title, justify="right")
    for row in cost["per_material"]:
        table.add_row(
            escape(row["name"]), str(row["substeps_per_frame"]),
            *((rough_range(row["usual_seconds"], row["usual_most_seconds"]),) if early else ()),
            rough_range(row["seconds"], row["most_seconds"]),
            bytes_text(row["memory_bytes"]), bytes_text(row["disk_bytes"]),
        )  # fmt: skip
    console.print(table)


def _advice(console: Console, seen: Inspection) -> None:
    if seen.plan is None or not seen.plan.advice:
        return
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("mesh", overflow="fold")
    for title in ("auto", "confidence", "by", "reason"):
        table.add_column(title)
    for one in seen.plan.advice[:MOST_MESHES]:
        sure = f"{one.confidence:.2f}"
        table.add_row(*(escape(t) for t in (one.path, one.material, sure, one.by, one.reason)))
    console.print()
    console.print(table)
    if len(seen.plan.advice) > MOST_MESHES:
        console.print(f"and {len(seen.plan.advice) - MOST_MESHES} more (--json lists all)")


def _parts(console: Console, seen: Inspection) -> None:
    if not seen.parts:
        return
    from gf_usd.geometry.thin.advice import poor_text, specks_note

    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("poorly filled", overflow="fold")
    for title in ("shell", "what", "around (stage units)", "size", "thickness", "particles"):
        table.add_column(title)
    table.add_column("would need", justify="right")
    unit = seen.asset.facts.units.length
    parts = [part for part in seen.parts if not part.speck]
    console.print()
    if specks := specks_note(seen.parts):
        console.print(escape(specks))
    if not parts:
        return
    for part in parts[:MOST_PARTS]:
        table.add_row(*_part(part, unit))
    console.print(table)
    if len(parts) > MOST_PARTS:
        console.print(f"and {len(parts) - MOST_PARTS} more (--json lists all)")
    assert seen.plan is not None  # of which they are parts
    console.print(f"such parts contain {poor_text(parts, len(seen.plan.particles))}")


def _part(part: Part, unit: float) -> Sequence[str]:
    return (
        escape(part.path), str(part.shell), f"[yellow]{part.kind}[/]",
        ", ".join(f"{c / unit:.3g}" for c in part.center), length_text(part.size),
        "none: loose faces" if part.loose else length_text(part.thickness), str(part.particles),
        "too many" if part.suggested is None else str(part.suggested),
    )  # fmt: skip


def _skipped(seen: Inspection) -> list[str]:
    """Prims that are not baked, those of one reason together: a robot has many colliders."""
    from gf_usd.prepare.fill.notes import by_reason

    return [
        f"<{path}>{f' and {more} more' if more else ''}: {why}"
        for path, more, why in by_reason(seen.asset.skipped)
    ]


def _notes(seen: Inspection) -> list[str]:
    """Notes that the page does not show elsewhere, and harmless oddities of the meshes."""
    from gf_usd.prepare.fill.notes import advice_notes, not_baked_notes

    left = set(not_baked_notes(seen.asset.skipped))
    left |= set(advice_notes(seen.plan.advice if seen.plan else ()))
    notes = [note for note in seen.notes if note not in left]
    for mesh in seen.diagnoses:
        odd = [
            f"{n} {what}"
            for n, what in (
                (mesh.collapsed, "collapsed triangles"),
                (mesh.slivers, "triangles without area"),
                (mesh.non_manifold_edges, "edges shared by more than two triangles"),
                (mesh.loose_edges, "boundary edges outside closed loops"),
            )
            if n
        ]
        if seen.plan is None and (wrong := faults(mesh)):
            notes.append(f"<{mesh.path}> has {', '.join(wrong)}")
        elif odd:
            harmless = ", which do not affect the fill" if seen.plan else ""
            notes.append(f"<{mesh.path}> has {', '.join(odd)}{harmless}")
    return [*notes, *seen.shortcuts]


def _lines(console: Console, what: str, lines: Sequence[str]) -> None:
    for line in lines[:MOST_LINES]:
        console.print(f"[dim]{what}:[/] {escape(line)}")
    if len(lines) > MOST_LINES:
        console.print(f"[dim]{what}:[/] and {len(lines) - MOST_LINES} more (--json lists all)")
