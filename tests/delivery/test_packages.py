"""The package of a delivery: layers with changed paths, textures and UDIM tiles."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Ar, Sdf, Usd
from small_stages import publish

from gf_usd.delivery.usd import LayerPackage
from gf_usd.layers.flatten import write_placed

PICTURES = ("tile.1001.png", "tile.1002.png", "skin.png")


def shader(name: str, file: str) -> str:
    return f'def Shader "{name}"\n{{\n    asset inputs:file = @{file}@\n}}'


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    """A folder with a layer, a layer that it is made of, and pictures."""
    folder = tmp_path / "parts"
    (folder / "tex").mkdir(parents=True)
    for name in PICTURES:
        (folder / "tex" / name).write_bytes(name.encode())
    files = {"Tiles": "tile.<UDIM>.png", "Skin": "skin.png", "Tile": "tile.1002.png"}
    shaders = "\n".join(shader(name, f"./tex/{file}") for name, file in files.items())
    (folder / "inner.usda").write_text(f'#usda 1.0\ndef Scope "Body"\n{{\n{shaders}\n}}\n')
    (folder / "outer.usda").write_text(
        '#usda 1.0\n(\n    defaultPrim = "Body"\n    subLayers = [@./inner.usda@]\n)\n'
    )
    return folder


def packed(source: Path, target: Path) -> Usd.Stage:
    """A package of a layer that references `source`, opened."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    prim = Sdf.CreatePrimInLayer(layer, "/Body")
    prim.referenceList.Prepend(Sdf.Reference(str(source)))
    assert write_placed(layer, target, package=LayerPackage) == ()
    return Usd.Stage.Open(str(publish(target)))


def content(package: Path, name: str) -> bytes:
    name = name.removeprefix("./")
    return Ar.GetResolver().OpenAsset(Ar.ResolvedPath(f"{package}[{name}]")).GetBuffer()


@pytest.mark.parametrize("zipped", [False, True], ids=["folder", "package"])
def test_every_picture_of_every_layer_is_reached(zipped: bool, parts: Path, tmp_path: Path) -> None:
    source = parts / "outer.usda"
    if zipped:
        source = tmp_path / "source ü.usdz"
        writer = Sdf.ZipFileWriter.CreateNew(str(source))
        for name in ("outer.usda", "inner.usda", *(f"tex/{name}" for name in PICTURES)):
            assert writer.AddFile(str(parts / name), name)
        assert writer.Save()
    target = tmp_path / "out.usdz"
    stage = packed(source, target)

    def file(name: str) -> str:
        return stage.GetAttributeAtPath(f"/Body/{name}.inputs:file").Get().path

    assert content(target, file("Skin")) == b"skin.png"
    assert content(target, file("Tile")) == b"tile.1002.png"
    for tile in ("1001", "1002"):
        name = file("Tiles").replace("<UDIM>", tile)
        assert content(target, name) == f"tile.{tile}.png".encode()
