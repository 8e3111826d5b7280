"""Words on pictures: the color bar of a quantity, and labels.

Numbers as colors: a ramp of even perceptual steps, and scenes painted with it.

The ramp goes from dark violet over blue, teal and green to light yellow.  Equal differences of the
number are equal distances in CIELAB, and lightness L* rises all the way: it reads the same in gray
and to a color-blind eye.

Round numbers for a scale, and how they are written.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Texture
from gf_usd.core.errors import UsageError
from gf_usd.core.radiance import linear_to_srgb, srgb_to_linear
from gf_usd.core.scene import Quantity, RenderMesh, Scene

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
    """The color bar of a quantity, drawn once and laid over every picture of a film.

    Parameters
    ----------
    quantity : the ends of the bar are quantity.low and quantity.high.
    size : (width, height) [pixels] of the pictures.

    Raises UsageError for pictures that are too small for words.
    """

    def __init__(self, quantity: Quantity, size: tuple[int, int]) -> None:
        if size[0] < SMALLEST_PICTURE[0] or size[1] < SMALLEST_PICTURE[1]:
            raise UsageError(
                f"An image of {size[0]}x{size[1]} pixels is too small for a legend.",
                f"give at least {SMALLEST_PICTURE[0]}x{SMALLEST_PICTURE[1]} with --size",
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
    return [*quantity.source, highest]


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


STEPS = 256
# Colors in sRGB at even distances in CIELAB (D65), lightness L* from 28 to 93.
STOPS = (
    "433683 394a99 285da9 1f6aab 1b74a8 1a7fa5 188ca4 1699a3 25a6a0"
    " 3db199 54bb90 6ac486 7fcd7c 98d572 b0db68 c8e15e e1e755 feee54"
)
MATT = 0.9  # roughness of what is painted: a highlight would read as a high value


@cache
def ramp() -> NDArray[np.floating]:
    """(256, 3) linear Rec. 709, low to high, by way of `STOPS`.  Do not write to it."""
    stops = np.array([list(bytes.fromhex(stop)) for stop in STOPS.split()]) / 255.0
    at, known = np.linspace(0.0, 1.0, STEPS), np.linspace(0.0, 1.0, len(stops))
    return srgb_to_linear(np.stack([np.interp(at, known, channel) for channel in stops.T], axis=1))


def fraction(values: Floats, low: float, high: float) -> NDArray[np.float64]:
    """Where values lie in low..high, held to 0..1; 0 for those that are not finite."""
    span = high - low if high > low else 1.0
    return np.clip(np.nan_to_num((np.asarray(values) - low) / span, nan=0.0), 0.0, 1.0)


def colors(values: Floats, low: float, high: float) -> NDArray[np.float64]:
    """Linear colors (..., 3) of values (...)."""
    at = fraction(values, low, high) * (STEPS - 1)
    return np.stack([np.interp(at, np.arange(STEPS), channel) for channel in ramp().T], axis=-1)


@cache
def _texture() -> Texture:
    codes = np.round(255.0 * linear_to_srgb(ramp())).astype(np.uint8)
    return Texture(pixels=codes[None], srgb=True, wrap_s="clamp", wrap_t="clamp")


def paint(scene: Scene, low: float, high: float) -> Scene:
    """The scene with all that has values colored by them, matt; the rest as it was.

    Meshes carry the ramp as a texture whose coordinate is the value, so that between vertices it
    is the value that is interpolated and not the color.
    """
    return replace(
        scene,
        meshes=tuple(_paint_mesh(mesh, low, high) for mesh in scene.meshes),
        splats=tuple(
            cloud
            if cloud.values is None
            else replace(cloud, colors=colors(cloud.values, low, high), harmonics=None)
            for cloud in scene.splats
        ),
        ellipsoids=tuple(
            cloud
            if cloud.values is None
            else replace(cloud, colors=colors(cloud.values, low, high))
            for cloud in scene.ellipsoids
        ),
    )


def _paint_mesh(mesh: RenderMesh, low: float, high: float) -> RenderMesh:
    if mesh.values is None:
        return mesh
    count = len(mesh.triangles)
    # from the middle of the first texel to that of the last
    u = (0.5 + fraction(mesh.values, low, high) * (STEPS - 1)) / STEPS
    uvs = np.full((count, 3, 2), 0.5)
    uvs[..., 0] = u[np.asarray(mesh.triangles)]
    return replace(
        mesh,
        uvs=uvs,
        textures=(_texture(),),
        triangle_textures=np.zeros(count, dtype=np.int32),
        roughness=np.array(MATT),
        metallic=np.array(0.0),
    )


PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"))
TICK_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # of a scale, times a power of ten


def ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Up to `most` multiples of a round step within low..high, with the ends where they are round.

    Fewer than two where the range is empty: then the two ends.
    """
    span = high - low
    if not (math.isfinite(span) and span > 0.0):
        return [low]
    power = 10.0 ** math.floor(math.log10(span / max(1, most - 1)))
    for step in (factor * power for factor in (*TICK_STEPS, 20.0)):
        first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
        if last - first + 1 <= most:
            found = [i * step for i in range(first, last + 1)]
            return found if len(found) > 1 else [low, high]
    return [low, high]


def rounded_up(value: float) -> float:
    """The next number above `value` (> 0) whose two leading digits are all it has; 0 stays 0."""
    if not (math.isfinite(value) and value > 0.0):
        return 0.0
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / power - 1e-9) * power


def prefix(largest: float, unit: str) -> tuple[float, str]:
    """Divisor and unit that suit numbers up to `largest`; a pure number stays as it is."""
    if not unit:
        return 1.0, ""
    for size, sign in PREFIXES:
        if abs(largest) >= size:
            return size, f"{sign}{unit}"
    return 1.0, unit


def written(value: float) -> str:
    """Up to three digits, and no exponent below 100,000."""
    text = f"{value:.3g}" if abs(value) < 1e3 or abs(value) >= 1e5 else f"{value:.0f}"
    return "0" if float(text) == 0.0 else text
