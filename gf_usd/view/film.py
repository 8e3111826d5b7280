"""Films as H.264 in MP4, by the ffmpeg that comes with imageio[ffmpeg].

Films as animated GIF: one palette for all frames, a fixed dither, only changes are stored.

A GIF has 256 colours.  One palette of the film's own colours and a dither pattern that stands
still keep the picture calm, and let every pixel that does not change be left out.

A contact sheet: many frames of one motion on one page.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from gf_usd.core.errors import BakeError, GfUsdError, UsageError
from gf_usd.system.atomic_files import partial_path, publish

QUALITY = "18"  # x264's constant rate factor: no loss that the eye sees
# Rec. 709 throughout, and said so: a player guesses otherwise for small pictures
COLOUR = ("-vf", "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int")
TAGS = ("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1")
# the index in front, so that a browser starts before it has all
CONTAINER = ("-crf", QUALITY, "-preset", "medium", "-movflags", "+faststart")


def write_mp4(
    path: Path, frames: Iterable[NDArray[np.uint8]], fps: float, size: tuple[int, int]
) -> None:
    """Write frames (H, W, 3) sRGB; the film appears whole under its name, or not at all.

    The pixels are 4:2:0, as every player reads them.

    Parameters
    ----------
    size : (width, height) [pixels], both even.

    Raises
    ------
    UsageError : an odd size, or a folder that does not exist.
    GfUsdError : imageio[ffmpeg] is not installed.
    BakeError : ffmpeg fails; only the partial file remains.
    """
    if size[0] % 2 or size[1] % 2:
        raise UsageError(
            f"A film of {size[0]}x{size[1]} pixels cannot be written as H.264.",
            "give an even width and height, e.g. --size 640x480",
        )
    require_folder(path)
    writer = _ffmpeg().write_frames(
        str(partial_path(path)),
        size,
        fps=fps,
        codec="libx264",
        pix_fmt_in="rgb24",
        pix_fmt_out="yuv420p",
        quality=None,  # the constant rate factor decides instead
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=[*COLOUR, *TAGS, *CONTAINER],
    )
    try:
        writer.send(None)
        for pixels in frames:
            writer.send(np.ascontiguousarray(pixels))
    except OSError as error:
        raise BakeError(
            f"ffmpeg could not write {partial_path(path)}: {error}",
            "check that there is space left, or write a .gif",
        ) from error
    finally:
        writer.close()
    publish(path)


def require_folder(path: Path) -> None:
    """Raise UsageError where a file of this name cannot be made."""
    if not path.parent.is_dir() or path.is_dir():
        raise UsageError(
            f"The picture {path} cannot be written: "
            + ("it is a folder" if path.is_dir() else f"{path.parent} is not a folder"),
            "choose a file name in a folder that exists and that you may write to, with -o",
        )


def _ffmpeg() -> ModuleType:
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise GfUsdError(
            f"MP4 files need ffmpeg, which is not installed: {error}",
            "python -m pip install 'imageio[ffmpeg]', or write a .gif",
        ) from error


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


PAPER = (250, 250, 249)
GUTTER = 1 / 60  # of a tile's height


def columns_for(count: int, aspect: float) -> int:
    """Columns that make a sheet of `count` tiles of this width / height about 3:2 wide.

    Among those near that shape the one that leaves the fewest places empty wins.
    """
    ideal = math.sqrt(1.5 * count / aspect)
    near = range(max(1, math.floor(0.75 * ideal)), min(count, math.ceil(1.35 * ideal)) + 1)
    return min(near, key=lambda n: (-count % n, abs(n - ideal), -n), default=count)


def contact_sheet(tiles: Sequence[Pixels], columns: int) -> Pixels:
    """Tiles (H, W, 3) of one size row by row, with gutters between and around them."""
    height, width, _ = tiles[0].shape
    gap = max(2, round(GUTTER * height))
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    page = np.empty((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), dtype=np.uint8)
    page[:] = PAPER
    for i, tile in enumerate(tiles):
        y = gap + (i // columns) * (height + gap)
        x = gap + (i % columns) * (width + gap)
        page[y : y + height, x : x + width] = tile
    return page
