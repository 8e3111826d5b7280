"""SPZ files (Niantic), versions 1 to 4: a block for each attribute; `spz_container` finds them.

    positions   3 signed 24-bit numbers, over 2^fractionalBits (half floats in version 1)
    alphas      a byte, over 255
    colors      3 bytes: f_dc = (b / 255 - 1/2) / 0.15
    scales      3 bytes: exp(b / 16 - 10)
    rotations   x, y, z as bytes b / 127.5 - 1, w >= 0 (versions 1 and 2); from version 3 on a word
                with the index of the largest of (x, y, z, w) and the others as sign and 9 bits of
                |q| sqrt(2)
    sh          a byte for each coefficient and colour: (b - 128) / 128, colours together

The axes are right, up, back: Y is up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.assets.mesh_data import refuse_pointer
from gf_usd.assets.spz_container import read_blocks
from gf_usd.splats import Splats

COLOUR = 0.15


def read_spz(path: Path) -> Splats:
    """The Gaussians of an SPZ file.

    Raises InputError for a damaged file and for a version or an extension that is not read.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    header, blocks = read_blocks(path, data)
    places, alphas, colours, scales, rotations, rest = blocks
    turns = smallest_three if header.version >= 3 else _first_three
    harmonics = np.empty((header.count, (header.degree + 1) ** 2, 3), np.float32)
    harmonics[:, 0] = (colours / 255.0 - 0.5) / COLOUR
    harmonics[:, 1:] = ((rest - 128.0) / 128.0).reshape(header.count, -1, 3)
    return Splats(
        positions=_positions(places, header.version, header.bits),
        orientations=turns(rotations),
        scales=np.exp(scales / 16.0 - 10.0),
        opacities=alphas[:, 0] / 255.0,
        harmonics=harmonics,
    )


def _positions(stored: NDArray[np.uint8], version: int, bits: int) -> NDArray[np.float32]:
    if version == 1:
        return np.ascontiguousarray(stored).view("<f2").astype(np.float32)
    three = stored.reshape(len(stored), 3, 3).astype(np.int32)
    whole = three[..., 0] | three[..., 1] << 8 | three[..., 2] << 16
    return ((whole ^ 0x800000) - 0x800000).astype(np.float32) / np.float32(2.0**bits)


def _first_three(stored: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(n, 4) (w, x, y, z) of x, y, z in bytes."""
    xyz = stored / 127.5 - 1.0
    w = np.sqrt(np.maximum(0.0, 1.0 - (xyz**2).sum(axis=1, keepdims=True)))
    return np.concatenate([w, xyz], axis=1)


def smallest_three(stored: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(n, 4) (w, x, y, z) of a word each: index of the largest, then the others from z on down."""
    word = np.ascontiguousarray(stored).view("<u4")[:, 0].astype(np.int64)
    largest = word >> 30
    out = np.zeros((len(word), 4))  # (x, y, z, w)
    rest = word
    for place in (3, 2, 1, 0):
        held = largest != place
        size = (rest & 511) / 511.0 * np.sqrt(0.5)
        out[held, place] = np.where(rest & 512, -size, size)[held]
        rest = np.where(held, rest >> 10, rest)
    rows = np.arange(len(word))
    out[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - (out**2).sum(axis=1)))
    return out[:, [3, 0, 1, 2]]
