"""From linear light to a file: tone curve, sRGB, dither, PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gf_usd.colour import linear_to_srgb
from gf_usd.errors import UsageError
from gf_usd.model import Floats

KNEE = 0.65  # below it colours stay as they are


def tone(linear: Floats) -> NDArray[np.floating]:
    """x below the knee k, k + (1 - k) tanh((x - k) / (1 - k)) above: film's soft shoulder."""
    x = np.maximum(linear, 0.0)
    return np.where(x < KNEE, x, KNEE + (1 - KNEE) * np.tanh((x - KNEE) / (1 - KNEE)))


def untone(shown: Floats) -> NDArray[np.floating]:
    """The linear value that `tone` shows as `shown` (0..1; nearly white at most)."""
    y = np.clip(shown, 0.0, 0.998)
    high = np.arctanh(np.maximum(y - KNEE, 0.0) / (1 - KNEE))
    return np.where(y < KNEE, y, KNEE + (1 - KNEE) * high)


def encode(linear: Floats) -> NDArray[np.uint8]:
    """8-bit sRGB (H, W, 3) of linear light (H, W, 3).

    A fixed pattern of less than one step [interleaved gradient noise, Jimenez 2014] is added
    before rounding, so that a gradient shows no bands and a picture is the same every time.
    """
    y, x = np.mgrid[0 : linear.shape[0], 0 : linear.shape[1]]
    noise = np.modf(52.9829189 * np.modf(0.06711056 * x + 0.00583715 * y)[0])[0]
    codes = 255.0 * linear_to_srgb(tone(linear)) + noise[..., None]
    return np.clip(np.floor(codes), 0, 255).astype(np.uint8)


def write_png(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write pixels (H, W, 3) sRGB; the file appears whole or not at all.

    Raises UsageError where the folder does not exist or may not be written.
    """
    partial = path.with_name(f"{path.stem}.partial{path.suffix}")
    try:
        Image.fromarray(pixels).save(partial, format="PNG", optimize=True)
        partial.replace(path)
    except OSError as error:
        raise UsageError(
            f"The picture {path} cannot be written: {error.strerror or error}.",
            "choose a folder that exists and that you may write to, with -o",
        ) from error
