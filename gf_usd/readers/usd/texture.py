"""Loading of texture files through USD's asset resolver, also from usdz packages."""

from __future__ import annotations

import struct
import warnings
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pxr import Ar, Sdf

from gf_usd.core.asset import Texture
from gf_usd.core.radiance import linear_to_srgb, srgb_to_linear

# Errors that Pillow raises for damaged, truncated, too large or unsupported files.
UNREADABLE = (
    OSError,
    ValueError,
    SyntaxError,
    EOFError,
    struct.error,
    Image.DecompressionBombError,
)
COLOR_MODES = ("RGB", "RGBA", "RGBX", "P", "CMYK", "YCbCr")
WRAPS = ("repeat", "clamp", "mirror", "black")


class Unreadable(Exception):
    """The texture cannot be used; the text is the reason."""


def load_texture(
    asset: Sdf.AssetPath,
    *,
    space: str,
    wraps: tuple[str, str],
    scale: NDArray[np.float64],
    bias: NDArray[np.float64],
    channel: str,
) -> Texture:
    """The texture of an image file, as read by UsdUVTexture.

    Parameters
    ----------
    asset : the authored and resolved path.
    space : sourceColorSpace: "sRGB", "raw" or "auto" (sRGB for 8-bit color images).
    wraps : wrap modes along s and t; unknown ones repeat.
    scale, bias : (3,) applied to linear colors.
    channel : output that is read: "rgb", or one of "r", "g", "b", "a", copied to all three.

    Raises Unreadable for a file that is missing, or that Pillow cannot read.
    """
    if "<UDIM>" in asset.path:
        raise Unreadable(f"texture {asset.path}: UDIM tiles are not supported")
    if not asset.resolvedPath:
        raise Unreadable(f"texture {asset.path} does not exist")
    picture = _picture(asset)
    srgb = space == "sRGB" or (space != "raw" and picture.mode in COLOR_MODES)
    pixels = _pixels(picture, channel)
    if not (np.allclose(scale, 1.0) and np.allclose(bias, 0.0)):
        pixels = _adjusted(pixels, srgb, scale, bias)
    wrap_s, wrap_t = (wrap if wrap in WRAPS else "repeat" for wrap in wraps)
    return Texture(pixels=pixels, srgb=srgb, wrap_s=wrap_s, wrap_t=wrap_t)


def _picture(asset: Sdf.AssetPath) -> Image.Image:
    opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(asset.resolvedPath))
    if not opened or opened.GetSize() == 0:
        raise Unreadable(f"texture {asset.path} cannot be read: it is empty")
    try:
        with warnings.catch_warnings(), opened:
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            picture = Image.open(BytesIO(bytes(opened.GetBuffer())))
            picture.load()
    except UNREADABLE as error:
        raise Unreadable(f"texture {asset.path} cannot be read: {_short(error)}") from error
    return picture


def _short(error: Exception) -> str:
    if isinstance(error, Image.UnidentifiedImageError):
        return "not an image format that Pillow supports"
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def _pixels(picture: Image.Image, channel: str) -> NDArray[np.uint8]:
    """(H, W, 3) pixels; 16-bit and float images are converted to 8 bits."""
    if picture.mode.startswith("I"):
        gray = np.clip(np.asarray(picture, dtype=np.float64) / 257.0, 0.0, 255.0)
        return np.repeat(np.round(gray).astype(np.uint8)[:, :, None], 3, axis=2)
    if picture.mode == "F":
        gray = np.clip(np.nan_to_num(np.asarray(picture, dtype=np.float64)), 0.0, 1.0)
        return np.repeat(np.round(255.0 * gray).astype(np.uint8)[:, :, None], 3, axis=2)
    if channel == "rgb":
        return np.asarray(picture.convert("RGB"))
    plane = np.asarray(picture.convert("RGBA"))[:, :, "rgba".index(channel)]
    return np.repeat(plane[:, :, None], 3, axis=2)


def _adjusted(
    pixels: NDArray[np.uint8], srgb: bool, scale: NDArray[np.float64], bias: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """scale * linear + bias, clipped, in the encoding of the pixels."""
    level = np.arange(256) / 255.0
    linear = srgb_to_linear(level) if srgb else level
    table = np.clip(linear[:, None] * scale + bias, 0.0, 1.0)
    if srgb:
        table = linear_to_srgb(table)
    table = np.round(255.0 * table).astype(np.uint8)
    return np.stack([table[pixels[:, :, c], c] for c in range(3)], axis=2)
