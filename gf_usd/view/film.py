"""Films as H.264 in MP4 and as animated GIF, by the ffmpeg that comes with imageio[ffmpeg].

A contact sheet: many frames of one motion on one page.
"""

from __future__ import annotations

import importlib
import math
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import BakeError, GfUsdError, UsageError
from gf_usd.system.atomic_files import partial_path, publish
from gf_usd.view.report.surface import spread as evenly

Pixels = NDArray[np.uint8]

QUALITY = "18"  # x264's constant rate factor: no loss that the eye sees
MP4 = (
    "-c:v", "libx264", "-crf", QUALITY, "-preset", "medium", "-pix_fmt", "yuv420p",
    # Rec. 709 throughout, and said so: a player guesses otherwise for small pictures
    "-vf", "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int",
    "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1",
    # the index in front, so that a browser starts before it has all
    "-movflags", "+faststart",
)  # fmt: skip
FASTEST = 50.0  # frames per second: browsers slow down what is shown for less than 2/100 s
# The first {0} frames of the stream make the palette, the others are shown.  The dither pattern
# stands still, so that of each frame only the rectangle that changes is stored.
PALETTE = (
    "split[a][b];[a]trim=end_frame={0},palettegen[palette];"
    "[b]trim=start_frame={0},setpts=PTS-STARTPTS[film];"
    "[film][palette]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)


def write_mp4(path: Path, frames: Iterable[Pixels], fps: float, size: tuple[int, int]) -> None:
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
    _encode(path, frames, fps, size, MP4)


def write_gif(path: Path, frames: Iterable[Pixels], fps: float, samples: Sequence[Pixels]) -> None:
    """Write frames (H, W, 3) sRGB, playing for ever in real time; whole or not at all.

    Delays are hundredths of a second; they are rounded so that no error adds up.

    Parameters
    ----------
    samples : frames of the film whose colors make the palette.

    Raises
    ------
    UsageError : more than 50 frames per second, or a folder that does not exist.
    GfUsdError : imageio[ffmpeg] is not installed.
    BakeError : ffmpeg fails; only the partial file remains.
    """
    if fps > FASTEST:
        raise UsageError(
            f"A GIF cannot show {fps:g} frames per second.", f"give --fps {FASTEST:g} or less"
        )
    height, width, _ = samples[0].shape
    output = ("-filter_complex", PALETTE.format(len(samples)), "-f", "gif", "-loop", "0")
    _encode(path, chain(samples, frames), fps, (width, height), output)


def require_folder(path: Path) -> None:
    """Raise UsageError where a file of this name cannot be made."""
    if not path.parent.is_dir() or path.is_dir():
        raise UsageError(
            f"The image {path} cannot be written: "
            + ("it is a folder" if path.is_dir() else f"{path.parent} is not a folder"),
            "choose a file name in a folder that exists and is writable, with -o",
        )


def _encode(
    path: Path, frames: Iterable[Pixels], fps: float, size: tuple[int, int], output: Sequence[str]
) -> None:
    """Send frames to ffmpeg with these output options, and publish the file when it is complete."""
    require_folder(path)
    partial = partial_path(path)
    command = [
        _ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{size[0]}x{size[1]}", "-r", f"{fps}", "-i", "-",
        *output, "-fflags", "+bitexact", str(partial),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said)
        assert process.stdin is not None
        try:
            with suppress(BrokenPipeError):  # its status and its words say why
                for pixels in frames:
                    process.stdin.write(np.ascontiguousarray(pixels).data)
        finally:
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
        if process.returncode:
            said.seek(0)
            raise BakeError(
                f"ffmpeg could not write {partial}: {said.read().decode(errors='replace').strip()}",
                "check that this folder is writable and has space left",
            )
    publish(path)


def _ffmpeg() -> str:
    """The path of ffmpeg.  Raises GfUsdError where there is none."""
    try:
        return importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise GfUsdError(
            f"Films need ffmpeg, which is not installed: {error}",
            "python -m pip install 'imageio[ffmpeg]'",
        ) from error


PAPER = (250, 250, 249)
GUTTER = 1 / 60  # of a tile's height


def columns_for(count: int, aspect: float) -> int:
    """Columns that make a sheet of `count` tiles of this width / height about 3:2 wide.

    Among those near that shape the one that leaves the fewest places empty wins.
    """
    ideal = math.sqrt(1.5 * count / aspect)
    near = range(max(1, math.floor(0.75 * ideal)), min(count, math.ceil(1.35 * ideal)) + 1)
    return min(near, key=lambda n: (-count % n, abs(n - ideal), -n), default=count)


STILL = 0.1  # of the mean speed: what stands still has a part of a sheet too


def spread(frames: int, count: int, speeds: Floats | None = None) -> list[int]:
    """`count` of so many frames, at most all, the first and the last among them.

    speeds : (frames,) how fast things move at each; between two that are chosen they move about as
    far, plus STILL of the mean.  None: frames are chosen evenly.
    """
    if speeds is None or speeds.max(initial=0.0) == 0.0:
        return evenly(frames, count).tolist()
    count = min(count, frames)
    between = 0.5 * (speeds[1:] + speeds[:-1]) + STILL * speeds.mean()
    way = np.concatenate([[0.0], np.cumsum(between)])
    wanted = np.linspace(0.0, way[-1], count)
    chosen = np.round(np.interp(wanted, way, np.arange(frames))).astype(int)
    order = np.arange(count)
    chosen = np.maximum.accumulate(chosen - order) + order  # no frame twice
    return list(map(int, np.minimum(chosen, frames - count + order)))


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
