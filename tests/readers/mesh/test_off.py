"""OFF files: polygons stay, and broken lines are named."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from mesh_makers import CORNERS, QUADS, written

from gf_usd.core.errors import InputError
from gf_usd.readers import convert, read_asset

BOX = trimesh.creation.box((1.0, 2.0, 3.0))
OFF = BOX.export(file_type="off")


def test_what_trimesh_writes(tmp_path):
    path = tmp_path / "box.off"
    path.write_text(OFF)
    asset = written(path, tmp_path / "out")
    (box,) = asset.surfaces
    np.testing.assert_allclose(box.points, BOX.vertices, atol=2e-7)  # float32 at 1.5
    assert box.face_indices.reshape(-1, 3).tolist() == BOX.faces.tolist()
    assert asset.facts.up_axis == "Y"


def test_polygons_comments_and_colors(tmp_path):
    path = tmp_path / "cube.off"
    rows = [f"{x} {y} {z} 255 0 0 255" for x, y, z in CORNERS]
    rows += ["# faces", *(f"4 {' '.join(map(str, quad))}" for quad in QUADS)]
    path.write_text("\n".join(["COFF 8 6 12  # counts", *rows]))
    source = convert(path)
    assert "its colors are ignored" in source.notes
    (cube,) = source.asset().surfaces
    assert cube.face_counts.tolist() == [4] * 6
    assert cube.face_indices.tolist() == [i for quad in QUADS for i in quad]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("OFD\n3 1 0\n", "does not begin with OFF or COFF"),
        ("OFF\nthree\n", "the line with the numbers of vertices and faces is missing"),
        (OFF.replace("8 12 0", "9 12 0"), "declares 9 vertices and 12 faces, but 20 lines"),
        (
            "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 5\n",
            "do not refer to any of its 3 points; the first is 5",
        ),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "the first is -1"),
        ("OFF\n3 1 0\n0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n", "line 4: '1 x 0' is not a vertex"),
        ("OFF\n3 1 0\n0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n", "1 of 3 points are not finite"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "line 6: '3 0 1' is not a face"),
        ("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "the file contains no faces"),
        ("version https://git-lfs.github.com/spec/v1\n", "is a git-lfs pointer"),
    ],
)
def test_broken_files_are_refused(tmp_path, data, message):
    path = tmp_path / "a.off"
    path.write_text(data)
    with pytest.raises(InputError) as error:
        read_asset(path)
    assert str(path) in error.value.message
    assert message in error.value.message
    assert error.value.hint
