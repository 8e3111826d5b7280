"""An HTML page that plays the Gaussians of a bake as 3D Gaussian splats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.errors import InputError
from gf_usd.core.matrices import ellipsoids
from gf_usd.core.radiance import Y_0, linear_to_srgb, turned
from gf_usd.core.scene import RenderSplats, to_frame
from gf_usd.core.units import code_text, percent_text
from gf_usd.view.report.html import (
    SHORT,
    SPEEDS,
    Html,
    choice,
    data_script,
    document,
    header,
    json_text,
    scrub_bar,
    tag,
)
from gf_usd.view.report.pack import Packer, add_positions, add_scales
from gf_usd.view.report.record import Record
from gf_usd.view.report.thinning import evenly_spaced, random_subset

MAX_BYTES = 20_000_000  # [bytes] of a page: the usual limit of attachments
MIN_SPLATS = 1000  # Gaussians: at this number frames are omitted instead
SCRIPTS = ("data.js", "camera.js", "steer.js", "player.js", "transport.js", "splats.js")
MIN_AXIS = 0.02  # smallest semi-axis, as a fraction of the median longest one
MAX_SCALE = 2.0  # largest scale factor of drawn Gaussians, which compensates for omitted ones


class Source(Protocol):
    """One variant of a bake, read frame by frame."""

    variant: str
    name: str
    up: tuple[float, float, float]
    rate: float  # time codes per second
    time_codes: tuple[float, ...]

    @property
    def notes(self) -> tuple[str, ...]: ...

    def frames(self, time_codes: Sequence[float]) -> Iterator[tuple[RenderSplats, ...]]: ...


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Upper limits of a page, for each variant."""

    frames: int = 240
    splats: int = 100_000
    size: int = MAX_BYTES  # bytes


@dataclass(frozen=True, kw_only=True)
class SplatRecording:
    """The thinned Gaussians of one variant in meters, world frame; F frames, G Gaussians."""

    source: Source
    time_codes: tuple[float, ...]  # (F,)
    total: int  # Gaussians of the file
    surface: bool  # True: they lie on a surface; False: they fill a body
    positions: NDArray[np.float32]  # (F, G, 3) [m]
    rotations: NDArray[np.float32]  # (F, G, 4) unit quaternions (x, y, z, w), continuous in time
    scales: NDArray[np.float32]  # (F, G, 3) [m]
    colors: NDArray[np.uint8]  # (G, 4) sRGB of degree 0, and the opacity
    harmonics: NDArray[np.float32]  # (G, K, 3) of degrees above 0, world axes, first frame
    framed: NDArray[np.bool_]  # (G,) False: outliers, which the camera need not show
    notes_on_color: tuple[str, ...] = ()  # notes on omitted radiance

    def with_fewer_splats(self, most: int) -> SplatRecording:
        """A random subset of at most `most` Gaussians; deterministic."""
        kept = random_subset(len(self.colors), most)
        return replace(
            self,
            positions=self.positions[:, kept],
            rotations=self.rotations[:, kept],
            scales=self.scales[:, kept],
            colors=self.colors[kept],
            harmonics=self.harmonics[kept],
            framed=self.framed[kept],
        )

    def with_fewer_frames(self, most: int) -> SplatRecording:
        """At most `most` evenly spaced frames."""
        kept = evenly_spaced(len(self.time_codes), most)
        return replace(
            self,
            time_codes=tuple(self.time_codes[i] for i in kept),
            positions=self.positions[kept],
            rotations=self.rotations[kept],
            scales=self.scales[kept],
        )

    @property
    def scale_factor(self) -> float:
        """Scale factor of drawn Gaussians, which compensates for omitted ones."""
        missing = self.total / max(1, len(self.colors))
        return round(min(MAX_SCALE, missing ** (1 / 2 if self.surface else 1 / 3)), 2)


