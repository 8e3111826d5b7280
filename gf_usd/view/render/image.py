"""From linear light to an 8-bit image file: tone curve, sRGB, dither, PNG."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.radiance import linear_to_srgb

KNEE = 0.65  # the tone curve is the identity below


def tone(linear: Floats) -> NDArray[np.floating]:
    """Tone curve: x below the knee k, k + (1 - k) tanh((x - k) / (1 - k)) above."""
    x = np.maximum(linear, 0.0)
    return np.where(x < KNEE, x, KNEE + (1 - KNEE) * np.tanh((x - KNEE) / (1 - KNEE)))


def untone(toned: Floats) -> NDArray[np.floating]:
    """Inverse of `tone` for values 0..1, clipped to 0.998, above which it diverges."""
    y = np.clip(toned, 0.0, 0.998)
    high = np.arctanh(np.maximum(y - KNEE, 0.0) / (1 - KNEE))
    return np.where(y < KNEE, y, KNEE + (1 - KNEE) * high)


def encode(linear: Floats) -> NDArray[np.uint8]:
    """8-bit sRGB (H, W, 3) of linear light (H, W, 3).

    A fixed dither pattern of less than one step [interleaved gradient noise, Jimenez 2014] is added
    before rounding: gradients show no bands, and the result is deterministic.
    """
    codes = 255.0 * linear_to_srgb(tone(linear)) + _dither(*linear.shape[:2])[..., None]
    np.floor(codes, out=codes)
    return np.clip(codes, 0, 255, out=codes).astype(np.uint8)


@lru_cache(maxsize=1)  # all frames of a film have it
def _dither(height: int, width: int) -> NDArray[np.float64]:
    """The dither pattern (H, W), 0 to 1."""
    y, x = np.mgrid[0:height, 0:width]
    noise = np.modf(52.9829189 * np.modf(0.06711056 * x + 0.00583715 * y)[0])[0]
    noise.setflags(write=False)
    return noise


def write_png(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write sRGB pixels (H, W, 3) to a PNG file, atomically.

    Raises UsageError where the folder does not exist or may not be written.
    """
    partial = path.with_name(f"{path.stem}.partial{path.suffix}")
    try:
        Image.fromarray(pixels).save(partial, format="PNG", optimize=True)
        partial.replace(path)
    except OSError as error:
        raise UsageError(
            f"the image {path} cannot be written: {error.strerror or error}",
            "choose a folder that exists and is writable, with -o",
        ) from error
