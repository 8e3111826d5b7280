"""One file instead of layers: the same values, the same displays, and nothing else needed."""

from __future__ import annotations

import hashlib
import re
import shutil
import struct
import zipfile
from pathlib import Path

import pytest
from pxr import Ar, Sdf, Usd, UsdUtils
from small_sources import PLAIN, SOURCES, Source
from small_stages import CUBE, asset_of, bake, write
from visible_prims import visible

from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.choices import Choices
from gf_usd.layers.check.run import check_file
from gf_usd.layers.flatten import write_flat
from gf_usd.system.atomic_files import partial_path, publish

ALL = Choices()
SUFFIXES = (".usdc", ".usda", ".usdz")


@pytest.fixture(params=SOURCES)
def source(request: pytest.FixtureRequest) -> Source:
    return SOURCES[request.param]


def flat(asset: Asset, folder: Path, suffix: str, **options: object) -> tuple[Path, Path]:
    """The layered bake and the one file, published; also its notes in the name of neither."""
    root, _, _ = bake(asset, folder, **options)
    out = folder / "out"
    out.mkdir(exist_ok=True)
    target = out / f"duck.rubber{suffix}"
    choices = options.get("choices", ALL)
    write_flat(target, root, asset, source=asset.facts.path, choices=choices)
    assert not target.exists()
    return root.path, publish(target)


