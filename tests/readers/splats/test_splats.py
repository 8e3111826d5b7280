"""Splat files of every format: numbers written by hand, round trips, and what is refused."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from captures import Y_0, ball, write_ply

from gf_usd.core.errors import InputError
from gf_usd.readers import convert, read_asset
from gf_usd.readers.splats.ply import holds_splats, read_splat_ply
from gf_usd.readers.splats.spz import read_spz
from gf_usd.readers.splats.write import ply_bytes, spz_bytes

SANITY = Path(__file__).parents[2] / "assets" / "SanitySplats.spz"
SINGLE = 3e-7  # a few roundings of float32, relative
NAMES = ("positions", "orientations", "scales", "opacities", "harmonics")


def vertex_header(names, count=1, extra=""):
    lines = "".join(f"property float {name}\n" for name in names)
    return (
        f"ply\nformat binary_little_endian 1.0\n{extra}element vertex {count}\n{lines}end_header\n"
    ).encode()


def same_turn(a, b, atol):
    """q and -q are one rotation."""
    sign = np.sign((a * b).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(a, sign * b, atol=atol)


def test_a_ply_by_hand(tmp_path):
    """Columns in an order of their own: names count, and red comes before green before blue."""
    rest = [f"f_rest_{i}" for i in range(9)]
    names = ["opacity", *rest, "x", "y", "z", "rot_0", "rot_1", "rot_2", "rot_3"]
    names += ["scale_0", "scale_1", "scale_2", "f_dc_0", "f_dc_1", "f_dc_2"]
    values = [np.log(3.0), *range(1, 10), 0.5, -1.0, 2.0, 0.0, 2.0, 0.0, 0.0]
    values += [0.0, np.log(2.0), np.log(0.1), 0.1, 0.2, 0.3]
    path = tmp_path / "one.ply"
    path.write_bytes(vertex_header(names) + struct.pack(f"<{len(values)}f", *values))
    splats = read_asset(path).splats[0]
    np.testing.assert_array_equal(splats.positions, [[0.5, -1.0, 2.0]])
    np.testing.assert_allclose(splats.orientations, [[0.0, 1.0, 0.0, 0.0]], rtol=SINGLE)
    np.testing.assert_allclose(splats.scales, [[1.0, 2.0, 0.1]], rtol=SINGLE)
    np.testing.assert_allclose(splats.opacities, [0.75], rtol=SINGLE)
    expected = [[0.1, 0.2, 0.3], [1, 4, 7], [2, 5, 8], [3, 6, 9]]
    np.testing.assert_allclose(splats.harmonics, [expected], rtol=SINGLE)
    assert splats.degree == 1


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_ply_to_usd_to_ply(tmp_path, degree):
    """Into the source layer and out again: the same numbers, to rounding."""
    rest = ball(60, degree=degree)
    first = read_splat_ply(write_ply(tmp_path / "ball.ply", rest))
    converted = convert(tmp_path / "ball.ply")
    layer = converted.write(tmp_path / "ball.source.usdc")
    there = read_asset(layer).splats[0]
    again = read_splat_ply(write_ply(tmp_path / "again.ply", there))
    for found in (first, there, again):
        for name in NAMES:
            np.testing.assert_allclose(
                getattr(found, name), getattr(rest, name), rtol=SINGLE, atol=1e-7, err_msg=name
            )
        assert found.degree == degree


def test_opacities_survive_their_logits(tmp_path):
    rest = ball(5)
    values = np.float32([0.0, 1e-3, 0.5, 1.0 - 1e-3, 1.0])
    rest = type(rest)(**{**vars(rest), "opacities": values})
    path = tmp_path / "ball.ply"
    path.write_bytes(ply_bytes(rest))
    # 0 has no logit: what stands for it is below what any picture shows
    np.testing.assert_allclose(read_splat_ply(path).opacities, values, rtol=SINGLE, atol=1e-17)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spz_round_trip(tmp_path, degree):
    """To half a step of what each number is stored in."""
    rest = ball(200, degree=degree)
    path = tmp_path / "ball.spz"
    path.write_bytes(spz_bytes(rest))
    found = read_spz(path)
    # 0.5 needs no bit before the point: 23 bits are left
    np.testing.assert_allclose(found.positions, rest.positions, atol=0.6 / 2**23)
    np.testing.assert_allclose(np.log(found.scales), np.log(rest.scales), atol=0.51 / 16)
    np.testing.assert_allclose(found.opacities, rest.opacities, atol=0.51 / 255)
    dc, more = np.split(found.harmonics - rest.harmonics, [1], axis=1)
    assert np.abs(dc).max() < 0.51 / 255 / 0.15
    assert np.abs(more).max(initial=0.0) < 0.51 / 128
    # three numbers of a step of 1 / 511 / sqrt(2) each, and the fourth that follows from them
    same_turn(found.orientations, rest.orientations, 3 * 0.51 / 511 / np.sqrt(2))


def test_the_sanity_file_of_the_spz_plugins():
    """Version 2: the numbers that its bytes mean."""
    splats = read_asset(SANITY).splats[0]
    raw = gzip.decompress(SANITY.read_bytes())
    assert struct.unpack_from("<IIIBBBB", raw) == (0x5053474E, 2, 10, 3, 12, 0, 0)
    assert (len(splats), splats.degree) == (10, 3)
    step = 3277 / 4096
    assert splats.positions[1].tolist() == [np.float32(step), 0.0, 0.0]
    assert splats.positions[9].tolist() == [np.float32(2 * step), np.float32(2 * step), 0.0]
    alphas = np.frombuffer(raw, np.uint8, 10, 16 + 90)
    np.testing.assert_array_equal(splats.opacities.astype(np.float32), np.float32(alphas / 255))
    colors = np.frombuffer(raw, np.uint8, 30, 16 + 100).reshape(10, 3)
    np.testing.assert_allclose(
        splats.harmonics[:, 0], (colors / 255 - 0.5) / 0.15, rtol=SINGLE, atol=1e-7
    )
    scales = np.frombuffer(raw, np.uint8, 30, 16 + 130).reshape(10, 3)
    np.testing.assert_allclose(splats.scales, np.exp(scales / 16 - 10), rtol=SINGLE)
    rest = np.frombuffer(raw, np.uint8, 450, 16 + 190).reshape(10, 15, 3)
    np.testing.assert_array_equal(splats.harmonics[:, 1:], np.float32((rest - 128.0) / 128))


def test_negative_positions_in_24_bits(tmp_path):
    body = b"".join(
        [
            *(struct.pack("<i", value)[:3] for value in (-1, -(2**23), 2**23 - 1)),
            bytes([255, 128, 128, 128, 160, 160, 160, 255, 128, 128]),
        ]
    )
    path = tmp_path / "one.spz"
    path.write_bytes(gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 2, 1, 0, 12, 0, 0) + body))
    splats = read_spz(path)
    np.testing.assert_array_equal(splats.positions[0], [-1 / 4096, -2048, 2048 - 1 / 4096])
    np.testing.assert_allclose(splats.scales, 1.0)
    assert splats.orientations[0, 1] == 1.0


def test_splat_rows_by_hand(tmp_path):
    row = struct.pack("<6f", 1, 2, 3, 0.1, 0.2, 0.3) + bytes([255, 0, 51, 102, 128, 0, 128, 128])
    path = tmp_path / "one.splat"
    path.write_bytes(row)
    splats = read_asset(path).splats[0]
    np.testing.assert_array_equal(splats.positions, [[1, 2, 3]])
    np.testing.assert_array_equal(splats.scales, np.float32([[0.1, 0.2, 0.3]]))
    np.testing.assert_allclose(splats.opacities, [0.4], rtol=SINGLE)
    np.testing.assert_allclose(splats.orientations, [[0, -1, 0, 0]], atol=SINGLE)
    shown = splats.harmonics[:, 0] * Y_0 + 0.5
    np.testing.assert_allclose(shown, [[1.0, 0.0, 0.2]], atol=SINGLE)


def packed_file(path, *, colors=True, bands=0):
    """Two Gaussians in one chunk: both ends of every range, and two quaternions."""
    names = [f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"]
    limits = [-1, -2, -3, 1, 2, 3, -4, -4, -4, -2, -2, -2]
    if colors:
        names += [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"]
        limits += [0.2, 0.2, 0.2, 0.6, 0.6, 0.6]
    words = [
        (0, 0x3FF << 20 | 0x200 << 10 | 0x200, 0, 0x000000FF),
        (0xFFFFFFFF, 3 << 30 | 0x200 << 20 | 0x200 << 10, 0xFFFFFFFF, 0xFFFFFF00),
    ]
    header = ["ply", "format binary_little_endian 1.0", "element chunk 1"]
    header += [f"property float {name}" for name in names] + ["element vertex 2"]
    header += [
        f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")
    ]
    sh = b""
    if bands:
        header += ["element sh 2", *(f"property uchar f_rest_{i}" for i in range(bands))]
        sh = bytes([*range(bands)]) + bytes([255] * bands)
    body = struct.pack(f"<{len(limits)}f", *limits)
    body += b"".join(struct.pack("<4I", *row) for row in words)
    path.write_bytes(("\n".join(header) + "\nend_header\n").encode() + body + sh)
    return path


def test_packed_ply_by_hand(tmp_path):
    splats = read_asset(packed_file(tmp_path / "two.compressed.ply")).splats[0]
    np.testing.assert_array_equal(splats.positions, [[-1, -2, -3], [1, 2, 3]])
    np.testing.assert_allclose(np.log(splats.scales), [[-4] * 3, [-2] * 3], rtol=SINGLE)
    np.testing.assert_allclose(splats.opacities, [1.0, 0.0])
    shown = splats.harmonics[:, 0] * Y_0 + 0.5
    np.testing.assert_allclose(shown, [[0.2] * 3, [0.6] * 3], rtol=1e-6)
    # w is left out and x is as large as it can be; then z is left out and y is least
    near = (0x200 / 0x3FF - 0.5) * np.sqrt(2)
    root = np.sqrt(0.5)
    w = np.sqrt(1.0 - 0.5 - 2 * near**2)
    np.testing.assert_allclose(splats.orientations[0], [w, root, near, near], atol=SINGLE)
    z = np.sqrt(1.0 - 0.5 - 2 * near**2)
    np.testing.assert_allclose(splats.orientations[1], [near, near, -root, z], atol=SINGLE)


def test_packed_ply_of_an_older_kind_and_with_harmonics(tmp_path):
    path = packed_file(tmp_path / "two.ply", colors=False, bands=9)
    splats = read_splat_ply(path)
    shown = splats.harmonics[:, 0] * Y_0 + 0.5
    np.testing.assert_allclose(shown, [[0.0] * 3, [1.0] * 3], atol=1e-6)
    byte = np.array([[0, 3, 6], [1, 4, 7], [2, 5, 8]])
    expected = np.where(byte == 0, -4.0, (byte + 0.5) / 32 - 4)
    np.testing.assert_allclose(splats.harmonics[0, 1:], expected)
    np.testing.assert_allclose(splats.harmonics[1, 1:], 4.0)


def test_a_mesh_is_no_capture(tmp_path):
    path = tmp_path / "mesh.ply"
    path.write_text("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n")
    assert not holds_splats(path)
    assert holds_splats(write_ply(tmp_path / "ball.ply", ball(5)))


def without(name):
    def spoil(path):
        names = ["x", "y", "z", "opacity", *(f"f_dc_{i}" for i in range(3))]
        names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
        names.remove(name)
        path.write_bytes(vertex_header(names) + bytes(4 * len(names)))

    return spoil


def spz(version=2, count=1, degree=0, flags=0, body=bytes(19)):
    header = struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, 12, flags, 0)
    return lambda path: path.write_bytes(gzip.compress(header + body))


def raw(data):
    return lambda path: path.write_bytes(data)


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        ("a.ply", without("rot_2"), "no column rot_2"),
        ("a.ply", without("opacity"), "no column opacity"),
        (
            "a.ply",
            raw(ply_bytes(ball(9))[:-4]),
            "declares 9 rows of element 'vertex', but the file holds 8",
        ),
        (
            "a.ply",
            raw(ply_bytes(ball(9, degree=1)).replace(b"f_rest_8", b"f_last_8")),
            "8 columns f_rest",
        ),
        *(
            ("a.ply", raw(ply_bytes(ball(9, degree=d)).replace(b"vertex 9", b"vertex 0")), "its 0")
            for d in (0, 3)
        ),
        ("a.splat", raw(bytes(33)), "33 bytes, which is not a multiple of 32"),
        ("a.splat", raw(bytes(32)), "none of its 1 Gaussians"),
        ("a.spz", raw(b"nothing of the kind"), "not compressed with gzip"),
        ("a.spz", raw(SANITY.read_bytes()[:60]), "is damaged"),
        ("a.spz", spz(version=9), "is SPZ version 9"),
        ("a.spz", spz(flags=2), "has vendor extensions"),
        ("a.spz", spz(degree=7), "names degree 7"),
        (
            "a.spz",
            spz(count=2),
            "2 Gaussians of degree 0 take 38 bytes, and 19 of them are missing",
        ),
        ("a.spz", raw(gzip.compress(bytes(40))), "begins with 0x00000000"),
        ("a.spz", raw(gzip.compress(bytes(4))), "ends within its header"),
    ],
)
def test_what_is_refused(tmp_path, name, spoil, message):
    path = tmp_path / name
    spoil(path)
    with pytest.raises(InputError, match=message):
        read_asset(path)


def test_units_and_axes(tmp_path):
    """-Y: the file hangs, and a half turn about x puts it upright."""
    path = write_ply(tmp_path / "ball.ply", ball(20))
    asset = read_asset(path, up_axis="-Y", meters_per_unit=0.01)
    splats = asset.splats[0]
    assert asset.facts.up_axis == "Y"
    np.testing.assert_allclose(
        splats.points, 0.01 * splats.positions * np.array([1, -1, -1]), atol=1e-9
    )
    assert any("-Y, as requested" in note for note in asset.facts.notes)
    assert read_asset(path, up_axis="z").facts.up_axis == "Z"
    with pytest.raises(InputError, match="it must be Y, Z, -Y or -Z"):
        read_asset(path, up_axis="X")
    assert (asset.facts.unit_from, asset.facts.axis_from) == ("option", "option")
    facts = read_asset(path).facts
    assumed = facts.notes
    (note,) = (note for note in assumed if "state no unit and no up axis" in note)
    assert "1 m per unit is assumed (--meters-per-unit), and Y up (--up-axis, or -Y" in note
    assert (facts.unit_from, facts.axis_from) == ("assumed", "assumed")
