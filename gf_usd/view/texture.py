"""Textures as the shading kernel reads them: linear, with their mip levels, end to end."""

from __future__ import annotations

from dataclasses import dataclass
from operator import is_

import numpy as np
from numpy.typing import NDArray

from gf_usd.colour import srgb_to_linear
from gf_usd.model import Texture

LARGEST = 2048  # texels a side; a larger texture is halved first: no picture here shows more
LEVELS = 16
_last: list = []  # the textures of the last atlas, and the atlas
WRAPS = {"repeat": 0, "clamp": 1, "mirror": 2, "black": 3}


@dataclass(frozen=True, kw_only=True)
class Atlas:
    """Every level of every texture."""

    texels: NDArray[np.float32]  # (n, 3) linear, row 0 at the top
    levels: NDArray[np.int32]  # (textures * LEVELS, 3): first texel, width, height
    kinds: NDArray[np.int32]  # (textures, 3): number of levels, wrap s, wrap t


def make_atlas(textures: tuple[Texture, ...]) -> Atlas:
    """Decode the textures to linear and halve each down to one texel (box filter).

    The last atlas is kept: the frames of a film share their textures.
    """
    if _last and len(_last[0]) == len(textures) and all(map(is_, _last[0], textures)):
        return _last[1]
    atlas = _make_atlas(textures)
    _last[:] = [textures, atlas]
    return atlas


def _make_atlas(textures: tuple[Texture, ...]) -> Atlas:
    texels: list[NDArray[np.float32]] = []
    levels = np.zeros((max(1, len(textures)) * LEVELS, 3), dtype=np.int32)
    kinds = np.zeros((max(1, len(textures)), 3), dtype=np.int32)
    start = 0
    for index, texture in enumerate(textures):
        image = _decode(texture)
        while max(image.shape[:2]) > LARGEST:
            image = _halve(image)
        count = 0
        while True:
            height, width = image.shape[:2]
            levels[index * LEVELS + count] = (start, width, height)
            texels.append(image.reshape(-1, 3))
            start += width * height
            count += 1
            if max(width, height) == 1:
                break
            image = _halve(image)
        kinds[index] = (count, WRAPS[texture.wrap_s], WRAPS[texture.wrap_t])
    pixels = np.concatenate(texels) if texels else np.zeros((1, 3), dtype=np.float32)
    return Atlas(texels=np.ascontiguousarray(pixels), levels=levels, kinds=kinds)


def _decode(texture: Texture) -> NDArray[np.float32]:
    codes = np.arange(256) / 255.0
    table = (srgb_to_linear(codes) if texture.srgb else codes).astype(np.float32)
    return table[texture.pixels]


def _halve(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of 2 x 2; an odd last row or column is left out."""
    height, width = (max(1, n // 2) for n in image.shape[:2])
    if image.shape[0] > 1:
        image = 0.5 * (image[0 : 2 * height : 2] + image[1 : 2 * height : 2])
    if image.shape[1] > 1:
        image = 0.5 * (image[:, 0 : 2 * width : 2] + image[:, 1 : 2 * width : 2])
    return image