def values(stage: Usd.Stage) -> dict[str, object]:
    """What every attribute says, at every time that it has a sample."""
    found = {}
    for prim in stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        found[str(prim.GetPath())] = prim.GetTypeName(), prim.GetAppliedSchemas()
        for attr in prim.GetAuthoredAttributes():
            if attr.GetTypeName() != Sdf.ValueTypeNames.Asset:
                codes = attr.GetTimeSamples()
                found[str(attr.GetPath())] = attr.Get(), [(t, attr.Get(t)) for t in codes]
        for rel in prim.GetAuthoredRelationships():
            found[str(rel.GetPath())] = rel.GetTargets()
    return found


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_file_says_what_the_layers_say(source: Source, suffix: str, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    known = {(f.rule, f.prim_path) for f in check_file(asset.facts.path).findings}
    layers, one = flat(asset, tmp_path, suffix)
    layered = Usd.Stage.Open(str(layers))
    known |= {(f.rule, f.prim_path) for f in check_file(layers).findings}
    expected = values(layered)
    # every other file goes: the stage must open alone
    alone = tmp_path / "alone" / one.name
    alone.parent.mkdir()
    shutil.move(one, alone)
    keep = {"out", "alone"}
    for path in tmp_path.iterdir():
        if path.name not in keep:
            path.unlink()
    stage = Usd.Stage.Open(str(alone))
    found = values(stage)
    # what the displays hide stands in variants, so prims may lack an authored visibility
    wanted = {k: v for k, v in expected.items() if not k.endswith(".visibility")}
    assert {k: found.get(k) for k in wanted} == wanted
    assert stage.GetDefaultPrim().GetPath() == layered.GetDefaultPrim().GetPath()
    for name in ("startTimeCode", "endTimeCode", "timeCodesPerSecond", "framesPerSecond", "upAxis"):
        assert stage.GetMetadata(name) == layered.GetMetadata(name), name
    assert {
        (f.rule, f.prim_path) for f in check_file(alone).findings if f.severity == "error"
    } <= known


def test_the_displays_still_switch(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    layers, one = flat(asset, tmp_path, ".usdc")
    stages = [Usd.Stage.Open(str(path)) for path in (layers, one)]
    assert visible(stages[0]) == visible(stages[1])
    seen = set()
    for shape in ALL.shapes:
        for stage in stages:
            stage.SetEditTarget(stage.GetSessionLayer())
            for prim in stage.GetPseudoRoot().GetAllChildren():
                for name in ("display", "gaussianFleshDisplay"):
                    there = prim.GetVariantSet(name).GetVariantNames()
                    if set(there) == set(ALL.shapes):
                        prim.GetVariantSet(name).SetVariantSelection(shape)
        assert visible(stages[0]) == visible(stages[1]), shape
        seen.add(frozenset(visible(stages[1])))
    assert len(seen) == 3


def test_prims_of_a_display_are_in_the_order_of_the_scene(tmp_path: Path) -> None:
    """The order of a set of paths changes from run to run, and the bytes of the file with it."""
    asset = SOURCES["plain"].asset(tmp_path)
    _, one = flat(asset, tmp_path, ".usda")
    layer = Sdf.Layer.FindOrOpen(str(one))
    display = layer.GetPrimAtPath("/duck").variantSets["display"].variants
    order = {mode: list(display[mode].primSpec.nameChildren.keys()) for mode in ALL.shapes}
    assert order["points"] == order["gaussians"] == ["geo", "GaussianFlesh"]


def test_an_authored_visibility_survives_the_displays(tmp_path: Path) -> None:
    body = PLAIN.body.replace(
        "rel material:binding = </_materials/red>",
        "rel material:binding = </_materials/red>\n token visibility.timeSamples = "
        '{ 10: "inherited", 12: "invisible" }',
        1,
    )
    asset = Source(body, PLAIN.head).asset(tmp_path)
    _, one = flat(asset, tmp_path, ".usdc")
    stage = Usd.Stage.Open(str(one))
    visibility = stage.GetAttributeAtPath("/duck/geo/body.visibility")
    assert [visibility.Get(t) for t in (10, 11, 12)] == ["inherited", "inherited", "invisible"]
    stage.GetDefaultPrim().GetVariantSet("display").SetVariantSelection("points")
    assert visibility.Get(10) == "invisible"


PAINTED = f"""
def Xform "duck"
{{
    def Mesh "body" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{ {CUBE}
        rel material:binding = </duck/Paint>
    }}
    def Material "Paint"
    {{
        token outputs:surface.connect = </duck/Paint/Surface.outputs:surface>
        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </duck/Paint/Picture.outputs:rgb>
            token outputs:surface
        }}
        def Shader "Picture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @FILE@
            float3 outputs:rgb
        }}
    }}
}}
"""
FILE = "/duck/Paint/Picture.inputs:file"
PNG = b"\x89PNG\r\n\x1a\n not looked into"


def painted(folder: Path, file: str) -> Asset:
    """An asset in a folder of its own, whose texture is ``file`` next to it."""
    where = folder / "asset"
    where.mkdir()
    for name in ("tex/skin.png", "tex/tile.1001.png", "tex/tile.1002.png"):
        picture = where / name
        picture.parent.mkdir(exist_ok=True)
        picture.write_bytes(PNG + name.encode())
    return asset_of(write(where / "duck.usda", PAINTED.replace("FILE", file)))


def hashes(folder: Path) -> dict[str, str]:
    files = [p for p in folder.rglob("*") if p.is_file()]
    return {str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.mark.parametrize("file", ["./tex/skin.png", "tex/skin.png"])
def test_textures_are_found_from_where_the_file_lies(file: str, tmp_path: Path) -> None:
    asset = painted(tmp_path, file)
    before = hashes(tmp_path / "asset")
    _, one = flat(asset, tmp_path / "asset", ".usdc")
    stage = Usd.Stage.Open(str(one))
    found = stage.GetAttributeAtPath(FILE).Get()
    assert found.path == "../tex/skin.png"
    assert Path(found.resolvedPath).read_bytes() == PNG + b"tex/skin.png"
    after = hashes(tmp_path / "asset")
    assert {path: after[path] for path in before} == before


def test_a_package_holds_its_textures(tmp_path: Path) -> None:
    asset = painted(tmp_path, "tex/skin.png")
    _, one = flat(asset, tmp_path / "asset", ".usdz")
    one = Path(shutil.move(one, tmp_path / "moved.usdz"))
    shutil.rmtree(tmp_path / "asset")
    stage = Usd.Stage.Open(str(one))
    found = stage.GetAttributeAtPath(FILE).Get()
    assert found.resolvedPath == f"{one}[{found.path}]"
    with zipfile.ZipFile(one) as archive:
        assert archive.read(found.path) == PNG + b"tex/skin.png"


def test_a_package_keeps_the_rules_of_ar(tmp_path: Path) -> None:
    asset = painted(tmp_path, "tex/skin.png")
    _, one = flat(asset, tmp_path / "asset", ".usdz")
    data = one.read_bytes()
    with zipfile.ZipFile(one) as archive:
        files = archive.infolist()
    assert files[0].filename == "duck.rubber.usdc"
    assert {Path(f.filename).suffix for f in files} == {".usdc", ".png"}
    for file in files:
        assert file.compress_type == zipfile.ZIP_STORED
        # the local header is 30 bytes, then the name and the padding
        name, extra = struct.unpack_from("<HH", data, file.header_offset + 26)
        assert (file.header_offset + 30 + name + extra) % 64 == 0


def test_a_package_does_not_hold_the_asset_that_its_info_names(tmp_path: Path) -> None:
    """Nothing is composed from it, and AR clients allow no further layers in a package."""
    (tmp_path / "asset").mkdir()
    info = """(
    assetInfo = {
        asset identifier = @./duck.usda@
        asset[] payloadAssetDependencies = [@./duck.usda@, @rig.usd@]
        string name = "Duck"
    }
)
{"""
    text = PAINTED.replace('def Xform "duck"\n{', f'def Xform "duck" {info}').replace(
        "asset inputs:file = @FILE@", ""
    )
    asset = asset_of(write(tmp_path / "asset" / "duck.usda", text))
    root, _, _ = bake(asset, tmp_path)
    target = tmp_path / "one.usdz"
    assert write_flat(target, root, asset, source=asset.facts.path, choices=ALL) == ()
    with zipfile.ZipFile(publish(target)) as archive:
        assert archive.namelist() == ["one.usdc"]
    stage = Usd.Stage.Open(str(target))
    found = stage.GetDefaultPrim().GetAssetInfo()
    assert found["identifier"].path == "duck.usda"
    assert [path.path for path in found["payloadAssetDependencies"]] == ["duck.usda", "rig.usd"]
    assert found["name"] == "Duck"


def test_the_tiles_of_a_udim_come_along(tmp_path: Path) -> None:
    asset = painted(tmp_path, "tex/tile.<UDIM>.png")
    _, one = flat(asset, tmp_path / "asset", ".usdz")
    with zipfile.ZipFile(one) as archive:
        names = {Path(f.filename).name for f in archive.infolist()}
    assert {"tile.1001.png", "tile.1002.png"} <= names
    _, layer = flat(asset, tmp_path / "asset", ".usdc")
    stage = Usd.Stage.Open(str(layer))
    assert stage.GetAttributeAtPath(FILE).Get().path == "../tex/tile.<UDIM>.png"


@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
def test_textures_inside_a_package_are_reached(suffix: str, tmp_path: Path) -> None:
    painted(tmp_path, "tex/skin.png")
    inner = tmp_path / "duck.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "asset/duck.usda"), str(inner))
    shutil.rmtree(tmp_path / "asset")
    asset = asset_of(inner)
    _, one = flat(asset, tmp_path, suffix)
    stage = Usd.Stage.Open(str(one))
    found = stage.GetAttributeAtPath(FILE).Get()
    if suffix == ".usdc":
        assert found.path.startswith("../duck.usdz[")
        assert found.resolvedPath
        return
    with zipfile.ZipFile(one) as archive:
        assert {Path(f.filename).suffix for f in archive.infolist()} == {".usdc", ".png"}
        assert archive.read(found.path) == PNG + b"tex/skin.png"


def zipped(folder: Path, name: str, files: list[str]) -> Path:
    """`asset/duck.usda` and textures in a package, in which paths are UTF-8, as USD writes them."""
    inner = folder / name
    writer = Sdf.ZipFileWriter.CreateNew(str(inner))
    for file in ("duck.usda", *files):
        assert writer.AddFile(str(folder / "asset" / file), file)
    assert writer.Save()
    shutil.rmtree(folder / "asset")
    return inner


def file_in(path: Path) -> str:
    stage = Usd.Stage.Open(str(path))
    return stage.GetAttributeAtPath(FILE).Get().path


@pytest.mark.parametrize("file", ["tex/tile.<UDIM>.png", "./tex/tile.<UDIM>.png"])
@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
def test_tiles_inside_a_package_are_reached(suffix: str, file: str, tmp_path: Path) -> None:
    painted(tmp_path, file)
    inner = zipped(tmp_path, "duck.usdz", ["tex/tile.1001.png", "tex/tile.1002.png"])
    _, one = flat(asset_of(inner), tmp_path, suffix)
    found = file_in(one)
    if suffix == ".usdc":
        assert found == "../duck.usdz[tex/tile.<UDIM>.png]"
        return
    with zipfile.ZipFile(one) as archive:
        for tile in ("1001", "1002"):
            data = archive.read(found.replace("<UDIM>", tile))
            assert data == PNG + f"tex/tile.{tile}.png".encode()


def test_a_texture_in_a_package_has_any_name(tmp_path: Path) -> None:
    """USD writes names as UTF-8 without the flag that says so."""
    painted(tmp_path, "./häute/skin é.png")
    (tmp_path / "asset/häute").mkdir()
    (tmp_path / "asset/tex/skin.png").rename(tmp_path / "asset/häute/skin é.png")
    inner = zipped(tmp_path, "ente ü.usdz", ["häute/skin é.png"])
    _, one = flat(asset_of(inner), tmp_path, ".usdz")
    picture = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(f"{one}[{file_in(one)}]"))
    assert picture.GetBuffer() == PNG + b"tex/skin.png"


def test_a_texture_is_packed_once(tmp_path: Path) -> None:
    painted(tmp_path, "tex/skin.png")
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "asset/duck.usda"))
    assert Sdf.CopySpec(layer, "/duck/Paint/Picture", layer, "/duck/Paint/Again")
    layer.Save()
    _, one = flat(asset_of(zipped(tmp_path, "duck.usdz", ["tex/skin.png"])), tmp_path, ".usdz")
    with zipfile.ZipFile(one) as archive:
        assert [name for name in archive.namelist() if name.endswith(".png")] == [
            "files/0/skin.png"
        ]


