"""Encoding of Gaussians as 3DGS PLY or SPZ files; `ply` and `spz` describe the formats."""

from __future__ import annotations

import gzip
import struct

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Splats
from gf_usd.core.errors import BakeError

OPAQUE = 40.0  # the logit of opacity 1, which has none: its sigmoid is 1 in double precision
SPZ_MAGIC, SPZ_VERSION = 0x5053474E, 3
MOST_BITS = 23  # of a fraction in SPZ
SCALE_RANGE = (-10.0, 5.9375)  # logarithms of scales that SPZ can hold


def ply_bytes(splats: Splats) -> bytes:
    """A binary 3DGS PLY: logarithms of scales, logits of opacities, raw coefficients.

    Read again it gives the same numbers, to rounding in single precision.
    """
    count, each = splats.harmonics.shape[:2]
    # all of red first, then green, then blue
    rest = np.swapaxes(splats.harmonics[:, 1:], 1, 2).reshape(count, -1)
    columns = (
        (["x", "y", "z"], splats.positions),
        ([f"f_dc_{i}" for i in range(3)], splats.harmonics[:, 0]),
        ([f"f_rest_{i}" for i in range(3 * (each - 1))], rest),
        (["opacity"], _logit(splats.opacities)[:, None]),
        ([f"scale_{i}" for i in range(3)], np.log(np.asarray(splats.scales, np.float64))),
        ([f"rot_{i}" for i in range(4)], splats.orientations),
    )
    names = [name for group, _ in columns for name in group]
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            f"element vertex {count}",
            *(f"property float {name}" for name in names),
            "end_header\n",
        ]
    )
    body = np.concatenate([np.asarray(values, np.float64) for _, values in columns], axis=1)
    return header.encode("ascii") + body.astype("<f4").tobytes()


def spz_bytes(splats: Splats) -> bytes:
    """An SPZ file of version 3, positions with as many bits of fraction as fit.

    Raises BakeError where a position is too far from the origin for 24 bits.
    """
    count = len(splats)
    farthest = float(np.abs(splats.positions).max())
    bits = min(MOST_BITS, int(np.floor(23.0 - np.log2(max(farthest, 2.0**-MOST_BITS) * 1.0001))))
    if bits < 0:
        raise BakeError(
            f"SPZ cannot hold a position of {farthest:.3g}", "write PLY with --export-ply"
        )
    whole = np.rint(np.asarray(splats.positions, np.float64) * 2.0**bits).astype("<i4")
    places = np.ascontiguousarray(whole).view(np.uint8).reshape(count, 3, 4)[:, :, :3]
    logs = np.clip(np.log(np.asarray(splats.scales, np.float64)), *SCALE_RANGE)
    blocks = (
        places,
        _byte(255.0 * np.asarray(splats.opacities, np.float64)),
        _byte(255.0 * (0.15 * splats.harmonics[:, 0].astype(np.float64) + 0.5)),
        _byte(16.0 * (logs + 10.0)),
        _smallest_three(splats.orientations),
        _byte(128.0 * splats.harmonics[:, 1:].astype(np.float64) + 128.0),
    )
    header = struct.pack("<IIIBBBB", SPZ_MAGIC, SPZ_VERSION, count, splats.degree, bits, 0, 0)
    body = header + b"".join(np.ascontiguousarray(block).tobytes() for block in blocks)
    return gzip.compress(body, mtime=0)


WRITERS = {"ply": ply_bytes, "spz": spz_bytes}


def _logit(opacity: Floats) -> NDArray[np.float64]:
    p = np.asarray(opacity, np.float64)
    with np.errstate(divide="ignore"):
        return np.clip(np.log(p) - np.log1p(-p), -OPAQUE, OPAQUE)


def _byte(values: Floats) -> NDArray[np.uint8]:
    return np.clip(np.rint(values), 0.0, 255.0).astype(np.uint8)


def _smallest_three(wxyz: Floats) -> NDArray[np.uint32]:
    """(n,) words: index of the largest of (x, y, z, w), then sign and nine bits of each other."""
    q = np.asarray(wxyz, np.float64)[:, [1, 2, 3, 0]]
    rows = np.arange(len(q))
    largest = np.abs(q).argmax(axis=1)
    q = q * np.where(q[rows, largest] < 0.0, -1.0, 1.0)[:, None]
    word = largest.astype(np.uint32)
    for place in range(4):
        size = np.rint(511.0 * np.minimum(np.abs(q[:, place]) * np.sqrt(2.0), 1.0))
        field = (q[:, place] < 0.0).astype(np.uint32) << 9 | size.astype(np.uint32)
        word = np.where(largest == place, word, word << 10 | field)
    return word.astype("<u4")
