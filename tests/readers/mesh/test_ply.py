"""PLY files in all three encodings, with what hangs on their points and faces."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import trimesh
from mesh_makers import CORNERS, QUADS, png, written

from gf_usd.core.errors import InputError
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.readers import convert, read_asset

EXACT = 1e-7  # half the rounding step of float32 at size 1
# five quads, and one cut in two: faces that differ in their number of corners
FACES = [*QUADS[:5], QUADS[5][:3], (QUADS[5][0], *QUADS[5][2:])]
HEADER = """ply
format {encoding} 1.0
comment made here
element vertex 8
property float x
property float y
property float z
{vertex}element face {faces}
property list uchar int vertex_indices
{face}end_header
"""


def header(encoding="ascii", vertex="", face="", faces=None) -> bytes:
    faces = len(FACES) if faces is None else faces
    return HEADER.format(encoding=encoding, vertex=vertex, face=face, faces=faces).encode()


def rows(points=CORNERS, faces=FACES) -> bytes:
    text = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    text += "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)
    return text.encode()


def packed(order: str) -> bytes:
    data = b"".join(struct.pack(f"{order}3f", *point) for point in CORNERS)
    return data + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in FACES)


@pytest.mark.parametrize(
    ("encoding", "body"),
    [
        ("ascii", rows()),
        ("binary_little_endian", packed("<")),
        ("binary_big_endian", packed(">")),
    ],
)
def test_polygons_survive_every_encoding(tmp_path, encoding, body):
    path = tmp_path / "cube.ply"
    path.write_bytes(header(encoding) + body)
    (cube,) = written(path, tmp_path / "out").surfaces
    assert cube.path == "/cube/mesh"
    np.testing.assert_allclose(cube.points, CORNERS, atol=EXACT)
    assert cube.face_counts.tolist() == [len(face) for face in FACES]
    assert cube.face_indices.tolist() == [i for face in FACES for i in face]


def test_what_trimesh_writes(tmp_path):
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.visual.vertex_colors = np.tile([128, 0, 255, 255], (len(box.vertices), 1))
    for encoding in ("ascii", "binary"):
        path = tmp_path / f"{encoding}.ply"
        path.write_bytes(box.export(file_type="ply", encoding=encoding, vertex_normal=True))
        (read,) = written(path, tmp_path / "out").surfaces
        np.testing.assert_allclose(read.points, box.vertices, atol=2e-7)  # of size 1.5
        assert read.face_indices.reshape(-1, 3).tolist() == box.faces.tolist()
        np.testing.assert_allclose(read.normals, box.vertex_normals, atol=1e-6)
        assert read.normals_interpolation == "vertex"
        expected = [float(srgb_to_linear(np.array(128 / 255))), 0.0, 1.0]
        np.testing.assert_allclose(read.triangle_colors.reshape(-1, 3), [expected] * 36, atol=EXACT)


def test_colors_of_faces(tmp_path):
    path = tmp_path / "cube.ply"
    face = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    lines = rows().decode().splitlines()
    lines = lines[:8] + [f"{line} {40 * i} 0 255" for i, line in enumerate(lines[8:])]
    path.write_bytes(header(face=face) + "\n".join(lines).encode())
    (cube,) = written(path, tmp_path / "out").surfaces
    red = srgb_to_linear(np.arange(len(FACES)) * 40 / 255)
    np.testing.assert_allclose(cube.triangle_colors[0, :, 0], red[0], atol=EXACT)
    np.testing.assert_allclose(cube.triangle_colors[-1, :, 0], red[-1], atol=EXACT)


def test_texture_coordinates_at_corners_and_at_points(tmp_path):
    (tmp_path / "skin.png").write_bytes(png())
    head = header(face="property list uchar float texcoord\n").replace(
        b"comment made here", b"comment TextureFile skin.png"
    )
    lines = rows().decode().splitlines()
    lines = lines[:8] + [
        f"{line} {2 * len(f)} " + " ".join(f"0.{k} 0.5" for k in range(len(f)))
        for line, f in zip(lines[8:], FACES)
    ]
    path = tmp_path / "corners.ply"
    path.write_bytes(head + "\n".join(lines).encode())
    (cube,) = written(path, tmp_path / "out").surfaces
    assert cube.materials[0].texture.pixels.shape == (2, 4, 3)
    assert set(np.round(cube.triangle_uvs[..., 0].reshape(-1), 6)) == {0.0, 0.1, 0.2, 0.3}
    path = tmp_path / "points.ply"
    lines = [f"{line} {x} {y}" for line, (x, y, _) in zip(rows().decode().splitlines(), CORNERS)]
    head = header(vertex="property float s\nproperty float t\n").replace(
        b"comment made here", b"comment TextureFile skin.png"
    )
    path.write_bytes(head + "\n".join([*lines, *rows().decode().splitlines()[8:]]).encode())
    (cube,) = written(path, tmp_path / "out").surfaces
    np.testing.assert_allclose(cube.triangle_uvs, CORNERS[cube.triangles][..., :2], atol=EXACT)


def test_a_missing_texture_is_said(tmp_path):
    path = tmp_path / "cube.ply"
    head = header().replace(b"comment made here", b"comment TextureFile gone.png")
    path.write_bytes(head + rows())
    assert "its texture gone.png does not exist and is left out" in convert(path).notes


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"plywood", "is not a PLY file"),
        (header("binary_middle_endian") + rows(), "names no valid format"),
        (header(vertex="property half w\n") + rows(), "line 8: 'property half w' has the unknown"),
        (
            header() + rows(faces=FACES[:3]),
            "declares 7 rows of element 'face', but the file holds 3",
        ),
        (header("binary_little_endian") + packed("<")[:60], "8 rows of element 'vertex'"),
        (header("binary_little_endian") + packed("<")[:-3], "but the file holds 6"),
        (header() + rows().replace(b"1.0", b"one", 1), "contains a value that is not a number"),
        (
            header() + rows(faces=[(0, 1, 9), *FACES[1:]]),
            "do not refer to any of its 8 points; the first is 9",
        ),
        (
            header() + rows(faces=[(0, 1, -1), *FACES[1:]]),
            "do not refer to any of its 8 points; the first is -1",
        ),
        (header() + rows().replace(b"1.0", b"nan", 1), "1 of 8 points are not finite"),
        (header(faces=0) + rows(faces=[]), "holds 8 points but no faces"),
        (
            header(vertex="property float f_dc_0\n", faces=0) + b"0 0 0 1\n" * 8,
            "its Gaussian splats have no column opacity",
        ),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a git-lfs pointer"),
    ],
)
def test_broken_files_are_refused(tmp_path, data, message):
    path = tmp_path / "cube.ply"
    path.write_bytes(data)
    with pytest.raises(InputError) as error:
        read_asset(path)
    assert str(path) in error.value.message
    assert message in error.value.message
    assert error.value.hint
