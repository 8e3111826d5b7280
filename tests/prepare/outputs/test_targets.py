"""The files that a bake will write and those that it reads, as they are found before it begins."""

from __future__ import annotations

from pathlib import Path

import pytest
from mesh_makers import CORNERS, TRIANGLES, GltfMaker, cube_obj, png

from gf_usd.core.errors import UsageError
from gf_usd.core.materials.presets import find_preset
from gf_usd.prepare.options.sweep import parse_sweep, swept
from gf_usd.prepare.outputs.outputs import stamp
from gf_usd.prepare.outputs.targets import Targets, files_read, targets_of, with_layer
from gf_usd.readers import convert
from gf_usd.readers.mesh.to_usd import MeshSource

PLAIN = {
    "flatten": False, "divided": False, "ply": None, "spz": None, "overwrite": False,
    "resume": False,
}  # fmt: skip
RUBBER = [find_preset("rubber")]


def targets(source: Path, target: str | Path, presets=RUBBER, **changes) -> Targets:
    """The targets of a bake without options but these."""
    return targets_of(source, presets, f"{target}", **{**PLAIN, **changes})


def converted(path: Path, **options) -> MeshSource:
    """The layer of a mesh file."""
    source = convert(path, **options)
    assert source is not None
    return source


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    path = tmp_path / "cube.obj"
    path.write_text(cube_obj(), encoding="utf-8")
    return path


@pytest.fixture
def textured(tmp_path: Path) -> Path:
    maker = GltfMaker()
    uvs = CORNERS[:, :2].astype("f4")
    maker.mesh(maker.primitive(CORNERS, TRIANGLES, TEXCOORD_0=uvs) | {"material": 0})
    maker.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    maker.tree["textures"] = [{"source": 0}]
    image = {"bufferView": maker.view(png()), "mimeType": "image/png", "name": "skin"}
    maker.tree["images"] = [image]
    return maker.glb(tmp_path / "box.glb")


def test_the_variants_of_a_sweep_share_its_name(tmp_path: Path) -> None:
    presets = swept(RUBBER[0], parse_sweep("youngs=1e4:1e5:2"))
    found = targets(Path("duck.usda"), f"{tmp_path}/", presets).files
    assert found.root == tmp_path / "duck.rubber_youngs.usda"
    assert found.sheet == tmp_path / "duck.rubber_youngs.sheet.png"
    assert len(found.caches) == 2


def test_an_interrupted_bake_may_replace_what_it_wrote(tmp_path: Path) -> None:
    source = Path("duck.usda")
    files = targets(source, f"{tmp_path}/").files
    files.checkpoints[0].write_bytes(b"state")
    files.root.write_text("of an earlier run")
    with pytest.raises(UsageError, match="exists already"):
        targets(source, f"{tmp_path}/")
    resumed = targets(source, f"{tmp_path}/", resume=True)
    assert resumed.overwrite
    assert dict(resumed.seen)[files.root] == stamp(files.root) is not None
    assert not targets(source, f"{tmp_path / 'new'}/", resume=True).overwrite


def test_frames_of_splats_that_exist_are_kept(tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    found = targets(Path("duck.usda"), f"{tmp_path}/", ply=str(frames), spz=str(frames))
    ((ply, spz),) = found.sequences
    assert (ply.path(0).name, spz.path(0).name) == ("duck.rubber.0001.ply", "duck.rubber.0001.spz")
    frames.mkdir()
    spz.path(0).write_bytes(b"earlier")
    targets(Path("duck.usda"), f"{tmp_path}/", ply=str(frames))
    with pytest.raises(UsageError, match=r"duck\.rubber\.0001\.spz exists already"):
        targets(Path("duck.usda"), f"{tmp_path}/", ply=str(frames), spz=str(frames))


def test_a_bake_reads_its_asset_colliders_and_material_files_with_their_layers(
    tmp_path: Path, cube: Path
) -> None:
    below, shot, cork = (tmp_path / f"{name}.usda" for name in ("below", "shot", "cork"))
    below.write_text('#usda 1.0\ndef Xform "A" {}\n', encoding="utf-8")
    shot.write_text("#usda 1.0\n(subLayers = [@./below.usda@])\n", encoding="utf-8")
    cork.write_text('#usda 1.0\ndef Material "Cork" {}\n', encoding="utf-8")
    wanted = {below, shot, cork, cube}
    for material in (f"jelly,{cork}", ("jelly", str(cork), RUBBER[0].material(0.1))):
        found = files_read(shot, material, [str(cube)])
        assert {path.absolute() for path in found} == wanted
    assert set(files_read(cube, None, ())) == {cube}


def test_the_layer_of_a_mesh_file_is_found_with_its_pictures(
    tmp_path: Path, textured: Path
) -> None:
    source, out = converted(textured), tmp_path / "out"
    out.mkdir()
    layer = out / "box.source.usdc"
    files, seen = with_layer(targets(textured, f"{out}/"), source, shared=True)
    assert (files.source, files.textures, seen) == (
        layer, (out / "box.textures" / "skin.png",), None,
    )  # fmt: skip
    source.write(layer)
    _, seen = with_layer(targets(textured, f"{out}/"), source, shared=True)
    assert seen == stamp(layer) is not None
    usd = targets(Path("duck.usda"), f"{out}/")
    assert with_layer(usd, None, shared=True) == (usd.files, None)


def test_pictures_next_to_a_flattened_bake_are_kept(tmp_path: Path, textured: Path) -> None:
    source, out = converted(textured), tmp_path / "out"
    picture = out / "box.rubber.textures" / "skin.png"
    picture.parent.mkdir(parents=True)
    picture.write_bytes(b"another")
    flat = targets(textured, f"{out}/", flatten=True)
    with pytest.raises(UsageError, match=r"skin\.png exists already"):
        with_layer(flat, source, shared=True)
    packed = targets(textured, out / "box.usdz")
    assert with_layer(packed, source, shared=True)[0].textures == ()


def test_a_layer_that_is_not_of_this_mesh_file_is_kept(
    tmp_path: Path, cube: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layer = tmp_path / "cube.source.usdc"
    converted(cube).write(layer)
    before = layer.read_bytes()

    def refusal(source: MeshSource, *, shared: bool = True, **changes) -> str:
        with pytest.raises(UsageError) as caught:
            with_layer(targets(source.path, f"{tmp_path}/", **changes), source, shared=shared)
        return caught.value.message

    turned = converted(cube, up_axis="Z")
    there = f"{layer} exists already, and was made"
    assert refusal(turned) == f"{there} from another file or with other options"
    with monkeypatch.context() as patched:
        patched.setattr("gf_usd.readers.mesh.to_usd.CONVERTER", 1000)
        newer = converted(cube)
    assert refusal(newer) == f"{there} by another version of gf-usd"
    for source in (turned, newer):
        with_layer(targets(cube, f"{tmp_path}/", overwrite=True), source, shared=True)
    # the bakes of a mesh file of another name are not what is to be overwritten
    other = cube.rename(tmp_path / "cube.OBJ")
    message = f"{layer} was made from cube.obj, and bakes of it may be layered over it"
    assert refusal(converted(other), overwrite=True) == message
    with_layer(targets(other, f"{tmp_path}/", overwrite=True), converted(other), shared=False)
    assert layer.read_bytes() == before