def test_a_texture_that_a_package_lacks_is_named(tmp_path: Path) -> None:
    painted(tmp_path, "./tex/lost.png")
    asset = asset_of(zipped(tmp_path, "duck.usdz", []))
    root, _, _ = bake(asset, tmp_path)
    target = tmp_path / "one.usdz"
    notes = write_flat(target, root, asset, source=asset.facts.path, choices=ALL)
    lost = f"{asset.facts.path}[tex/lost.png]"
    assert notes == (f"{lost} could not be found: it is not in the package",)


def test_a_texture_that_is_not_there_is_named(tmp_path: Path) -> None:
    asset = painted(tmp_path, "./tex/lost.png")
    root, _, _ = bake(asset, tmp_path / "asset")
    target = tmp_path / "asset" / "one.usdz"
    notes = write_flat(target, root, asset, source=asset.facts.path, choices=ALL)
    lost = tmp_path / "asset/tex/lost.png"
    assert notes == (f"{lost} could not be found: it is not in the package",)
    assert partial_path(target).exists()


def test_an_empty_texture_is_named(tmp_path: Path) -> None:
    """Of an asset that changes after it was read: the hint was on disk space."""
    asset = painted(tmp_path, "./tex/skin.png")
    root, _, _ = bake(asset, tmp_path / "asset")
    empty = tmp_path / "asset/tex/skin.png"
    empty.write_bytes(b"")
    with pytest.raises(BakeError, match=re.escape(f"{empty} is empty (0 bytes)")):
        write_flat(tmp_path / "one.usdz", root, asset, source=asset.facts.path, choices=ALL)


def test_no_path_of_this_machine_is_left(tmp_path: Path) -> None:
    asset = painted(tmp_path, "tex/skin.png")
    for suffix in SUFFIXES[:2]:
        _, one = flat(asset, tmp_path / "asset", suffix)
        assert str(tmp_path) not in Sdf.Layer.FindOrOpen(str(one)).ExportToString()
