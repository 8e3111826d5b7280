"""Films as animated GIF: one palette for all frames, a fixed dither, only changes are stored.

A GIF has 256 colours.  One palette of the film's own colours and a dither pattern that stands
still keep the picture calm, and let every pixel that does not change be left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from gf_usd.errors import UsageError
from gf_usd.publish import partial_path, publish

Pixels = NDArray[np.uint8]

FASTEST = 50.0  # frames a second: browsers slow down what is shown for less than 2/100 s
COLOURS = 255  # one more index stands for "as before"
AS_BEFORE = 255
STILL = 1  # codes: a pixel that changes by no more keeps its colour
DITHER = 5.0  # codes, peak to peak: about the distance of neighbours in the palette
FINE = 4  # codes: pixels are grouped so finely before the nearest colour is looked up


def write_gif(path: Path, frames: Iterable[Pixels], fps: float, samples: Sequence[Pixels]) -> None:
    """Write frames (H, W, 3) sRGB, playing for ever in real time; whole or not at all.

    Delays are hundredths of a second; they are rounded so that no error adds up.

    Parameters
    ----------
    samples : frames of the film whose colours make the palette.

    Raises
    ------
    UsageError : more than 50 frames a second, or a file that cannot be written.
    """
    if fps > FASTEST:
        raise UsageError(
            f"A GIF cannot show {fps:g} frames a second.", f"give --fps {FASTEST:g} or less"
        )
    colours = palette(samples)
    images = _timed(_indexed(frames, colours), fps)
    first = next(images)
    partial = partial_path(path)
    try:
        with partial.open("wb") as file:
            first.save(
                file,
                format="GIF",
                save_all=True,
                append_images=images,
                transparency=AS_BEFORE,
                loop=0,
                disposal=1,
                optimize=False,
            )
    except OSError as error:
        raise UsageError(
            f"The picture {path} cannot be written: {error.strerror or error}.",
            "choose a folder that exists and that you may write to, with -o",
        ) from error
    publish(path)


def palette(samples: Sequence[Pixels]) -> Pixels:
    """(255, 3) colours that serve all the samples.

    Colours count by the square root of their area: else a plain backdrop would take most of them,
    and the small bright body that the film is about would get few.
    """
    pixels = np.concatenate([sample.reshape(-1, 3)[::2] for sample in samples]).astype(np.int64)
    bins = pixels // FINE
    keys = (bins[:, 0] * 64 + bins[:, 1]) * 64 + bins[:, 2]
    _, where, area = np.unique(keys, return_index=True, return_counts=True)
    weighed = np.repeat(pixels[where], np.ceil(np.sqrt(area)).astype(int), axis=0)
    strip = Image.fromarray(weighed.astype(np.uint8)[None])
    found = strip.quantize(COLOURS, Image.Quantize.MEDIANCUT, kmeans=2).getpalette() or [0, 0, 0]
    colours = np.array(found, dtype=np.uint8).reshape(-1, 3)[:COLOURS]
    # fewer where the film has fewer: the rest repeats the last, and is never chosen
    return np.concatenate([colours, np.repeat(colours[-1:], COLOURS - len(colours), axis=0)])


def _indexed(frames: Iterable[Pixels], colours: Pixels) -> Iterator[Image.Image]:
    """Frames in the palette; a pixel that is as before has index 255."""
    table = _nearest(colours)
    flat = [*colours.ravel().tolist(), 0, 0, 0]
    noise: NDArray[np.int16] | None = None
    held: NDArray[np.int16] | None = None  # the codes that each shown pixel was made from
    for pixels in frames:
        codes = pixels.astype(np.int16)
        if noise is None:
            noise = _pattern(*codes.shape[:2])
        wanted = np.clip(codes + noise[..., None], 0, 255) // FINE
        index = table[wanted[..., 0], wanted[..., 1], wanted[..., 2]]
        if held is None:
            held = codes
        else:
            same = np.abs(codes - held).max(axis=2) <= STILL
            held = np.where(same[..., None], held, codes)
            index = np.where(same, np.uint8(AS_BEFORE), index)
        image = Image.fromarray(index)
        image.putpalette(flat)
        yield image


def _timed(images: Iterator[Image.Image], fps: float) -> Iterator[Image.Image]:
    """Say of each image how long [ms] it shows, in whole hundredths of a second."""
    for i, image in zip(count(), images):
        image.info["duration"] = 10 * (round(100 * (i + 1) / fps) - round(100 * i / fps))
        yield image


def _nearest(colours: Pixels) -> NDArray[np.uint8]:
    """(64, 64, 64) index of the palette's colour nearest to each group of codes."""
    middle = np.arange(0, 256, FINE) + 0.5 * (FINE - 1)
    grid = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1)
    return np.asarray(cKDTree(colours).query(grid)[1], dtype=np.uint8)


def _pattern(height: int, width: int) -> NDArray[np.int16]:
    """(H, W) dither, the same in every frame: an ordered 8 x 8 pattern [Bayer 1973]."""
    bayer = np.zeros((1, 1))
    for _ in range(3):
        bayer = np.block([[4 * bayer, 4 * bayer + 2], [4 * bayer + 3, 4 * bayer + 1]])
    level = (bayer + 0.5) / 64.0 - 0.5
    tiled = np.tile(level, (-(-height // 8), -(-width // 8)))[:height, :width]
    return np.round(DITHER * tiled).astype(np.int16)