def build_splat_page(sources: Sequence[Source], limits: Limits) -> str:
    """The HTML page of all variants, within the limits.

    Raises InputError for a source without animated Gaussians.
    """
    recordings = [collect(source, limits) for source in sources]
    recordings, packed = _thin_to_size(recordings, limits)
    names = [splats.source.variant for splats in recordings]
    variants = [
        _variant_json(splats, name, table)
        for splats, name, (table, _, _) in zip(recordings, names, packed)
    ]
    body = [
        header(sources[0].name, names, [Record() for _ in recordings]),
        tag(
            "main",
            _player(max(variant["seconds"][-1] for variant in variants)),
            *(
                _describe_content(i, splats, rounding)
                for i, (splats, (_, _, rounding)) in enumerate(zip(recordings, packed))
            ),
        ),
        tag(
            "footer",
            "Space plays and pauses, the arrow keys step, Home and End jump. Drag to rotate, "
            "use the wheel to zoom, drag with Shift or the right button to move, and "
            "double-click to see everything.",
        ),
    ]
    named = " and ".join(name for name in names if name)
    title = f"{sources[0].name}: {named}" if named else sources[0].name
    blobs = [data_script(f"motion-{i}", blob) for i, (_, blob, _) in enumerate(packed)]
    return document(title, body, json_text({"variants": variants}), blobs, SCRIPTS)


def collect(source: Source, limits: Limits) -> SplatRecording:
    """Read and thin a source frame by frame.

    Raises InputError for a source without animated Gaussians.
    """
    if len(source.time_codes) < 2:
        raise InputError(
            f"{source.name} contains no moving Gaussians",
            "give the root layer of a bake, or bake again with gaussians included in --only",
        )
    codes = [source.time_codes[i] for i in evenly_spaced(len(source.time_codes), limits.frames)]
    rows: list[tuple[NDArray[np.float32], ...]] = []
    first: tuple[RenderSplats, ...] = ()
    kept = np.zeros(0, np.int64)
    previous = None
    for sets in source.frames(codes):
        if not first:
            first = sets
            kept = random_subset(sum(len(splats.positions) for splats in sets), limits.splats)
        positions_now = np.concatenate([splats.positions for splats in sets])[kept]
        rotations, scales = ellipsoids(np.concatenate([splats.axes for splats in sets])[kept])
        if previous is not None:
            # q and -q are one rotation; continuity in time compresses better
            rotations *= np.where(
                (rotations * previous).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0
            )
        previous = rotations
        rows.append(
            tuple(np.asarray(array, np.float32) for array in (positions_now, rotations, scales))
        )
    positions, rotations, scales = (np.stack(arrays) for arrays in zip(*rows))
    colors, harmonics, notes_on_color = _split_radiance(first)
    opacities = np.concatenate([splats.opacities for splats in first])
    rgba = np.column_stack([np.clip(colors, 0.0, 1.0), opacities])[kept]
    return SplatRecording(
        source=source,
        time_codes=tuple(codes),
        total=len(opacities),
        surface=not any(splats.lit for splats in first),
        positions=positions,
        rotations=rotations,
        scales=scales,
        colors=np.round(255.0 * rgba).astype(np.uint8),
        harmonics=harmonics[kept].astype(np.float32),
        framed=to_frame(positions[0], opacities[kept]),
        notes_on_color=notes_on_color,
    )


def _split_radiance(
    sets: Sequence[RenderSplats],
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...]]:
    """Colors (N, 3) of degree 0, sRGB, and coefficients (N, K, 3) above it in world axes."""
    colors, harmonics_of_sets, notes_on_color = [], [], {}
    max_coefficients = max(1 if splats.harmonics is None else splats.harmonics.coefficients.shape[1]
                 for splats in sets)  # fmt: skip
    for splats in sets:
        harmonics = np.zeros((len(splats.positions), max_coefficients - 1, 3))
        degree_0 = linear_to_srgb(splats.colors)
        if splats.harmonics is not None and splats.harmonics.srgb:
            h = np.asarray(splats.harmonics.coefficients)
            degree_0 = 0.5 + Y_0 * h[:, 0]
            U, _, Vt = np.linalg.svd(np.linalg.inv(splats.harmonics.frame))
            harmonics[:, : h.shape[1] - 1] = turned(h, U @ Vt)[:, 1:]
        elif splats.harmonics is not None:
            notes_on_color["View-dependent radiance is left out because it is linear."] = None
        colors.append(degree_0)
        harmonics_of_sets.append(harmonics)
    return np.concatenate(colors), np.concatenate(harmonics_of_sets), tuple(notes_on_color)


Packed = tuple[dict[str, dict[str, Any]], str, float]


