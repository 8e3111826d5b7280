"""A page that plays the Gaussians of a bake, sorted and blended as 3D Gaussian splats."""

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
from gf_usd.view.report.pack import Packer, add_places, add_scales
from gf_usd.view.report.record import Record
from gf_usd.view.report.surface import sample, spread

LARGEST = 20_000_000  # bytes of a page: what a mail or a chat still takes
FEWEST = 1000  # Gaussians: below that frames are left out instead
SCRIPTS = ("data.js", "camera.js", "steer.js", "player.js", "transport.js", "splats.js")
THIN = 0.02  # of the median longest axis: an axis that is shorter is drawn as long as that
GROWN = 2.0  # Gaussians are drawn that much larger at most where others are left out


class Source(Protocol):
    """One variant that can be read."""

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
    """What a page holds at most, of each variant."""

    frames: int = 240
    splats: int = 100_000
    size: int = LARGEST  # bytes


@dataclass(frozen=True, kw_only=True)
class Played:
    """The Gaussians of one variant as a page keeps them; F frames, G Gaussians, meters, world."""

    source: Source
    time_codes: tuple[float, ...]  # (F,) of the frames that are kept
    total: int  # Gaussians of the file
    surface: bool  # they lie on a surface, else they fill a body
    positions: NDArray[np.float32]  # (F, G, 3) [m]
    turns: NDArray[np.float32]  # (F, G, 4) (x, y, z, w) unit, continuous in time
    scales: NDArray[np.float32]  # (F, G, 3) [m]
    colors: NDArray[np.uint8]  # (G, 4) sRGB of degree 0, and the opacity
    light: NDArray[np.float32]  # (G, K, 3) of the degrees above 0 in world axes, first frame
    framed: NDArray[np.bool_]  # (G,) False for strays, which the camera does not look for
    said: tuple[str, ...] = ()  # what was left out of the colors

    def fewer(self, most: int) -> Played:
        """At most that many Gaussians, chosen at random, the same every time."""
        kept = sample(len(self.colors), most)
        return replace(
            self,
            positions=self.positions[:, kept],
            turns=self.turns[:, kept],
            scales=self.scales[:, kept],
            colors=self.colors[kept],
            light=self.light[kept],
            framed=self.framed[kept],
        )

    def shorter(self, most: int) -> Played:
        """At most that many frames, evenly spread."""
        kept = spread(len(self.time_codes), most)
        return replace(
            self,
            time_codes=tuple(self.time_codes[i] for i in kept),
            positions=self.positions[kept],
            turns=self.turns[kept],
            scales=self.scales[kept],
        )

    @property
    def grow(self) -> float:
        """How much larger Gaussians are drawn where some are left out, to fill the gaps."""
        missing = self.total / max(1, len(self.colors))
        return round(min(GROWN, missing ** (1 / 2 if self.surface else 1 / 3)), 2)


