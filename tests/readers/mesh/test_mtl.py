"""Material files: what is read, what is missing, what is refused."""

from __future__ import annotations

import pytest
from mesh_makers import cube_obj, png

from gf_usd.core.errors import InputError
from gf_usd.readers import convert
from gf_usd.readers.mesh.mtl import read_libraries
from gf_usd.readers.notes import Notes


def read(folder, text, wanted=("a",), names=("looks.mtl",)):
    (folder / "looks.mtl").write_text(text)
    notes = Notes()
    found, _ = read_libraries(folder / "thing.obj", names, wanted, notes)
    return found, notes.lines()


def test_numbers_become_inputs_of_the_preview_surface(tmp_path):
    found, notes = read(tmp_path, "newmtl a\nKd 0.5\nKe 0 0.25 0\nPr 0.7\nPm 1\nKs 1 1 1\n")
    assert found["a"].values == {
        "diffuseColor": (0.5, 0.5, 0.5),
        "emissiveColor": (0.0, 0.25, 0.0),
        "roughness": 0.7,
        "metallic": 1.0,
    }
    assert notes == ()


def test_texture_options_and_names_with_spaces(tmp_path):
    (tmp_path / "my skin.png").write_bytes(png())
    text = "newmtl a\nmap_Kd -o 0.5 0.25 -s 2 3 1 -bm 2 -mm 0 1 C:\\art\\my skin.png\n"
    found, notes = read(tmp_path, text)
    (slot,) = found["a"].texture_slots
    assert slot.picture.path == tmp_path / "my skin.png"
    assert slot.uv_offset == (0.5, 0.25)
    assert slot.uv_scale == (2.0, 3.0)
    assert notes == ("its texture C:\\art\\my skin.png was found next to the material file",)


def test_a_library_whose_name_has_spaces_or_that_are_several(tmp_path):
    (tmp_path / "my looks.mtl").write_text("newmtl b\nKd 1 0 0\n")
    found, _ = read(tmp_path, "newmtl a\n", ("a", "b"), ("my looks.mtl", "looks.mtl other.mtl"))
    assert list(found) == ["a", "b"]


def test_what_is_missing_is_said(tmp_path):
    obj = tmp_path / "thing.obj"
    obj.write_text("mtllib gone.mtl\nusemtl a\n" + cube_obj())
    source = convert(obj)
    assert "its material file gone.mtl is missing, so its colors are not read" in source.notes
    assert source.asset().surfaces[0].materials == ()
    obj.write_text("usemtl a\n" + cube_obj())
    assert (
        "it names materials (a) but no material file, so no colors are read" in convert(obj).notes
    )
    found, notes = read(tmp_path, "newmtl b\nmap_Kd gone.png\nd 0.5\n", ("a", "b"))
    assert list(found) == ["b"]
    assert found["b"].texture_slots == ()
    assert notes == (
        "material b: its texture gone.png does not exist: a constant color is used",
        "material b: transparency is not supported: the material is opaque",
        "material a is in none of its material files and has no color",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("newmtl a\nKd red\n", "line 2: 'red' contains a value that is not a finite number"),
        (
            "newmtl a\n\nKd 0 nan 0\n",
            "line 3: '0 nan 0' contains a value that is not a finite number",
        ),
        ("newmtl a\nKd\n", "line 2: Kd has no number"),
        ("newmtl a\nmap_Kd -what 1 a.png\n", "line 2: map_Kd has the unknown option -what"),
        ("newmtl a\nmap_Kd -s 1 1 1\n", "line 2: map_Kd gives no file name"),
        ("version https://git-lfs.github.com/spec/v1\n", "is a git-lfs pointer"),
    ],
)
def test_broken_lines_are_refused(tmp_path, text, message):
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert str(tmp_path / "looks.mtl") in error.value.message
    assert message in error.value.message
