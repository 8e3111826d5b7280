"""Films as H.264 in MP4 and as animated GIF, encoded by the ffmpeg of imageio[ffmpeg]."""

from __future__ import annotations

import importlib
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.errors import BakeError, GfUsdError, UsageError
from gf_usd.system.atomic_files import partial_path, publish

Pixels = NDArray[np.uint8]

QUALITY = "18"  # x264's constant rate factor: visually lossless
MP4 = (
    "-c:v", "libx264", "-crf", QUALITY, "-preset", "medium", "-pix_fmt", "yuv420p",
    # Rec. 709 with its tags: without them players assume another matrix for small pictures
    "-vf", "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int",
    "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1",
    # the index precedes the data, so that browsers play the film while they load it
    "-movflags", "+faststart",
)  # fmt: skip
MAX_FPS = 50.0  # frames per second: browsers play GIFs with shorter delays than 2/100 s slowly
# The first {0} frames of the stream give the palette; the film consists of the others.  An ordered
# dither pattern is constant in time, so that each frame stores only the rectangle that changes.
PALETTE = (
    "split[a][b];[a]trim=end_frame={0},palettegen[palette];"
    "[b]trim=start_frame={0},setpts=PTS-STARTPTS[film];"
    "[film][palette]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)


def write_mp4(path: Path, frames: Iterable[Pixels], fps: float, size: tuple[int, int]) -> None:
    """Write sRGB frames (H, W, 3) to an MP4 file, atomically.

    Chroma is subsampled (4:2:0), the only format that all players support.

    Parameters
    ----------
    fps : frames per second.   size : (width, height) [pixels], both even.

    Raises
    ------
    UsageError : an odd size, or a folder that does not exist.
    GfUsdError : imageio[ffmpeg] is not installed.
    BakeError : ffmpeg fails; only the partial file remains.
    """
    if size[0] % 2 or size[1] % 2:
        raise UsageError(
            f"a film of {size[0]}x{size[1]} pixels cannot be written as H.264",
            "give an even width and height, e.g. --size 640x480",
        )
    _encode(path, frames, fps, size, MP4)


def write_gif(path: Path, frames: Iterable[Pixels], fps: float, samples: Sequence[Pixels]) -> None:
    """Write sRGB frames (H, W, 3) to a GIF file that loops in real time, atomically.

    Delays are multiples of 1/100 s, rounded so that the errors do not accumulate.

    Parameters
    ----------
    fps : frames per second.   samples : frames of the film, for the palette.

    Raises
    ------
    UsageError : more than 50 frames per second, or a folder that does not exist.
    GfUsdError : imageio[ffmpeg] is not installed.
    BakeError : ffmpeg fails; only the partial file remains.
    """
    if fps > MAX_FPS:
        raise UsageError(
            f"a GIF cannot show {fps:g} frames per second", f"give --fps {MAX_FPS:g} or less"
        )
    height, width, _ = samples[0].shape
    output = ("-filter_complex", PALETTE.format(len(samples)), "-f", "gif", "-loop", "0")
    _encode(path, chain(samples, frames), fps, (width, height), output)


def require_folder(path: Path) -> None:
    """Raise UsageError where the folder of a path does not exist, or the path is a folder."""
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
        _ffmpeg_path(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{size[0]}x{size[1]}", "-r", f"{fps}", "-i", "-",
        *output, "-fflags", "+bitexact", str(partial),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as stderr:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=stderr)
        assert process.stdin is not None
        try:
            with suppress(BrokenPipeError):  # the exit status and stderr give the reason
                for pixels in frames:
                    process.stdin.write(np.ascontiguousarray(pixels).data)
        finally:
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
        if process.returncode:
            stderr.seek(0)
            reason = stderr.read().decode(errors="replace").strip()
            raise BakeError(
                f"ffmpeg could not write {partial}: {reason}",
                "check that this folder is writable and has space left",
            )
    publish(path)


def _ffmpeg_path() -> str:
    """The path of ffmpeg.  Raises GfUsdError where it is not installed."""
    try:
        return importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise GfUsdError(
            f"films need ffmpeg, which is not installed: {error}",
            "python -m pip install 'imageio[ffmpeg]'",
        ) from error
