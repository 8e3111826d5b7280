"""Line plots as a PNG: panels below each other, for results without an HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from gf_usd.core.arrays import Floats
from gf_usd.system.atomic_files import publish_bytes
from gf_usd.view.legend import NOTE_COLOR, TEXT_COLOR, font
from gf_usd.view.ticks import format_number, si_prefix, ticks

WIDTH, HEIGHT = 760, 260  # [pixels] of a panel
LEFT, RIGHT, TOP, BOTTOM = 86, 20, 34, 40  # [pixels] margins of the plot
FONT_SIZE = 14
GRID = (225, 227, 230)
COLORS = {"start": (160, 166, 174), "fit": (214, 84, 46), "target": (27, 106, 171)}
DOT_RADIUS = 3  # [pixels]
MAX_DOTS = 60  # on a curve at most


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Values over time."""

    kind: str  # of COLORS
    x: Floats  # (n,) [s]
    y: Floats  # (n,)
    dots: bool = False  # draw markers instead of a line


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A plot of curves of one unit over time."""

    title: str
    unit: str
    curves: Sequence[Curve]


@dataclass(frozen=True, kw_only=True)
class Rows:
    """A plot of numbers relative to their targets, one row each."""

    title: str
    rows: Sequence[
        tuple[str, float, float, float]
    ]  # name; target, start and fit [standard deviations]
    texts: Sequence[str]  # the text after each name


def write_panels(path: Path, panels: Sequence[Panel | Rows]) -> Path:
    """Write panels as a PNG file and return its path.  Raises BakeError where writing fails."""
    images = [
        _draw_rows(panel) if isinstance(panel, Rows) else _draw_curves(panel) for panel in panels
    ]
    picture = Image.new("RGB", (WIDTH, sum(image.height for image in images)), "white")
    top = 0
    for image in images:
        picture.paste(image, (0, top))
        top += image.height
    data = BytesIO()
    picture.save(data, format="PNG")
    return publish_bytes(path, data.getvalue())


def _draw_curves(panel: Panel) -> Image.Image:
    image = Image.new("RGB", (WIDTH, HEIGHT), "white")
    draw = ImageDraw.Draw(image)
    finite = [curve for curve in panel.curves if np.isfinite(curve.y).any()]
    x = np.concatenate([curve.x for curve in finite])
    y = np.concatenate([curve.y[np.isfinite(curve.y)] for curve in finite])
    divisor, unit = si_prefix(float(np.abs(y).max()), panel.unit)
    low, high = float(y.min()) / divisor, float(y.max()) / divisor
    margin = 0.06 * (high - low) or 0.5
    box = (float(x.min()), float(x.max()), low - margin, high + margin)
    _draw_axes(draw, box, f"{panel.title} [{unit}]" if unit else panel.title)
    for curve in finite:
        pixels = _to_pixels(box, curve.x, curve.y / divisor)
        color = COLORS[curve.kind]
        if curve.dots:
            for px, py in pixels[:: max(1, len(pixels) // MAX_DOTS)]:
                draw.ellipse(
                    (px - DOT_RADIUS, py - DOT_RADIUS, px + DOT_RADIUS, py + DOT_RADIUS),
                    outline=color,
                    width=2,
                )
        else:
            draw.line([tuple(point) for point in pixels], fill=color, width=2)
    _draw_key(draw, [curve.kind for curve in finite])
    return image


def _draw_axes(
    draw: ImageDraw.ImageDraw, box: tuple[float, float, float, float], title: str
) -> None:
    text_font = font(FONT_SIZE)
    left, right, low, high = box
    draw.text((LEFT, 8), title, TEXT_COLOR, text_font)
    for value in ticks(low, high):
        (x, y), (end, _) = _to_pixels(box, np.array([left, right]), np.array([value, value]))
        draw.line((x, y, end, y), fill=GRID)
        text = format_number(value)
        draw.text((LEFT - 8 - draw.textlength(text, text_font), y - 9), text, NOTE_COLOR, text_font)
    for value in ticks(left, right, 7):
        x = _to_pixels(box, np.array([value]), np.array([low]))[0, 0]
        draw.line((x, HEIGHT - BOTTOM, x, HEIGHT - BOTTOM + 4), fill=NOTE_COLOR)
        text = f"{format_number(value)} s"
        draw.text(
            (x - 0.5 * draw.textlength(text, text_font), HEIGHT - BOTTOM + 8),
            text,
            NOTE_COLOR,
            text_font,
        )


def _to_pixels(box: tuple[float, float, float, float], x: Floats, y: Floats) -> Floats:
    left, right, low, high = box
    plot_width, plot_height = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    px = LEFT + plot_width * (x - left) / ((right - left) or 1.0)
    py = TOP + plot_height * (high - y) / ((high - low) or 1.0)
    return np.stack([px, py], axis=-1)


def _draw_key(draw: ImageDraw.ImageDraw, kinds: Sequence[str]) -> None:
    """Draw the key of curve colors in the upper right corner."""
    text_font, right = font(FONT_SIZE), float(WIDTH - RIGHT)
    for kind in dict.fromkeys(reversed(kinds)):
        right -= draw.textlength(kind, text_font)
        draw.text((right, 8), kind, COLORS[kind], text_font)
        right -= 18


def _draw_rows(panel: Rows) -> Image.Image:
    """Draw start and fit of each number in standard deviations from its target, which is at 0."""
    text_font, line = font(FONT_SIZE), 30
    image = Image.new("RGB", (WIDTH, TOP + line * len(panel.rows) + BOTTOM), "white")
    draw = ImageDraw.Draw(image)
    draw.text((20, 8), panel.title, TEXT_COLOR, text_font)
    _draw_key(draw, ["start", "fit", "target"])
    middle, half = 560, 160
    offsets = [abs(value) for _, _, *values in panel.rows for value in values if np.isfinite(value)]
    limit = max([2.0, *offsets])
    bottom = image.height - BOTTOM + 6
    for value in (-limit, 0.0, limit):
        x = middle + half * value / limit
        draw.line((x, TOP, x, bottom), fill=GRID)
        text = format_number(value)
        draw.text(
            (x - 0.5 * draw.textlength(text, text_font), bottom + 6), text, NOTE_COLOR, text_font
        )
    for k, ((name, spread, *values), text) in enumerate(zip(panel.rows, panel.texts)):
        y = TOP + line * (k + 0.5)
        draw.text((20, y - 9), f"{name}: {text}", TEXT_COLOR, text_font)
        sigma_width = half * min(spread, limit) / limit
        draw.line(
            (middle - sigma_width, y, middle + sigma_width, y), fill=COLORS["target"], width=4
        )
        for kind, value in zip(("start", "fit"), values):
            if np.isfinite(value):
                x = middle + half * value / limit
                draw.ellipse((x - 5, y - 5, x + 5, y + 5), fill=COLORS[kind])
    return image
