"""STL files as trimesh writes them, and as they should not be."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from mesh_makers import written

from gf_usd.core.errors import InputError
from gf_usd.core.mesh.topology import boundary_edges
from gf_usd.readers import convert, read_asset

BOX = trimesh.creation.box((1.0, 2.0, 3.0))
STL = BOX.export(file_type="stl")
TEXT = BOX.export(file_type="stl_ascii")


@pytest.mark.parametrize("data", [STL, TEXT.encode()], ids=["binary", "text"])
def test_stl_corners_in_one_place_are_one_point(tmp_path, data):
    path = tmp_path / "box.stl"
    path.write_bytes(data)
    asset = written(path, tmp_path / "out")
    (box,) = asset.surfaces
    assert len(box.points) == 8
    assert len(boundary_edges(box.triangles)) == 0
    # float32 at 1.5
    np.testing.assert_allclose(box.points[box.triangles], BOX.triangles, atol=2e-7)
    assert asset.facts.up_axis == "Z"
    assert box.normals is None


def test_stl_solids_are_meshes(tmp_path):
    other = BOX.copy()
    other.apply_translation((5.0, 0.0, 0.0))
    path = tmp_path / "two.stl"
    named = TEXT.replace("solid ", "solid left", 1)
    path.write_text(named + other.export(file_type="stl_ascii").replace("solid ", "solid b c", 1))
    asset = written(path, tmp_path / "out")
    assert [s.path for s in asset.surfaces] == ["/two/left", "/two/b_c"]


def test_bytes_after_the_triangles_are_left_out(tmp_path):
    path = tmp_path / "box.stl"
    path.write_bytes(STL + b"\0" * 7)
    source = convert(path)
    assert len(source.asset().surfaces[0].triangles) == 12
    assert "the file ends with 7 bytes after its 12 triangles: ignored" in source.notes


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (STL[:300], "a binary file with 12 triangles has 684 bytes, but this file has 300"),
        (b"solid nothing\nendsolid", "is not text that begins with 'solid'"),
        (TEXT.encode()[:500], "is truncated: its solid has no end"),
        (TEXT.replace("vertex 0.5", "vertex x", 1).encode(), "cannot be read as STL"),
        (TEXT.replace("vertex 0.5", "vertex nan", 1).encode(), "are not finite"),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a git-lfs pointer"),
    ],
)
def test_broken_files_are_refused(tmp_path, data, message):
    path = tmp_path / "a.stl"
    path.write_bytes(data)
    with pytest.raises(InputError) as error:
        read_asset(path)
    assert str(path) in error.value.message
    assert message in error.value.message
    assert error.value.hint
