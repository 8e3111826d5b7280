"""OBJ files: polygons, seams, groups and materials survive, and what is broken is refused."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_makers import CORNERS, QUADS, cube_obj, png, written
from pxr import Usd, UsdGeom

from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.readers import convert, read_asset

# The layer holds float32: positions of size 1 are right to half its rounding step.
EXACT = 1e-7


@pytest.fixture
def obj(tmp_path):
    def write(text: str, name: str = "thing.obj"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_quads_come_out_as_the_same_quads(obj, tmp_path):
    asset = written(obj(cube_obj()), tmp_path / "out")
    (cube,) = asset.surfaces
    assert cube.path == "/thing/mesh"
    np.testing.assert_allclose(cube.points, CORNERS, atol=EXACT)
    assert cube.face_counts.tolist() == [4] * 6
    assert cube.face_indices.reshape(-1, 4).tolist() == [list(quad) for quad in QUADS]
    assert signed_volume(cube.points, cube.triangles) == pytest.approx(1.0, rel=1e-6)
    assert cube.normals is None
    assert cube.materials == ()


def test_polygons_of_any_size_seams_and_normals(obj, tmp_path):
    text = """
        v 0 0 0
        v 2 0 0
        v 2 1 0
        v 1 2 0
        v 0 1 0
        v 1 -1 0
        vt 0 0
        vt 1 0
        vt 1 0.5
        vt 0.5 1
        vt 0 0.5
        vt 0.25 0.25
        vn 0 0 1
        vn 0 1 1
        f 1/1/1 2/2/1 3/3/1 4/4/1 5/5/1
        f -1/6/2 2/2/2 1/6/2
        """
    (thing,) = written(obj(text), tmp_path / "out").surfaces
    assert thing.face_counts.tolist() == [5, 3]
    assert thing.face_indices.tolist() == [0, 1, 2, 3, 4, 5, 1, 0]
    assert thing.normals_interpolation == "faceVarying"
    up = np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(thing.normals[5:], [up] * 3, atol=EXACT)
    # point 1 has a seam: (0, 0) in the pentagon, (0.25, 0.25) in the triangle
    stage = Usd.Stage.Open(str(tmp_path / "out" / "thing.source.usdc"))
    st = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(thing.path)).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    flat = np.array(st.ComputeFlattened())
    np.testing.assert_allclose(flat[[0, 5, 7]], [[0, 0], [0.25, 0.25], [0.25, 0.25]])


def test_normals_and_coordinates_without_seams_are_one_a_point(obj, tmp_path):
    text = cube_obj().split("f ")[0] + "".join(f"vt {x} {y}\nvn {x} {y} 1\n" for x, y, _ in CORNERS)
    text += "".join("f " + " ".join(f"{i + 1}/{i + 1}/{i + 1}" for i in q) + "\n" for q in QUADS)
    (cube,) = written(obj(text), tmp_path / "out").surfaces
    assert cube.normals_interpolation == "vertex"
    assert len(cube.normals) == 8
    stage = Usd.Stage.Open(str(tmp_path / "out" / "thing.source.usdc"))
    st = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(cube.path)).GetPrimvar("st")
    assert st.GetInterpolation() == "vertex"
    np.testing.assert_allclose(np.array(st.Get()), CORNERS[:, :2])


def test_bodies_apart_are_meshes_and_groups_of_one_body_stay_together(obj, tmp_path):
    body = cube_obj().splitlines()
    text = "\n".join(["o left one", *body[:8], "g top", *body[8:11], "g bottom", *body[11:]])
    path = obj(f"{text}\no right\n{cube_obj(first=9)}")
    asset = written(path, tmp_path / "out")
    assert [s.path for s in asset.surfaces] == ["/thing/left_one", "/thing/right"]
    assert [len(s.face_counts) for s in asset.surfaces] == [6, 6]
    stage = Usd.Stage.Open(str(tmp_path / "out" / "thing.source.usdc"))
    prim = stage.GetPrimAtPath("/thing/left_one")
    assert prim.GetDisplayName() == "left one"
    groups = {s.GetPrim().GetName(): list(s.GetIndicesAttr().Get())
              for s in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim))}  # fmt: skip
    assert groups == {"left_one_top": [0, 1, 2], "left_one_bottom": [3, 4, 5]}
    notes = convert(path).notes
    assert any("share points and are read as one mesh" in note for note in notes)


def test_continued_lines_comments_and_what_is_left_out(obj):
    path = obj("# a comment\n" + cube_obj().replace("f 1 2 4 3", "f 1 2 \\\n 4 3") + "l 1 2\ns 1\n"
               "v 9 9 9\nf 1 2\ncurv 0 1\n")  # fmt: skip
    source = convert(path)
    (cube,) = source.asset().surfaces
    assert cube.face_indices[:4].tolist() == [0, 1, 3, 2]
    assert "left out: 1 line" in source.notes
    assert "left out: 1 face with fewer than three corners" in source.notes
    assert "left out: 1 'curv' statement" in source.notes
    assert "1 of its 9 points belongs to no face and is left out" in source.notes


def test_colors_of_points_are_srgb(obj, tmp_path):
    lines = cube_obj().splitlines()
    lines[:8] = [f"{line} 0.5 0 1" for line in lines[:8]]
    (cube,) = written(obj("\n".join(lines)), tmp_path / "out").surfaces
    expected = [float(srgb_to_linear(np.array(0.5))), 0.0, 1.0]
    np.testing.assert_allclose(cube.triangle_colors.reshape(-1, 3), [expected] * 36, atol=EXACT)


def test_materials_of_faces_with_color_and_texture(obj, tmp_path):
    (tmp_path / "skin.png").write_bytes(png())
    (tmp_path / "looks.mtl").write_text(
        "newmtl plain\nKd 0.2 0.4 0.6\nPr 0.3\n"
        "newmtl skin\nKd 1 1 1\nmap_Kd -s 2 2 1 -clamp on skin.png\n"
    )
    lines = cube_obj().splitlines()
    faces = [line.replace(" ", "/1 ").replace("f/1", "f") + "/1" for line in lines[8:]]
    path = obj(
        "\n".join(["mtllib looks.mtl", *lines[:8], "vt 0.1 0.1", "usemtl plain", *faces[:2],
                   "usemtl skin", *faces[2:]])
    )  # fmt: skip
    (cube,) = written(path, tmp_path / "out").surfaces
    plain, skin = cube.materials
    assert cube.triangle_materials.tolist() == [0] * 4 + [1] * 8
    assert plain.color == pytest.approx((0.2, 0.4, 0.6), abs=EXACT)
    assert skin.texture.pixels.shape == (2, 4, 3)
    assert skin.texture.wrap_s == "clamp"
    np.testing.assert_allclose(cube.triangle_uvs[4:], 0.2, atol=EXACT)
    stage = Usd.Stage.Open(str(tmp_path / "out" / "thing.source.usdc"))
    file = stage.GetPrimAtPath("/thing/Materials/skin/diffuseColor_texture").GetAttribute(
        "inputs:file"
    )
    assert file.Get().path == "../skin.png"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0\n", "line 1: v has 2 numbers but needs 3"),
        ("v 0 0 0\nv 1 x 0\n", "line 2: 'v 1 x 0' contains a value that is not a number"),
        (
            "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n",
            "line 2: v contains a number that is not finite",
        ),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "line 4: the face names v 7, but there are 3"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "line 4: the corner '0' has the index 0"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n", "has the index -4: only 3 precede it"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/2 2 3\n", "line 4: the face names vt 2, but there are 0"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 c\n", "line 4: the corner 'c' is not an index"),
        ("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", "has no size: its 3 points are all in one place"),
        ("v 0 0 0\nv 1 0 0\n", "the file contains no faces (2 points)"),
        ("# nothing\n", "the file contains no faces"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "is a git-lfs pointer"),
        ("v 0 0 0\0\n", "is not an OBJ file: it holds binary data"),
    ],
)
def test_broken_files_are_refused_with_their_line(obj, text, message):
    path = obj(text)
    with pytest.raises(InputError) as error:
        read_asset(path)
    assert str(path) in error.value.message
    assert message in error.value.message
    assert error.value.hint


def test_names_in_other_scripts_give_different_prims(obj, tmp_path):
    """Each byte became "_": /blob_______ of 'blob ü 形', and of 'blob ü 体' too."""
    path = obj(f"o 形\n{cube_obj()}o 体\n{cube_obj(9)}", name="blob ü 形.obj")
    asset = written(path, tmp_path / "out")
    names = ["u5F62", "u4F53"]
    assert [s.path for s in asset.surfaces] == [f"/blob_u_u5F62/{name}" for name in names]
    stage = Usd.Stage.Open(str(tmp_path / "out" / "blob ü 形.source.usdc"))
    shown = [stage.GetPrimAtPath(s.path).GetDisplayName() for s in asset.surfaces]
    assert shown == ["形", "体"]
    (note,) = [note for note in convert(path).notes if "ASCII" in note]
    assert "'blob ü 形' is blob_u_u5F62, '形' is u5F62, '体' is u4F53; displayName" in note
    assert not [n for n in convert(obj(cube_obj(), name="a b.obj")).notes if "ASCII" in n]
