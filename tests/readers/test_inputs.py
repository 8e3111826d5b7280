"""Every file that an asset reads, by content."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest
from captures import ball, write_ply
from mesh_makers import cube_obj, png

from gf_usd.core.errors import InputError
from gf_usd.readers.inputs import read_inputs

LAYERS = {
    "shot.usda": """#usda 1.0
(
    subLayers = [@./light.usda@, @./gone.usda@]
)
def Xform "A" (
    prepend variantSets = "look"
    variants = { string look = "one" }
    clips = { dictionary default = {
        asset manifestAssetPath = @./clips/manifest.usda@
        string primPath = "/A"
        string templateAssetPath = "./clips/c.#.usda"
        double templateStartTime = 1
        double templateEndTime = 2
        double templateStride = 1
    } }
)
{
    variantSet "look" = {
        "one" { }
        "two" ( prepend payload = @./deep/two.usda@ ) { }
    }
}
""",
    "light.usda": "#usda 1.0\n",
    "deep/two.usda": """#usda 1.0
(
    defaultPrim = "T"
)
def Shader "T"
{
    asset inputs:file = @../textures/t.<UDIM>.png@
    asset inputs:other = @none.png@
}
""",
    "clips/manifest.usda": "#usda 1.0\n",
    "clips/c.1.usda": "#usda 1.0\n",
    "clips/c.2.usda": "#usda 1.0\n",
    "textures/t.1001.png": "one",
    "textures/t.1002.png": "two",
    "textures/unused.png": "three",
}


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    for name, text in LAYERS.items():
        path = tmp_path / "shot" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path / "shot" / "shot.usda"


def test_usd_counts_variants_payloads_clips_and_tiles(shot: Path) -> None:
    found = read_inputs(shot)
    assert [name for name, _ in found.files] == sorted(set(LAYERS) - {"textures/unused.png"})
    assert dict(found.files)["textures/t.1001.png"] == hashlib.sha256(b"one").hexdigest()
    assert found.missing == ("gone.usda", "none.png")


def test_a_layer_may_lie_elsewhere(shot: Path) -> None:
    above = shot.parent / "deep" / "above.usda"
    above.write_text("#usda 1.0\n(\n    subLayers = [@../light.usda@]\n)\n", encoding="utf-8")
    assert [name for name, _ in read_inputs(above).files] == ["../light.usda", "above.usda"]


def test_an_obj_counts_its_materials_and_textures(tmp_path: Path) -> None:
    obj = tmp_path / "cube.obj"
    obj.write_text("mtllib cube.mtl\nusemtl red\n" + cube_obj(), encoding="utf-8")
    (tmp_path / "cube.mtl").write_text("newmtl red\nmap_Kd red.png\n", encoding="utf-8")
    (tmp_path / "red.png").write_bytes(png())
    assert [name for name, _ in read_inputs(obj).files] == ["cube.mtl", "cube.obj", "red.png"]


def test_a_package_is_one_file(write: Callable[..., Path], tmp_path: Path) -> None:
    from pxr import UsdUtils

    package = tmp_path / "a.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(write('def Xform "A" {}')), str(package))
    assert [name for name, _ in read_inputs(package).files] == ["a.usdz"]


def test_what_cannot_be_read_is_refused(shot: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_inputs(shot.with_name("none.usda"))
    (shot.parent / "light.usda").write_text("#usda 1.0\ndef {", encoding="utf-8")
    with pytest.raises(InputError, match="damaged"):
        read_inputs(shot)


def test_a_splat_file_is_one_file(tmp_path):
    path = write_ply(tmp_path / "ball.ply", ball(60))
    assert [name for name, _ in read_inputs(path).files] == ["ball.ply"]
