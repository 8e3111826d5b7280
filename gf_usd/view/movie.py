"""Films as H.264 in MP4, by the ffmpeg that comes with imageio[ffmpeg]."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from gf_usd.errors import BakeError, GfUsdError, UsageError
from gf_usd.publish import partial_path, publish

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
