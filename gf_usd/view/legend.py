"""Text on pictures: the color bar of a quantity, and labels."""

from __future__ import annotations

from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gf_usd.core.errors import UsageError
from gf_usd.core.radiance import linear_to_srgb
from gf_usd.core.scene import Quantity
from gf_usd.view.colormap import color_map
from gf_usd.view.ticks import format_number, si_prefix, ticks

Pixels = NDArray[np.uint8]
Font: TypeAlias = ImageFont.FreeTypeFont | ImageFont.ImageFont

TEXT_COLOR = (38, 41, 46, 255)
NOTE_COLOR = (84, 89, 97, 255)
PANEL_COLOR = (250, 250, 249, 188)  # semi-transparent background, for contrast on any picture
BAR_HEIGHT = 0.4  # fraction of the picture's height
MIN_PICTURE_SIZE = (240, 180)  # [pixels] width and height for a legend
MIN_FONT_SIZE = 11  # [pixels] smallest legible size


def text_size(height: int) -> int:
    """Font size [pixels] for a picture of a height [pixels]: 15 at 480."""
    return max(MIN_FONT_SIZE, round(height / 32))


def label_size(height: int) -> int:
    """Font size [pixels] of labels of a picture of a height [pixels]: 13 at 240."""
    return max(MIN_FONT_SIZE, round(height / 18))


@cache
def font(size: int) -> Font:
    """Pillow's default font, independent of fonts of the system; it has ASCII characters only."""
    return ImageFont.load_default(size)


class Legend:
    """The color bar of a quantity, drawn once and composited over every picture of a film.

    Parameters
    ----------
    quantity : the ends of the bar are quantity.low and quantity.high.
    size : (width, height) [pixels] of the pictures.

    Raises UsageError for pictures smaller than MIN_PICTURE_SIZE.
    """

    def __init__(self, quantity: Quantity, size: tuple[int, int]) -> None:
        if size[0] < MIN_PICTURE_SIZE[0] or size[1] < MIN_PICTURE_SIZE[1]:
            raise UsageError(
                f"an image of {size[0]}x{size[1]} pixels is too small for a legend",
                f"give at least {MIN_PICTURE_SIZE[0]}x{MIN_PICTURE_SIZE[1]} with --size",
            )
        self._layer, self.reserved = _draw_legend(quantity, size)

    def overlay(self, pixels: Pixels) -> Pixels:
        """The picture (H, W, 3) with the legend in its lower left, `reserved` [pixels] wide."""
        picture = Image.fromarray(pixels)
        picture.paste(self._layer, (0, 0), self._layer)
        return np.asarray(picture)


def _draw_legend(quantity: Quantity, size: tuple[int, int]) -> tuple[Image.Image, int]:
    """The legend on a transparent layer, and its width with margins [pixels]."""
    font_size = text_size(size[1])
    title_font, small_font = font(font_size), font(max(MIN_FONT_SIZE, round(0.8 * font_size)))
    divisor, unit = si_prefix(max(abs(quantity.low), abs(quantity.high)), quantity.unit)
    title = f"{quantity.title} [{unit}]" if unit else quantity.title
    pad = max(6, round(0.7 * font_size))
    lines = (title, quantity.measure, *_describe_range(quantity))
    heights = [
        round(1.3 * font_size),
        *[round(1.3 * max(MIN_FONT_SIZE, 0.8 * font_size))] * (len(lines) - 1),
    ]
    layer = Image.new("RGBA", size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(layer)
    text_width = max(
        draw.textlength(line, title_font if i == 0 else small_font) for i, line in enumerate(lines)
    )
    right, bottom = pad + pad + round(text_width) + pad, size[1] - pad
    bar_height = round(BAR_HEIGHT * size[1])
    top = bottom - sum(heights) - bar_height - 4 * pad
    draw.rounded_rectangle((pad, top, right, bottom), radius=0.6 * pad, fill=PANEL_COLOR)
    left, y = 2 * pad, top + pad
    for i, line in enumerate(lines):
        if i == 2:
            y += pad
            _draw_color_bar(
                layer, quantity, divisor, (left, y, round(1.1 * font_size), bar_height), small_font
            )
            y += bar_height + pad
        draw.text(
            (left, y),
            line,
            TEXT_COLOR if i == 0 else NOTE_COLOR,
            title_font if i == 0 else small_font,
        )
        y += heights[i]
    return layer, right + pad


def _describe_range(quantity: Quantity) -> list[str]:
    """The source of the range, and the largest value."""
    divisor, unit = si_prefix(quantity.largest, quantity.unit)
    highest = f"highest {format_number(quantity.largest / divisor)} {unit}".rstrip()
    if quantity.chosen:
        return ["range as given,", highest]
    return [*quantity.source, highest]


def _draw_color_bar(
    layer: Image.Image,
    quantity: Quantity,
    divisor: float,
    place: tuple[int, int, int, int],
    small_font: Font,
) -> None:
    """Draw a vertical color bar at `place` (left, top, width, height) with its ticks.

    Both ends have labels; ticks too close to another label are omitted.
    """
    left, top, width, height = place
    entries = np.linspace(len(color_map()) - 1, 0, height).round().astype(int)
    codes = np.round(255.0 * linear_to_srgb(color_map()[entries])).astype(np.uint8)
    layer.paste(Image.fromarray(codes[:, None]).resize((width, height)), (left, top))
    draw = ImageDraw.Draw(layer)
    low, high = quantity.low / divisor, quantity.high / divisor
    ascent = draw.textbbox((0, 0), "0", small_font)
    min_distance = 1.5 * (ascent[3] - ascent[1])
    used: list[float] = []
    for value in (low, high, *ticks(low, high)):
        y = top + (high - value) / (high - low) * (height - 1)
        if any(abs(y - other) < min_distance for other in used):
            continue
        used.append(y)
        tick_end = left + width + max(2, width // 4)
        draw.line((left + width, y, tick_end, y), TEXT_COLOR)
        draw.text(
            (tick_end + 3, y - 0.5 * (ascent[1] + ascent[3])),
            format_number(value),
            TEXT_COLOR,
            small_font,
        )


def label(pixels: Pixels, text: str) -> Pixels:
    """The picture (H, W, 3) with a text in its upper left corner."""
    picture = Image.fromarray(pixels)
    font_size = label_size(pixels.shape[0])
    pad = max(3, round(0.4 * font_size))
    layer = Image.new("RGBA", picture.size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(layer)
    box = draw.textbbox((2 * pad, 2 * pad), text, font(font_size))
    draw.rounded_rectangle(
        (box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad), radius=pad, fill=PANEL_COLOR
    )
    draw.text((2 * pad, 2 * pad), text, TEXT_COLOR, font(font_size))
    picture.paste(layer, (0, 0), layer)
    return np.asarray(picture)


def caption(pixels: Pixels, text: str) -> Pixels:
    """The picture (H, W, 3) with a text in a band above it, which covers nothing of it.

    Where the text is too wide, its first words are left out.
    """
    font_size = label_size(pixels.shape[0])
    pad = round(0.4 * font_size)
    band = Image.new("RGB", (pixels.shape[1], font_size + 2 * pad), PANEL_COLOR[:3])
    draw = ImageDraw.Draw(band)
    while " " in text and draw.textlength(text, font(font_size)) > band.width - 2 * pad:
        text = text.partition(" ")[2]
    draw.text((pad, 0.5 * band.height), text, TEXT_COLOR, font(font_size), "lm")
    return np.concatenate([np.asarray(band), pixels])
