"""The HTML report of a bake: one self-contained page with a player, plots and tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from gf_usd.core.scene import MotionFrame, Recording
from gf_usd.core.units import code_text
from gf_usd.view.compare import Comparison
from gf_usd.view.report.curves import LENGTHS, Plot, comparison_plots, plots, unit_for
from gf_usd.view.report.html import (
    Html,
    data_script,
    document,
    header,
    json_text,
    tables,
    tag,
    viewer,
)
from gf_usd.view.report.moments import bounds, camera_for, choose_key_frames, render_pictures
from gf_usd.view.report.motion import Motion, collect
from gf_usd.view.report.pack import pack
from gf_usd.view.report.record import Record, make_record
from gf_usd.view.report.thinning import evenly_spaced

MAX_BYTES = 20_000_000  # [bytes] of a page: the usual limit of attachments
SCRIPTS = ("data.js", "camera.js", "steer.js", "shaders.js", "draw.js", "viewer.js", "player.js",
           "transport.js", "plots.js", "main.js")  # fmt: skip
MIN_VERTICES = 1500  # vertices or Gaussians: at this number frames are omitted instead
CELLS = 12  # approximate number of cells of the floor grid across the motion


class Source(Protocol):
    """One variant of a bake, read frame by frame."""

    def recording(self) -> Recording: ...

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]: ...


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Upper limits of a page, for each variant."""

    frames: int = 240
    vertices: int = 20_000  # of meshes, and number of Gaussians
    size: int = MAX_BYTES  # bytes


def build_report(
    sources: Sequence[Source], report: Mapping[str, Any], why_empty: str, limits: Limits
) -> str:
    """The HTML page of all variants, within the limits.

    Parameters
    ----------
    sources : one for each variant.
    report, why_empty : from `record.load_report`.
    """
    records = [make_record(source.recording(), report, why_empty) for source in sources]
    return _build_page(sources, records, [source.recording().variant for source in sources], limits)


def build_comparison(
    sources: Sequence[Source],
    reports: Sequence[tuple[Mapping[str, Any], str]],
    names: tuple[str, str],
    found: Comparison,
    limits: Limits,
) -> str:
    """The HTML page of two compared motions, with a switch between them.

    Parameters
    ----------
    reports : of each, as for `build_report`.
    names : of each, for the page.
    found : is plotted above the plots of both.
    """
    records = [make_record(s.recording(), *report) for s, report in zip(sources, reports)]
    return _build_page(sources, records, names, limits, comparison_plots(found, names))


def _build_page(
    sources: Sequence[Source],
    records: Sequence[Record],
    names: Sequence[str],
    limits: Limits,
    extra_plots: Sequence[Plot] = (),
) -> str:
    recordings = [source.recording() for source in sources]
    pictures_of_variants = []
    plotly = _read_plotly()
    bytes_left = limits.size - len(plotly.encode("utf-8")) - 60_000 - 150_000 * len(sources)
    motions, packed = _thin_to_size(sources, recordings, limits, bytes_left)
    for source, recording, motion in zip(sources, recordings, motions):
        key_frames = choose_key_frames(motion)
        codes = [motion.time_codes[frame] for frame, _ in key_frames]
        uris = render_pictures(recording, source.frames(codes), camera_for(motion))
        captions = [
            code_text(code) + (f" · {w}" if w else "") for code, (_, w) in zip(codes, key_frames)
        ]
        pictures_of_variants.append(
            [(f, w, uri) for (f, _), w, uri in zip(key_frames, captions, uris)]
        )
    cell = _grid_cell(motions[0])
    variants = [
        _variant_json(motion, name, record, table, cell, extra_plots)
        for motion, name, record, (table, _) in zip(motions, names, records, packed)
    ]
    seconds = max(variant["seconds"][-1] for variant in variants)
    body = [
        header(recordings[0].name, names, records),
        tag(
            "main",
            tag(
                "div",
                viewer(
                    pictures_of_variants,
                    seconds,
                    _format_length(cell) if recordings[0].ground is not None else "",
                ),
                tag("div", id="plots"),
                class_="stage",
            ),
            *(
                tables(i, record, _describe_content(motion), motion.recording.notes)
                for i, (record, motion) in enumerate(zip(records, motions))
            ),
        ),
        _page_footer(records),
    ]
    blobs = [data_script(f"motion-{i}", blob) for i, (_, blob) in enumerate(packed)]
    variant_names = " and ".join(name for name in names if name)
    title = f"{recordings[0].name}: {variant_names}" if variant_names else recordings[0].name
    return document(title, body, json_text({"variants": variants}), blobs, SCRIPTS, [plotly])


def _thin_to_size(
    sources: Sequence[Source], recordings: Sequence[Recording], limits: Limits, bytes_left: int
) -> tuple[list[Motion], list[tuple[dict[str, dict[str, Any]], str]]]:
    """Thin the variants until their packed arrays fit into `bytes_left` together."""
    current = limits
    while True:
        motions = []
        for source, recording in zip(sources, recordings):
            kept = evenly_spaced(len(recording.time_codes), current.frames)
            frames = source.frames([recording.time_codes[i] for i in kept])
            motions.append(collect(recording, frames, current.vertices, current.vertices))
        packed = [pack(motion) for motion in motions]
        used = sum(len(blob) for _, blob in packed)
        if used <= bytes_left or (current.vertices <= MIN_VERTICES and current.frames <= 2):
            return motions, packed
        # below the estimate, so that one repetition is usually enough
        current = _tighter_limits(motions, current, 0.93 * bytes_left / used)


