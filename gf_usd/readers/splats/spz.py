"""SPZ files (Niantic), versions 1 to 4: a block for each attribute, in a container.

    positions   3 signed 24-bit numbers, over 2^fractionalBits (half floats in version 1)
    alphas      a byte, over 255
    colors      3 bytes: f_dc = (b / 255 - 1/2) / 0.15
    scales      3 bytes: exp(b / 16 - 10)
    rotations   x, y, z as bytes b / 127.5 - 1, w >= 0 (versions 1 and 2); from version 3 on a word
                with the index of the largest of (x, y, z, w) and the others as sign and 9 bits of
                |q| sqrt(2)
    sh          a byte for each coefficient and color: (b - 128) / 128, colors together

The axes are right, up, back: Y is up.

The container: versions 1 to 3 are one gzip stream with 16 bytes of header, followed by the blocks.
Version 4 has a header of 32 bytes with the offset of a table of (compressed, plain) sizes in 64
bits each; a zstd stream for each block that is not empty follows the table.
"""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.asset import Splats
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR, refuse_pointer

COLOR = 0.15


def read_spz(path: Path) -> Splats:
    """The Gaussians of an SPZ file.

    Raises InputError for a damaged file and for a version or an extension that is not read.
    """
    data = path.read_bytes()
    refuse_pointer(path, data)
    header, blocks = read_blocks(path, data)
    places, alphas, colors, scales, rotations, rest = blocks
    turns = smallest_three if header.version >= 3 else _first_three
    harmonics = np.empty((header.count, (header.degree + 1) ** 2, 3), np.float32)
    harmonics[:, 0] = (colors / 255.0 - 0.5) / COLOR
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


MAGIC = 0x5053474E
GZIP = b"\x1f\x8b"
GZIPPED, STREAMED = (1, 2, 3), 4  # versions
DEGREES = 4
EXTENSIONS = 0x2
DEFLATE = 1032  # bytes that one byte of a gzip stream makes at most
PIECE = 1 << 24  # bytes: a size in a header alone takes no more memory than this


@dataclass(frozen=True, kw_only=True)
class Header:
    """The header of an SPZ file."""

    version: int
    count: int  # of Gaussians
    degree: int  # of their spherical harmonics, 0 to 4
    bits: int  # of the fraction of a position

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes a Gaussian of positions, alphas, colors, scales, rotations and harmonics."""
        place, turn = (6 if self.version == 1 else 9), (4 if self.version >= 3 else 3)
        return place, 1, 3, 3, turn, 3 * self.degree * (self.degree + 2)

    @property
    def size(self) -> int:
        """Bytes of all blocks."""
        return self.count * sum(self.widths)


def read_blocks(path: Path, data: bytes) -> tuple[Header, list[NDArray[np.uint8]]]:
    """The header and the blocks, (count, width) each, of the bytes of an SPZ file.

    Raises InputError for a damaged file and for a version or an extension that is not read.
    """
    if data[:4] == struct.pack("<I", MAGIC):
        header, plain = _streams(path, data)
    elif data.startswith(GZIP):
        header, plain = _inflate(path, data)
    else:
        raise InputError(
            f"{path} is not an SPZ file: it is not compressed with gzip",
            "check the type of the file",
        )
    blocks, at = [], 0
    for width in header.widths:
        block = np.frombuffer(plain, np.uint8, header.count * width, at)
        blocks.append(block.reshape(header.count, width))
        at += header.count * width
    return header, blocks


def _inflate(path: Path, data: bytes) -> tuple[Header, bytes]:
    """Versions 1 to 3."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            header = _header(path, file.read(16))
            if header.version not in GZIPPED:
                raise _unknown_version(path, header.version)
            if header.size > DEFLATE * len(data):
                raise _too_short(path, header, f"which {len(data)} bytes cannot hold")
            return header, _filled(path, header, header.size, file.read)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path} is damaged: {error}", REPAIR) from error


def _streams(path: Path, data: bytes) -> tuple[Header, bytes]:
    """Version 4."""
    import zstandard

    header = _header(path, data[:16])
    if header.version != STREAMED:
        raise _unknown_version(path, header.version)
    sizes = [header.count * width for width in header.widths if width]
    number, table = data[15], struct.unpack_from("<I", data, 16)[0] if len(data) >= 32 else 0
    if number != len(sizes) or table < 32 or len(data) < table + 16 * number:
        raise InputError(
            f"{path}: its header requires {len(sizes)} blocks but declares {number} streams, "
            f"whose sizes are at byte {table} of {len(data)}",
            "the file was truncated or altered: " + REPAIR,
        )
    plain, at = [], table + 16 * number
    for k, size in enumerate(sizes):
        packed, _ = struct.unpack_from("<QQ", data, table + 16 * k)
        reader = zstandard.ZstdDecompressor().stream_reader(data[at : at + packed])
        try:
            plain.append(_filled(path, header, size, reader.read))
        except zstandard.ZstdError as error:
            raise InputError(f"{path} is damaged: {error}", REPAIR) from error
        at += packed
    return header, b"".join(plain)


def _header(path: Path, start: bytes) -> Header:
    if len(start) < 16:
        raise InputError(f"{path} ends within its header", REPAIR)
    magic, version, count, degree, bits, flags, _ = struct.unpack("<IIIBBBB", start)
    if magic != MAGIC:
        raise InputError(
            f"{path} is not an SPZ file: it begins with 0x{magic:08x}, not 0x{MAGIC:08x}",
            "check the type of the file",
        )
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
    header = Header(version=version, count=count, degree=degree, bits=bits)
    if not count:
        raise InputError(f"{path} holds no Gaussians", "export it again, with at least one")
    return header


def _filled(path: Path, header: Header, size: int, read: Callable[[int], bytes]) -> bytes:
    """`size` bytes, piece by piece.  Raises InputError where there are fewer."""
    whole = bytearray()
    while len(whole) < size and (piece := read(min(PIECE, size - len(whole)))):
        whole += piece
    if len(whole) < size:
        raise _too_short(path, header, f"and {size - len(whole)} of them are missing")
    read(1)  # at the end of a gzip stream its checksum is verified
    return bytes(whole)


def _too_short(path: Path, header: Header, have: str) -> InputError:
    return InputError(
        f"{path}: {header.count} Gaussians of degree {header.degree} take {header.size} bytes,"
        f" {have}",
        "the file was truncated or altered: " + REPAIR,
    )


def _unknown_version(path: Path, version: int) -> InputError:
    return InputError(
        f"{path} is SPZ version {version}; versions 1 to 3 in one gzip stream and version 4 in "
        f"separate streams are supported",
        "write it as PLY, or as SPZ version 3, for example with splat-transform",
    )
