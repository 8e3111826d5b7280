"""SPZ files (Niantic), versions 1 to 3: a gzip stream of 16 bytes of header and one block for each
attribute.

    positions   3 signed 24-bit numbers, over 2^fractionalBits (half floats in version 1)
    alphas      a byte, over 255
    colors      3 bytes: f_dc = (b / 255 - 1/2) / 0.15
    scales      3 bytes: exp(b / 16 - 10)
    rotations   x, y, z as bytes b / 127.5 - 1, w >= 0 (versions 1 and 2); in version 3 a word with
                the index of the largest of (x, y, z, w) and the others as sign and 9 bits of
                |q| sqrt(2)
    sh          a byte for each coefficient and colour: (b - 128) / 128, colours together

The axes are right, up, back: Y is up.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.assets.mesh_data import REPAIR, refuse_pointer
from gf_usd.errors import InputError
from gf_usd.splats import Splats

MAGIC = 0x5053474E
GZIP = b"\x1f\x8b"
VERSIONS = (1, 2, 3)
DEGREES = 4
EXTENSIONS = 0x2
COLOUR = 0.15


def read_spz(path: Path) -> Splats:
    """The Gaussians of an SPZ file.

    Raises InputError for a damaged file and for a version or an extension that is not read.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    stream = _inflate(path, data)
    if len(stream) < 16:
        raise InputError(f"{path} ends within its header", REPAIR)
    magic, version, count, degree, bits, flags, _ = struct.unpack_from("<IIIBBBB", stream)
    if magic != MAGIC:
        raise InputError(
            f"{path} is not an SPZ file: it begins with 0x{magic:08x}, not 0x{MAGIC:08x}",
            "check what the file really is",
        )
    _require(path, version, degree, bits, flags)
    widths = (
        6 if version == 1 else 9,
        1,
        3,
        3,
        4 if version == 3 else 3,
        3 * degree * (degree + 2),
    )
    need = 16 + count * sum(widths)
    if len(stream) < need or not count:
        raise InputError(
            f"{path}: {count} Gaussians of degree {degree} take {need} bytes, it holds "
            f"{len(stream)}",
            "it was cut off or altered, or holds nothing: " + REPAIR,
        )
    blocks, at = [], 16
    for width in widths:
        block = np.frombuffer(stream, np.uint8, count * width, at)
        blocks.append(block.reshape(count, width))
        at += count * width
    places, alphas, colours, scales, rotations, rest = blocks
    harmonics = np.empty((count, (degree + 1) ** 2, 3), np.float32)
    harmonics[:, 0] = (colours / 255.0 - 0.5) / COLOUR
    harmonics[:, 1:] = ((rest - 128.0) / 128.0).reshape(count, -1, 3)
    return Splats(
        positions=_positions(places, version, bits),
        orientations=smallest_three(rotations) if version == 3 else _first_three(rotations),
        scales=np.exp(scales / 16.0 - 10.0),
        opacities=alphas[:, 0] / 255.0,
        harmonics=harmonics,
    )


def _inflate(path: Path, data: bytes) -> bytes:
    """The stream inside the gzip file."""
    if data[:4] == struct.pack("<I", MAGIC):
        version = struct.unpack_from("<I", data, 4)[0] if len(data) >= 8 else 0
        raise _unknown_version(path, version)
    if not data.startswith(GZIP):
        raise InputError(
            f"{path} is not an SPZ file: it is not compressed with gzip",
            "check what the file really is",
        )
    try:
        return gzip.decompress(data)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} is damaged: {error}", REPAIR) from error


def _require(path: Path, version: int, degree: int, bits: int, flags: int) -> None:
    if version not in VERSIONS:
        raise _unknown_version(path, version)
    if degree > DEGREES or bits > 31:
        raise InputError(
            f"{path}: its header names degree {degree} (at most {DEGREES}) and {bits} fractional "
            "bits (at most 31)",
            REPAIR,
        )
    if flags & EXTENSIONS:
        raise InputError(
            f"{path} has vendor extensions, which may change what its numbers mean",
            "export it without extensions, or as PLY",
        )


def _unknown_version(path: Path, version: int) -> InputError:
    return InputError(
        f"{path} is SPZ version {version}; versions 1 to 3 are read",
        "write it as PLY, or as SPZ version 3, for example with splat-transform",
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
