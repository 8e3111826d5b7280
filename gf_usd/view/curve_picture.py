"""Curves as a picture: panels one below the other, for results that have no page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from gf_usd.core.arrays import Floats
from gf_usd.system.atomic_files import publish_bytes
from gf_usd.view.legend import FAINT, INK, font, prefix, ticks, written

WIDTH, HEIGHT = 760, 260  # [pixels] of a panel
LEFT, RIGHT, TOP, BOTTOM = 86, 20, 34, 40  # [pixels] around the curves
LETTER = 14
GRID = (225, 227, 230)
COLORS = {"start": (160, 166, 174), "fit": (214, 84, 46), "target": (27, 106, 171)}
DOT = 3  # [pixels] radius
DOTS = 60  # on a curve at most


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Values over time."""

    kind: str  # of COLORS
    x: Floats  # (n,) [s]
    y: Floats  # (n,)
    dots: bool = False  # single values, without a line


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Curves of one unit over one time line."""

    title: str
    unit: str
    curves: Sequence[Curve]


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Numbers next to their targets, a line each."""

    title: str
    rows: Sequence[tuple[str, float, float, float]]  # words; target, start and fit over its sigma
    words: Sequence[str]  # to the right of each


def write_panels(path: Path, panels: Sequence[Panel | Rows]) -> Path:
    """Write the panels as a PNG; returns path.  Raises BakeError where the disk refuses."""
    parts = [_rows(one) if isinstance(one, Rows) else _curves(one) for one in panels]
    whole = Image.new("RGB", (WIDTH, sum(part.height for part in parts)), "white")
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height
    data = BytesIO()
    whole.save(data, format="PNG")
    return publish_bytes(path, data.getvalue())


def _curves(panel: Panel) -> Image.Image:
    image = Image.new("RGB", (WIDTH, HEIGHT), "white")
    draw = ImageDraw.Draw(image)
    known = [curve for curve in panel.curves if np.isfinite(curve.y).any()]
    x = np.concatenate([curve.x for curve in known])
    y = np.concatenate([curve.y[np.isfinite(curve.y)] for curve in known])
    divisor, unit = prefix(float(np.abs(y).max()), panel.unit)
    low, high = float(y.min()) / divisor, float(y.max()) / divisor
    margin = 0.06 * (high - low) or 0.5
    box = (float(x.min()), float(x.max()), low - margin, high + margin)
    _axes(draw, box, f"{panel.title} [{unit}]" if unit else panel.title)
    for curve in known:
        at = _pixels(box, curve.x, curve.y / divisor)
        color = COLORS[curve.kind]
        if curve.dots:
            for px, py in at[:: max(1, len(at) // DOTS)]:
                draw.ellipse((px - DOT, py - DOT, px + DOT, py + DOT), outline=color, width=2)
        else:
            draw.line([tuple(point) for point in at], fill=color, width=2)
    _key(draw, [curve.kind for curve in known])
    return image


def _axes(draw: ImageDraw.ImageDraw, box: tuple[float, float, float, float], title: str) -> None:
    words = font(LETTER)
    left, right, low, high = box
    draw.text((LEFT, 8), title, INK, words)
    for value in ticks(low, high):
        (x, y), (end, _) = _pixels(box, np.array([left, right]), np.array([value, value]))
        draw.line((x, y, end, y), fill=GRID)
        text = written(value)
        draw.text((LEFT - 8 - draw.textlength(text, words), y - 9), text, FAINT, words)
    for value in ticks(left, right, 7):
        x = _pixels(box, np.array([value]), np.array([low]))[0, 0]
        draw.line((x, HEIGHT - BOTTOM, x, HEIGHT - BOTTOM + 4), fill=FAINT)
        text = f"{written(value)} s"
        draw.text((x - 0.5 * draw.textlength(text, words), HEIGHT - BOTTOM + 8), text, FAINT, words)


def _pixels(box: tuple[float, float, float, float], x: Floats, y: Floats) -> Floats:
    left, right, low, high = box
    wide, tall = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    px = LEFT + wide * (x - left) / ((right - left) or 1.0)
    py = TOP + tall * (high - y) / ((high - low) or 1.0)
    return np.stack([px, py], axis=-1)


def _key(draw: ImageDraw.ImageDraw, kinds: Sequence[str]) -> None:
    """The names of the curves, in the upper right corner."""
    words, right = font(LETTER), float(WIDTH - RIGHT)
    for kind in dict.fromkeys(reversed(kinds)):
        right -= draw.textlength(kind, words)
        draw.text((right, 8), kind, COLORS[kind], words)
        right -= 18


def _rows(panel: Rows) -> Image.Image:
    """Start and fit of each number over the standard deviation of its target, which is at 0."""
    words, line = font(LETTER), 30
    image = Image.new("RGB", (WIDTH, TOP + line * len(panel.rows) + BOTTOM), "white")
    draw = ImageDraw.Draw(image)
    draw.text((20, 8), panel.title, INK, words)
    _key(draw, ["start", "fit", "target"])
    middle, half = 560, 160
    away = [abs(value) for _, _, *values in panel.rows for value in values if np.isfinite(value)]
    reach = max([2.0, *away])
    bottom = image.height - BOTTOM + 6
    for value in (-reach, 0.0, reach):
        x = middle + half * value / reach
        draw.line((x, TOP, x, bottom), fill=GRID)
        text = written(value)
        draw.text((x - 0.5 * draw.textlength(text, words), bottom + 6), text, FAINT, words)
    for k, ((name, spread, *values), said) in enumerate(zip(panel.rows, panel.words)):
        y = TOP + line * (k + 0.5)
        draw.text((20, y - 9), f"{name}: {said}", INK, words)
        share = half * min(spread, reach) / reach
        draw.line((middle - share, y, middle + share, y), fill=COLORS["target"], width=4)
        for kind, value in zip(("start", "fit"), values):
            if np.isfinite(value):
                x = middle + half * value / reach
                draw.ellipse((x - 5, y - 5, x + 5, y + 5), fill=COLORS[kind])
    return image
