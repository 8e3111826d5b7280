# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Textures: the mipmaps of a scene's textures in one array, and filtered look-ups in kernels."""

from dataclasses import dataclass
from operator import is_

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.asset import Texture
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.system.taichi_runtime import import_taichi
from gf_usd.view.render.raster import row, vec3

ti = import_taichi()

LARGEST = 2048  # [texels] of a side; larger textures are downsampled: images show no more
LEVELS = 16  # of a mipmap at most
_cache: list = []  # the textures of the last atlas, and the atlas
WRAPS = {"repeat": 0, "clamp": 1, "mirror": 2, "black": 3}


@dataclass(frozen=True, kw_only=True)
class Atlas:
    """All mipmap levels of all textures."""

    texels: NDArray[np.float32]  # (n, 3) linear, row 0 at the top
    levels: NDArray[np.int32]  # (textures * LEVELS, 3): first texel, width, height
    kinds: NDArray[np.int32]  # (textures, 3): number of levels, wrap s, wrap t


def make_atlas(textures: tuple[Texture, ...]) -> Atlas:
    """Decode textures to linear color and build their mipmaps with a box filter.

    The last atlas is cached: all frames of a film have the same textures.
    """
    if _cache and len(_cache[0]) == len(textures) and all(map(is_, _cache[0], textures)):
        return _cache[1]
    atlas = _build_mipmaps(textures)
    _cache[:] = [textures, atlas]
    return atlas


def _build_mipmaps(textures: tuple[Texture, ...]) -> Atlas:
    texels: list[NDArray[np.float32]] = []
    levels = np.zeros((max(1, len(textures)) * LEVELS, 3), dtype=np.int32)
    kinds = np.zeros((max(1, len(textures)), 3), dtype=np.int32)
    start = 0
    for index, texture in enumerate(textures):
        image = _decode_to_linear(texture)
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


def _decode_to_linear(texture: Texture) -> NDArray[np.float32]:
    codes = np.arange(256) / 255.0
    table = (srgb_to_linear(codes) if texture.srgb else codes).astype(np.float32)
    return table[texture.pixels]


def _halve(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The next mipmap level: the mean of 2 x 2 texels, without an odd last row or column."""
    height, width = (max(1, n // 2) for n in image.shape[:2])
    if image.shape[0] > 1:
        image = 0.5 * (image[0 : 2 * height : 2] + image[1 : 2 * height : 2])
    if image.shape[1] > 1:
        image = 0.5 * (image[:, 0 : 2 * width : 2] + image[:, 1 : 2 * width : 2])
    return image


@ti.func
def wrap_index(i, size, kind):
    """Texel index in 0..size - 1 by the wrap mode `kind` of WRAPS; -1 for black."""
    j = i
    if kind == 1:
        j = ti.min(size - 1, ti.max(0, i))
    elif kind == 2:
        j = ti.raw_mod(ti.raw_mod(i, 2 * size) + 2 * size, 2 * size)
        if j >= size:
            j = 2 * size - 1 - j
    elif kind == 3:
        if i < 0 or i >= size:
            j = -1
    else:
        j = ti.raw_mod(ti.raw_mod(i, size) + size, size)
    return j


@ti.func
def bilinear(texels: ti.template(), levels: ti.template(), kinds: ti.template(), k, level, uv):
    """Texture k at one mipmap level, bilinear; texel centers are at half-integers."""
    start, w, h = (
        levels[k * LEVELS + level, 0],
        levels[k * LEVELS + level, 1],
        levels[k * LEVELS + level, 2],
    )
    a, b = uv[0] * w - 0.5, (1.0 - uv[1]) * h - 0.5
    fa, fb = ti.floor(a), ti.floor(b)
    out = vec3(0.0)
    for j in range(2):
        for i in range(2):
            x = wrap_index(ti.cast(fa, ti.i32) + i, w, kinds[k, 1])
            y = wrap_index(ti.cast(fb, ti.i32) + j, h, kinds[k, 2])
            s = a - fa if i == 1 else 1.0 - (a - fa)
            t = b - fb if j == 1 else 1.0 - (b - fb)
            if x >= 0 and y >= 0:
                out += s * t * row(texels, start + y * w + x)
    return out


@ti.func
def sample_texture(
    texels: ti.template(), levels: ti.template(), kinds: ti.template(), k, uv, du, dv
):
    """Texture k, anisotropic: up to 4 trilinear taps along the long axis of the footprint.

    du, dv : derivatives of uv along x and y of the image [per sample].
    """
    w, h = levels[k * LEVELS, 1], levels[k * LEVELS, 2]
    a = ti.Vector([du[0] * w, du[1] * h])
    b = ti.Vector([dv[0] * w, dv[1] * h])
    long, short, axis = a.norm(), b.norm(), du
    if short > long:
        long, short, axis = short, long, dv
    taps = ti.cast(ti.min(4.0, ti.max(1.0, ti.ceil(long / ti.max(short, 1e-6)))), ti.i32)
    level = ti.log(ti.max(1.0, long / taps)) / ti.log(2.0)
    top = kinds[k, 0] - 1
    low = ti.min(top, ti.cast(level, ti.i32))
    mix = ti.min(1.0, level - low)
    out = vec3(0.0)
    for i in range(taps):
        q = uv + ((i + 0.5) / taps - 0.5) * axis
        near = bilinear(texels, levels, kinds, k, low, q)
        if mix > 0.0 and low < top:
            far = bilinear(texels, levels, kinds, k, low + 1, q)
            near += mix * (far - near)
        out += near / taps
    return out
