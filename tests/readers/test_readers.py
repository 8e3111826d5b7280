"""What cannot be read is refused with a message; readers are imported by suffix when needed."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from gf_usd.cli.bake import bake
from gf_usd.core.errors import InputError
from gf_usd.readers import read_asset
from gf_usd.readers.formats import FORMATS, MESH, PROGRAM, SPLATS, SUFFIXES, USD, format_of


def test_missing_file_names_its_neighbors(tmp_path):
    (tmp_path / "duck.usda").write_text("#usda 1.0\n")
    with pytest.raises(InputError) as error:
        read_asset(tmp_path / "dukc.usda")
    assert error.value.message == f"{tmp_path / 'dukc.usda'} does not exist"
    assert "did you mean duck.usda?" in error.value.hint
    assert ".usdz" in error.value.hint


def test_a_common_suffix_makes_no_names_similar(tmp_path):
    for name in ("cloth.usda", "worm.usda", "shell.usda"):
        (tmp_path / name).write_text("#usda 1.0\n")
    with pytest.raises(InputError) as error:
        read_asset(tmp_path / "nothere.usda")
    assert "did you mean" not in error.value.hint


def test_the_same_name_with_another_suffix_is_near(tmp_path):
    (tmp_path / "a.glb").write_bytes(b"glTF")
    (tmp_path / "b.usda").write_text("#usda 1.0\n")
    with pytest.raises(InputError) as error:
        read_asset(tmp_path / "a.usda")
    assert "did you mean a.glb? otherwise" in error.value.hint


def test_missing_folder(tmp_path):
    with pytest.raises(InputError, match="does not exist") as error:
        read_asset(tmp_path / "no" / "duck.usda")
    assert f"the folder {tmp_path / 'no'} does not exist either" in error.value.hint


def test_folder_empty_file_and_unknown_suffix(tmp_path):
    empty, word, bare = tmp_path / "a.usda", tmp_path / "a.docx", tmp_path / "README"
    empty.touch()
    word.write_text("x")
    bare.write_text("x")
    (tmp_path / "none").mkdir()
    for path, message in (
        (tmp_path / "none", f"{tmp_path / 'none'} is a folder, not an asset file"),
        (word, f"{word} has the suffix '.docx', which is not supported"),
        (bare, f"{bare} has no suffix, which is not supported"),
    ):
        with pytest.raises(InputError) as error:
            read_asset(path)
        assert error.value.message == message
        assert all(suffix in error.value.hint for suffix in SUFFIXES)
    with pytest.raises(InputError, match=re.escape(f"{empty} is empty (0 bytes)")) as error:
        read_asset(empty)
    assert "copy it again" in error.value.hint


@pytest.mark.parametrize(
    ("names", "hint"),
    [
        (("lamp.usd", "lamp_geo.usdc", "notes.txt"), "give the asset file in it: {lamp.usd}"),
        (("shade.usdc",), "give the asset file in it: {shade.usdc}"),
        (("b.obj", "a.usda"), "give one of the asset files in it: a.usda, b.obj"),
        (tuple("edcba"), ""),
        (tuple(f"{k}.usda" for k in range(5)),
         "give one of the asset files in it: 0.usda, 1.usda, 2.usda or one of 2 others"),
        (tuple(f"{k}.usda" for k in range(4)),
         "give one of the asset files in it: 0.usda, 1.usda, 2.usda, 3.usda"),
        (("b.usda", "b.rubber.partial.usda", "b.rubber.cache.partial.usdc", ".b.usda",
          "b.rubber.cache.usdc", "m.source.usdc"), "give the asset file in it: {b.usda}"),
        ((".b.obj", "b.partial.usda"), ""),
    ],
)  # fmt: skip
def test_a_folder_says_which_file_is_meant(tmp_path, names, hint):
    folder = tmp_path / "lamp"
    folder.mkdir()
    for name in names:
        (folder / name).write_text("x")
    with pytest.raises(InputError) as error:
        read_asset(folder)
    name = hint.partition("{")[2].rstrip("}")
    wanted = hint.replace(f"{{{name}}}", str(folder / name)) if name else hint
    assert error.value.hint == (
        wanted or f"give a file with one of these suffixes: {', '.join(SUFFIXES)}"
    )


def test_a_folder_named_like_an_asset_is_not_offered(tmp_path):
    (tmp_path / "lamp" / "sub.usda").mkdir(parents=True)
    with pytest.raises(InputError) as error:
        read_asset(tmp_path / "lamp")
    assert "sub.usda" not in error.value.hint


def test_a_missing_file_is_not_said_to_mean_a_partial_one(tmp_path):
    (tmp_path / "duck.partial.usda").write_text("x")
    with pytest.raises(InputError) as error:
        read_asset(tmp_path / "duck.partia.usda")
    assert "did you mean" not in error.value.hint


def test_suffix_in_capitals(write):
    path = write('def Cube "C" {}', name="ASSET.USDA")
    assert [s.path for s in read_asset(path).surfaces] == ["/C"]


def test_registry_does_not_import_usd():
    code = "import gf_usd.readers, sys; sys.exit('pxr' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("row", FORMATS, ids=lambda row: row.name)
def test_every_format_has_a_reader_and_is_documented(row):
    assert callable(row.function)
    page = (Path(__file__).parents[2] / "docs" / "guide" / "input-files.md").read_text("utf-8")
    for suffix in row.suffixes:
        assert f"`{suffix}`" in page
        if row.kind in (MESH, PROGRAM):
            assert suffix[1:] in re.findall(r"\w+", bake.__doc__ or "")


def test_a_suffix_may_be_of_meshes_and_of_splats():
    assert format_of(Path("a.PLY"), MESH).name == "PLY"
    assert format_of(Path("a.ply"), SPLATS).name == "3DGS PLY"
    assert format_of(Path("a.ply"), USD) is None
    assert format_of(Path("a.doc")) is None