def _thin_to_size(
    recordings: Sequence[SplatRecording], limits: Limits
) -> tuple[list[SplatRecording], list[Packed]]:
    """Thin the variants until their packed arrays fit into the limit together."""
    current = list(recordings)
    while True:
        packed = [_pack(splats) for splats in current]
        used, most = (
            sum(len(blob) for _, blob, _ in packed),
            max(len(splats.colors) for splats in current),
        )
        limit = limits.size - 60_000
        longest = max(len(splats.time_codes) for splats in current)
        if used <= limit or (most <= MIN_SPLATS and longest <= 2):
            return current, packed
        part = 0.95 * limit / used
        if most > MIN_SPLATS:
            most = max(MIN_SPLATS, min(most - 1, int(part * most)))
            current = [splats.with_fewer_splats(most) for splats in current]
        else:
            longest = max(2, min(longest - 1, int(part * longest)))
            current = [splats.with_fewer_frames(longest) for splats in current]


def _pack(splats: SplatRecording) -> Packed:
    """Array table, blob, and the relative rounding error of the standard deviations."""
    packer = Packer()
    add_positions(packer, "positions", splats.positions)
    packer.add("turns", np.round(splats.rotations * 127.0).astype(np.int8), moving=True)
    middle = float(np.median(splats.scales.max(axis=2)))
    rounding = add_scales(packer, splats.scales, MIN_AXIS * middle)
    packer.add("colors", splats.colors)
    if splats.harmonics.shape[1]:
        step = float(np.abs(splats.harmonics).max()) / 127.0 or 1.0
        packer.add("light", np.round(splats.harmonics / step).astype(np.int8), step=step)
    return packer.table, packer.blob(), rounding


def _variant_json(
    splats: SplatRecording, name: str, table: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    positions_now = splats.positions[:, splats.framed].reshape(-1, 3)
    first = splats.source.time_codes[0]
    return {
        "name": name,
        "codes": [float(code_text(code)) for code in splats.time_codes],
        "seconds": [
            float(f"{(code - first) / splats.source.rate:.6g}") for code in splats.time_codes
        ],
        "up": "Z" if splats.source.up[2] > 0.5 else "Y",
        "low": positions_now.min(axis=0).tolist(),
        "high": positions_now.max(axis=0).tolist(),
        "grow": splats.scale_factor,
        "table": table,
    }


def _player(seconds: float) -> Html:
    speed = "0.5" if seconds < SHORT else "1"
    screen = tag(
        "div",
        tag("canvas", id="canvas", aria_label="the moving Gaussians in 3D"),
        tag("div", id="trouble", hidden=True),
        tag("div", id="clock", class_="over"),
        class_="screen",
    )
    controls = tag(
        "div",
        scrub_bar(),
        tag("label", "speed ", choice("speed", [(s, f"{s}×") for s in SPEEDS], speed)),
        tag(
            "label",
            "size ",
            tag("input", type="range", id="size", min="0.1", max="1.5", step="0.05", value="1"),
        ),
        tag("span", class_="grow"),
        tag("button", "reset view", type="button", id="reset"),
        class_="controls",
    )
    return tag("section", screen, controls, class_="card viewer splats")


def _describe_content(number: int, splats: SplatRecording, rounding: float) -> Html:
    """What the page contains of the bake."""
    counts = (
        ("Gaussians", len(splats.colors), splats.total),
        ("frames", len(splats.time_codes), len(splats.source.time_codes)),
    )
    lines = [
        f"{kept} of {whole} {name}" if kept < whole else f"all {whole} {name}"
        for name, kept, whole in counts
    ]
    if splats.scale_factor > 1.0:
        lines.append(
            f"The rest is left out to keep the page small; the others are drawn "
            f"{splats.scale_factor:g} times as large."
        )
    lines.append(
        "Positions are rounded to 1/65536 of the size of the motion, standard deviations by"
        f" {percent_text(rounding)}, orientations to half a degree."
    )
    notes = [*lines, *splats.notes_on_color, *splats.source.notes]
    card = tag(
        "section",
        tag("h2", "Shown on this page"),
        tag("ul", *(tag("li", line) for line in notes)),
        class_="card",
    )
    return tag("div", card, data_variant=str(number), hidden=number != 0, class_="splat-notes")