def build_splat_page(sources: Sequence[Source], limits: Limits) -> str:
    """The page as text, every variant in it, no larger than the limits say.

    Raises InputError where a source has no Gaussians that move.
    """
    played = [collect(source, limits) for source in sources]
    played, packed = _fit(played, limits)
    names = [one.source.variant for one in played]
    variants = [
        _variant(one, name, table) for one, name, (table, _, _) in zip(played, names, packed)
    ]
    body = [
        header(sources[0].name, names, [Record() for _ in played]),
        tag(
            "main",
            _viewer(max(variant["seconds"][-1] for variant in variants)),
            *(
                _shown(i, one, rounding)
                for i, (one, (_, _, rounding)) in enumerate(zip(played, packed))
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


def collect(source: Source, limits: Limits) -> Played:
    """Read a source, one whole frame at a time.

    Raises InputError where it has no Gaussians that move.
    """
    if len(source.time_codes) < 2:
        raise InputError(
            f"{source.name} contains no moving Gaussians.",
            "give the root layer of a bake, or bake again with gaussians included in --only",
        )
    codes = [source.time_codes[i] for i in spread(len(source.time_codes), limits.frames)]
    rows: list[tuple[NDArray[np.float32], ...]] = []
    first: tuple[RenderSplats, ...] = ()
    kept = np.zeros(0, np.int64)
    last = None
    for sets in source.frames(codes):
        if not first:
            first = sets
            kept = sample(sum(len(one.positions) for one in sets), limits.splats)
        at = np.concatenate([one.positions for one in sets])[kept]
        turns, scales = ellipsoids(np.concatenate([one.axes for one in sets])[kept])
        if last is not None:
            # q and -q are one rotation: the nearer to the last frame's packs better
            turns *= np.where((turns * last).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        last = turns
        rows.append(tuple(np.asarray(array, np.float32) for array in (at, turns, scales)))
    positions, turns, scales = (np.stack(arrays) for arrays in zip(*rows))
    colors, light, said = _radiance(first)
    opacities = np.concatenate([one.opacities for one in first])
    rgba = np.column_stack([np.clip(colors, 0.0, 1.0), opacities])[kept]
    return Played(
        source=source,
        time_codes=tuple(codes),
        total=len(opacities),
        surface=not any(one.lit for one in first),
        positions=positions,
        turns=turns,
        scales=scales,
        colors=np.round(255.0 * rgba).astype(np.uint8),
        light=light[kept].astype(np.float32),
        framed=to_frame(positions[0], opacities[kept]),
        said=said,
    )


def _radiance(
    sets: Sequence[RenderSplats],
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...]]:
    """Colors (N, 3) of degree 0, sRGB, and coefficients (N, K, 3) above it in world axes."""
    colors, lights, said = [], [], {}
    widest = max(1 if one.harmonics is None else one.harmonics.coefficients.shape[1]
                 for one in sets)  # fmt: skip
    for one in sets:
        light = np.zeros((len(one.positions), widest - 1, 3))
        base = linear_to_srgb(one.colors)
        if one.harmonics is not None and one.harmonics.srgb:
            h = np.asarray(one.harmonics.coefficients)
            base = 0.5 + Y_0 * h[:, 0]
            U, _, Vt = np.linalg.svd(np.linalg.inv(one.harmonics.frame))
            light[:, : h.shape[1] - 1] = turned(h, U @ Vt)[:, 1:]
        elif one.harmonics is not None:
            said["View-dependent radiance is left out because it is linear."] = None
        colors.append(base)
        lights.append(light)
    return np.concatenate(colors), np.concatenate(lights), tuple(said)


Packed = tuple[dict[str, dict[str, Any]], str, float]


def _fit(played: Sequence[Played], limits: Limits) -> tuple[list[Played], list[Packed]]:
    """Thin the variants until their blobs fit together."""
    now = list(played)
    while True:
        packed = [_pack(one) for one in now]
        used, most = sum(len(blob) for _, blob, _ in packed), max(len(one.colors) for one in now)
        left = limits.size - 60_000
        longest = max(len(one.time_codes) for one in now)
        if used <= left or (most <= FEWEST and longest <= 2):
            return now, packed
        part = 0.95 * left / used
        if most > FEWEST:
            most = max(FEWEST, min(most - 1, int(part * most)))
            now = [one.fewer(most) for one in now]
        else:
            longest = max(2, min(longest - 1, int(part * longest)))
            now = [one.shorter(longest) for one in now]


def _pack(one: Played) -> Packed:
    """Table of contents, blob, and the relative error of the standard deviations."""
    packer = Packer()
    add_places(packer, "positions", one.positions)
    packer.add("turns", np.round(one.turns * 127.0).astype(np.int8), moving=True)
    middle = float(np.median(one.scales.max(axis=2)))
    rounding = add_scales(packer, one.scales, THIN * middle)
    packer.add("colors", one.colors)
    if one.light.shape[1]:
        step = float(np.abs(one.light).max()) / 127.0 or 1.0
        packer.add("light", np.round(one.light / step).astype(np.int8), step=step)
    return packer.table, packer.blob(), rounding


def _variant(one: Played, name: str, table: dict[str, dict[str, Any]]) -> dict[str, Any]:
    at = one.positions[:, one.framed].reshape(-1, 3)
    first = one.source.time_codes[0]
    return {
        "name": name,
        "codes": [float(f"{code:.8g}") for code in one.time_codes],
        "seconds": [float(f"{(code - first) / one.source.rate:.6g}") for code in one.time_codes],
        "up": "Z" if one.source.up[2] > 0.5 else "Y",
        "low": at.min(axis=0).tolist(),
        "high": at.max(axis=0).tolist(),
        "grow": one.grow,
        "table": table,
    }


def _viewer(seconds: float) -> Html:
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


def _shown(number: int, one: Played, rounding: float) -> Html:
    """What the page holds of the bake, with the numbers."""
    counts = (
        ("Gaussians", len(one.colors), one.total),
        ("frames", len(one.time_codes), len(one.source.time_codes)),
    )
    lines = [
        f"{kept} of {whole} {name}" if kept < whole else f"all {whole} {name}"
        for name, kept, whole in counts
    ]
    if one.grow > 1.0:
        lines.append(
            f"The rest is left out to keep the page small; the others are drawn {one.grow:g} "
            f"times as large."
        )
    lines.append(
        "Positions are rounded to 1/65536 of the size of the motion, standard deviations by"
        f" {100.0 * rounding:.2g} %, orientations to half a degree."
    )
    notes = [*lines, *one.said, *one.source.notes]
    card = tag(
        "section",
        tag("h2", "Shown on this page"),
        tag("ul", *(tag("li", line) for line in notes)),
        class_="card",
    )
    return tag("div", card, data_variant=str(number), hidden=number != 0, class_="said")
