"""Both containers of SPZ: the same blocks, and what is refused without making room for it."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest
import zstandard
from captures import ball

from gf_usd.core.errors import InputError
from gf_usd.readers.splats.spz import read_blocks, read_spz
from gf_usd.readers.splats.write import spz_bytes

NAMES = ("positions", "orientations", "scales", "opacities", "harmonics")
MAGIC = 0x5053474E


def streamed(version_3: bytes, *, extra: bytes = b"", size: int | None = None) -> bytes:
    """The same Gaussians as version 4, with bytes between the header and the table."""
    plain = gzip.decompress(version_3)
    _, _, count, degree, bits, flags, _ = struct.unpack_from("<IIIBBBB", plain)
    at, table, streams = 16, b"", b""
    widths = (9, 1, 3, 3, 4, 3 * degree * (degree + 2))
    held = [count * width for width in widths if width]
    for block in held:
        packed = zstandard.ZstdCompressor().compress(plain[at : at + block])
        table += struct.pack("<QQ", len(packed), block)
        streams += packed
        at += block
    count = count if size is None else size
    start = struct.pack("<IIIBBBB", MAGIC, 4, count, degree, bits, flags, len(held))
    return start + struct.pack("<I12x", 32 + len(extra)) + extra + table + streams


@pytest.mark.parametrize("extra", [b"", b"of a program"])
@pytest.mark.parametrize("degree", [0, 3])
def test_version_4_is_version_3_in_streams(tmp_path, degree, extra):
    third = spz_bytes(ball(300, degree=degree))
    (tmp_path / "3.spz").write_bytes(third)
    (tmp_path / "4.spz").write_bytes(streamed(third, extra=extra))
    expected, found = read_spz(tmp_path / "3.spz"), read_spz(tmp_path / "4.spz")
    assert found.degree == degree
    for name in NAMES:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


def spoiled(data: bytes, at: int, *values: int) -> bytes:
    return data[:at] + bytes(values) + data[at + len(values) :]


WHOLE = streamed(spz_bytes(ball(60, degree=1)))
TABLE = 32 + 16 * 6
HUGE = gzip.compress(struct.pack("<IIIBBBB", MAGIC, 3, 2**32 - 1, 3, 12, 0, 0) + bytes(65))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (WHOLE[:20], "declares 6 streams, whose sizes are at byte 0 of 20"),
        (WHOLE[:90], "requires 6 blocks but declares 6 streams, whose sizes are at byte 32 of 90"),
        (spoiled(WHOLE, 15, 5), "requires 6 blocks but declares 5 streams"),
        (WHOLE[:-40], "60 Gaussians of degree 1 take 1740 bytes, and .* are missing"),
        (spoiled(WHOLE, TABLE, 9, 9, 9, 9), "is damaged"),
        (spoiled(WHOLE, 4, 5), "is SPZ version 5"),
        (gzip.compress(WHOLE), "is SPZ version 4; versions 1 to 3 in one gzip stream"),
        (spoiled(WHOLE, 8, 0, 0, 0, 0), "holds no Gaussians"),
        (spoiled(WHOLE, 12, 0), "requires 5 blocks but declares 6 streams"),
        (streamed(spz_bytes(ball(60)), size=2**32 - 1), "take 85899345900 bytes, and .* missing"),
        (HUGE, "4294967295 Gaussians of degree 3 take 279172874175 bytes, which .* cannot hold"),
    ],
    ids=[
        *("header", "table", "fewer", "cut", "stream", "version", "gzip", "none", "degree", "many"),
        "huge",
    ],
)
def test_what_is_refused(tmp_path, data, message):
    with pytest.raises(InputError, match=message):
        read_blocks(tmp_path / "a.spz", data)
