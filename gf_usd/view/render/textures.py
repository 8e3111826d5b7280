"""Textures as the shading kernel reads them: linear, with their mip levels, end to end.

Smooth normals with creases, for meshes that author none.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import is_

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Texture
from gf_usd.core.radiance import srgb_to_linear

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


def corner_normals(points: Floats, triangles: Ints, crease_angle: float) -> NDArray[np.float32]:
    """Unit normals (T, 3, 3) at triangle corners.

    n(corner of f at v) = sum of angle_g n_g over the triangles g around v whose plane meets that
    of f at no more than the crease angle; angle_g is the corner's own angle [Thurmer and
    Wuthrich 1998], so that the cut of a quad into triangles does not show.

    Parameters
    ----------
    points : (V, 3).   triangles : (T, 3).   crease_angle : [deg]; 180 smooths everything.
    """
    triangles = np.asarray(triangles, dtype=np.int64)
    corners = np.asarray(points, dtype=np.float64)[triangles]
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    normal = np.cross(ahead[:, 0], behind[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    across = np.linalg.norm(np.cross(ahead, behind), axis=2)
    angle = np.arctan2(across, np.einsum("tci,tci->tc", ahead, behind))

    face = np.repeat(np.arange(len(triangles)), 3)
    vertex = triangles.ravel()
    mine, other = _pairs(vertex)
    close = np.einsum("pi,pi->p", normal[face[mine]], normal[face[other]])
    keep = close >= np.cos(np.radians(crease_angle)) - 1e-9
    weight = np.where(keep, angle.ravel()[other], 0.0)
    total = np.stack(
        [
            np.bincount(mine, weight * normal[face[other], axis], minlength=len(vertex))
            for axis in range(3)
        ],
        axis=1,
    )
    size = np.linalg.norm(total, axis=1, keepdims=True)
    smooth = np.divide(total, size, out=normal[face].copy(), where=size > 1e-12)
    return smooth.reshape(-1, 3, 3).astype(np.float32)


def _pairs(vertex: Ints) -> tuple[Ints, Ints]:
    """All ordered pairs of corners that share a vertex, each corner with itself included."""
    order = np.argsort(vertex, kind="stable")
    _, start, count = np.unique(vertex[order], return_index=True, return_counts=True)
    repeats = np.repeat(count, count)  # for each corner in order: how many it pairs with
    first = np.repeat(np.repeat(start, count), repeats)
    offset = np.arange(int(repeats.sum())) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    return np.repeat(order, repeats), order[first + offset]