def _tighter_limits(motions: Sequence[Motion], limits: Limits, part: float) -> Limits:
    """Limits for about `part` of the bytes: fewer vertices and Gaussians, then fewer frames."""
    most = max(max(len(m.mesh.kept), len(m.gaussian_indices), _flow_vertices(m)) for m in motions)
    if most > MIN_VERTICES:
        return replace(limits, vertices=max(MIN_VERTICES, min(most - 1, int(part * most))))
    frames = max(len(m.time_codes) for m in motions)
    return replace(
        limits, vertices=MIN_VERTICES, frames=max(2, min(frames - 1, int(part * frames)))
    )


def _flow_vertices(motion: Motion) -> int:
    """Largest number of vertices of flowing material in a frame."""
    return 0 if motion.flow is None else int(np.diff(motion.flow.starts[:, 0]).max(initial=0))


def _variant_json(
    motion: Motion,
    name: str,
    record: Record,
    table: dict[str, dict[str, Any]],
    cell: float,
    extra_plots: Sequence[Plot],
) -> dict[str, Any]:
    recording = motion.recording
    low, high = bounds(motion)
    return {
        "name": name,
        "codes": [float(code_text(code)) for code in motion.time_codes],
        "seconds": [float(f"{recording.seconds(code):.6g}") for code in motion.time_codes],
        "up": "Z" if recording.up[2] > 0.5 else "Y",
        "ground": recording.ground,
        "low": list(low),
        "high": list(high),
        "cell": cell,
        "grow": _gaussian_scale(motion),
        "table": table,
        "plots": [*extra_plots, *plots(motion, record)],
    }


def _grid_cell(motion: Motion) -> float:
    """Size [m] of a cell of the floor's grid: 1, 2 or 5 times a power of ten."""
    low, high = bounds(motion)
    size = max(math.dist(low, high), 1e-9) / CELLS
    power = 10.0 ** math.floor(math.log10(size))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= size * 0.999)


def _gaussian_scale(motion: Motion) -> float:
    """Scale factor of drawn Gaussians, which compensates for omitted ones."""
    if not len(motion.gaussian_indices):
        return 1.0
    return round(
        min(2.0, (len(motion.recording.gaussians or ()) / len(motion.gaussian_indices)) ** (1 / 3)),
        2,
    )


def _format_length(length: float) -> str:
    factor = unit_for([length * (1.0 + 1e-9)], LENGTHS)
    return f"{length / factor:.3g} {dict(LENGTHS)[factor]}"


def _describe_content(motion: Motion) -> list[str]:
    """What the page contains of the bake, as lines of text."""
    recording, mesh = motion.recording, motion.mesh
    counts = [("frames", len(motion.time_codes), len(recording.time_codes))]
    if mesh.vertices:
        counts.append(("mesh vertices", len(mesh.kept), mesh.vertices))
        counts.append(("triangles", len(mesh.corners), mesh.triangles))
    if motion.flow is not None:
        kept, whole = len(motion.flow.points), motion.flow.vertices
        counts.append(("vertices of flowing surfaces, over all frames", kept, whole))
    if recording.gaussians is not None:
        counts.append(("Gaussians", len(motion.gaussian_indices), len(recording.gaussians)))
    thinned = any(kept < whole for _, kept, whole in counts)
    lines = [
        f"{kept} of {whole} {name}" if kept < whole else f"all {whole} {name}"
        for name, kept, whole in counts
    ]
    lines.append(
        "The rest is left out to keep the page small. The curves of points, surface and "
        "Gaussians include all of them at the frames shown; those of energy and particles "
        "include every frame."
        if thinned
        else "Nothing was left out."
    )
    lines.append(
        "Positions are rounded to 1/65536 of the size of the motion. Textures are shown as one "
        "color per corner."
    )
    if recording.gaussians is not None:
        drawn = "A Gaussian is drawn as its ellipsoid at one standard deviation"
        grow = _gaussian_scale(motion)
        lines.append(
            f"{drawn}, {grow:g} times as large to fill the gaps." if grow > 1 else f"{drawn}."
        )
    return lines


def _page_footer(records: Sequence[Record]) -> Html:
    version = next((r.version for r in records if r.version), "")
    source = next((r.source for r in records if r.source), "")
    baked = f"Baked by gf-usd {version}. " if version else ""
    of = f"Source: {source.replace(chr(92), '/').rsplit('/', 1)[-1]}. " if source else ""
    keys = (
        "Space plays and pauses, the arrow keys step, Home and End jump. Drag to rotate, use the"
        " wheel to zoom, drag with Shift or the right button to move, and double-click to see"
        " everything."
    )
    return tag("footer", f"{baked}{of}{keys}")


def _read_plotly() -> str:
    """plotly.js from its Python package, so that the page needs no network."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()
