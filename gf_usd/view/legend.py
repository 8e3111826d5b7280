"""Words on pictures: the colour bar of a quantity, and labels."""

from __future__ import annotations

from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gf_usd.colour import linear_to_srgb
from gf_usd.errors import UsageError
from gf_usd.scene import Quantity
from gf_usd.view.colormap import ramp
from gf_usd.view.ticks import prefix, ticks, written

Pixels = NDArray[np.uint8]
Font: TypeAlias = ImageFont.FreeTypeFont | ImageFont.ImageFont

INK = (38, 41, 46, 255)
FAINT = (84, 89, 97, 255)
PANEL = (250, 250, 249, 188)  # behind words, so that they read on any picture
BAR = 0.4  # of the picture's height
SMALLEST_PICTURE = (240, 180)  # [pixels] that a legend fits into
SMALLEST = 11  # [pixels] of a letter's size: below it nothing reads


def text_size(height: int) -> int:
    """Size [pixels] of letters in a picture of that height: 15 at 480."""
    return max(SMALLEST, round(height / 32))


@cache
def font(size: int) -> Font:
    """Pillow's own typeface: no file of the system is needed.  It has ASCII only."""
    return ImageFont.load_default(size)


class Legend:
    """The colour bar of a quantity, drawn once and laid over every picture of a film.

    Parameters
    ----------
    quantity : the ends of the bar are quantity.low and quantity.high.
    size : (width, height) [pixels] of the pictures.

    Raises UsageError for pictures that are too small for words.
    """

    def __init__(self, quantity: Quantity, size: tuple[int, int]) -> None:
        if size[0] < SMALLEST_PICTURE[0] or size[1] < SMALLEST_PICTURE[1]:
            raise UsageError(
                f"A picture of {size[0]}x{size[1]} pixels has no room for a legend.",
                f"ask for {SMALLEST_PICTURE[0]}x{SMALLEST_PICTURE[1]} or more with --size",
            )
        self._layer, self.reserved = _draw(quantity, size)

    def over(self, pixels: Pixels) -> Pixels:
        """The picture (H, W, 3) with the legend at its lower left, `reserved` [pixels] wide."""
        picture = Image.fromarray(pixels)
        picture.paste(self._layer, (0, 0), self._layer)
        return np.asarray(picture)


def _draw(quantity: Quantity, size: tuple[int, int]) -> tuple[Image.Image, int]:
    """The legend on a clear layer, and how wide it is with the space around it."""
    letter = text_size(size[1])
    words, small = font(letter), font(max(SMALLEST, round(0.8 * letter)))
    divisor, unit = prefix(max(abs(quantity.low), abs(quantity.high)), quantity.unit)
    title = f"{quantity.title} [{unit}]" if unit else quantity.title
    pad = max(6, round(0.7 * letter))
    lines = (title, quantity.measure, *_range_note(quantity))
    heights = [round(1.3 * letter), *[round(1.3 * max(SMALLEST, 0.8 * letter))] * (len(lines) - 1)]
    layer = Image.new("RGBA", size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(layer)
    wide = max(draw.textlength(line, words if i == 0 else small) for i, line in enumerate(lines))
    right, bottom = pad + pad + round(wide) + pad, size[1] - pad
    bar_height = round(BAR * size[1])
    top = bottom - sum(heights) - bar_height - 4 * pad
    draw.rounded_rectangle((pad, top, right, bottom), radius=0.6 * pad, fill=PANEL)
    left, y = 2 * pad, top + pad
    for i, line in enumerate(lines):
        if i == 2:
            y += pad
            _bar(layer, quantity, divisor, (left, y, round(1.1 * letter), bar_height), small)
            y += bar_height + pad
        draw.text((left, y), line, INK if i == 0 else FAINT, words if i == 0 else small)
        y += heights[i]
    return layer, right + pad


def _range_note(quantity: Quantity) -> list[str]:
    """Where the range comes from, and how far the values go."""
    divisor, unit = prefix(quantity.largest, quantity.unit)
    highest = f"highest {written(quantity.largest / divisor)} {unit}".rstrip()
    if quantity.chosen:
        return ["range as given,", highest]
    return ["99 % of particles", "in every frame,", highest]


def _bar(
    layer: Image.Image,
    quantity: Quantity,
    divisor: float,
    place: tuple[int, int, int, int],
    small: Font,
) -> None:
    """The ramp upright, high at the top, in place (left, top, width, height), and its numbers.

    The ends are always named, and what would touch them is not.
    """
    left, top, width, height = place
    at = np.linspace(len(ramp()) - 1, 0, height).round().astype(int)
    codes = np.round(255.0 * linear_to_srgb(ramp()[at])).astype(np.uint8)
    layer.paste(Image.fromarray(codes[:, None]).resize((width, height)), (left, top))
    draw = ImageDraw.Draw(layer)
    low, high = quantity.low / divisor, quantity.high / divisor
    ascent = draw.textbbox((0, 0), "0", small)
    apart = 1.5 * (ascent[3] - ascent[1])
    taken: list[float] = []
    for value in (low, high, *ticks(low, high)):
        y = top + (high - value) / (high - low) * (height - 1)
        if any(abs(y - other) < apart for other in taken):
            continue
        taken.append(y)
        mark = left + width + max(2, width // 4)
        draw.line((left + width, y, mark, y), INK)
        draw.text((mark + 3, y - 0.5 * (ascent[1] + ascent[3])), written(value), INK, small)


def label(pixels: Pixels, text: str) -> Pixels:
    """The picture (H, W, 3) with a word in its upper left corner."""
    picture = Image.fromarray(pixels)
    letter = max(SMALLEST, round(pixels.shape[0] / 18))
    pad = max(3, round(0.4 * letter))
    layer = Image.new("RGBA", picture.size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(layer)
    box = draw.textbbox((2 * pad, 2 * pad), text, font(letter))
    draw.rounded_rectangle(
        (box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad), radius=pad, fill=PANEL
    )
    draw.text((2 * pad, 2 * pad), text, INK, font(letter))
    picture.paste(layer, (0, 0), layer)
    return np.asarray(picture)
