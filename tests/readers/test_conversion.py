"""The USD layer of a mesh file: its units, its name, and how it comes to lie next to a result."""

from __future__ import annotations

import hashlib
import os
import sys

import arm
import gltf_arm
import numpy as np
import pytest
from mesh_makers import CORNERS, TRIANGLES, GltfMaker, cube_obj, png
from pxr import Kind, Sdf, Usd, UsdGeom, UsdValidation

from gf_usd.core.errors import BakeError, InputError
from gf_usd.readers import convert, read_asset
from gf_usd.readers.mesh.to_usd import CONVERTER as CONVERTER_NUMBER
from gf_usd.readers.mesh.to_usd import RECORD

ASSUMED = (
    "OBJ files state no unit and no up axis: 1 m per unit is assumed (--meters-per-unit), and Y up"
    " (--up-axis)",
)


@pytest.fixture
def cube(tmp_path):
    path = tmp_path / "my cube.obj"
    path.write_text(cube_obj())
    return path


def test_what_is_assumed_is_said_and_can_be_asked_otherwise(cube):
    asset = read_asset(cube)
    assert asset.facts.path == cube
    assert asset.facts.units.length == 1.0
    assert asset.facts.up_axis == "Y"
    assert asset.facts.notes == ASSUMED
    assert (asset.facts.unit_from, asset.facts.axis_from) == ("assumed", "assumed")
    one = read_asset(cube, meters_per_unit=0.01).facts
    assert (one.unit_from, one.axis_from) == ("option", "assumed")
    asset = read_asset(cube, meters_per_unit=0.01, up_axis="z")
    np.testing.assert_allclose(asset.surfaces[0].points, 0.01 * CORNERS, atol=1e-9)
    assert asset.facts.up_axis == "Z"
    assert asset.facts.notes == (
        "metersPerUnit = 0.01, as requested",
        "upAxis = Z, as requested",
    )
    assert (asset.facts.unit_from, asset.facts.axis_from) == ("option", "option")
    for options in ({"meters_per_unit": 0.0}, {"meters_per_unit": np.nan}, {"up_axis": "X"}):
        with pytest.raises(InputError, match=r"is not a valid unit size|USD allows only Y and Z"):
            read_asset(cube, **options)


@pytest.mark.parametrize(
    ("edge", "suffix", "unit"),
    [
        *((1.0, "obj", 1.0), (19.0, "obj", 1.0), (0.021, "obj", 1.0)),
        *((150.0, "obj", 0.01), (5000.0, "obj", 0.001), (0.001, "obj", 1.0), (1e6, "obj", 1.0)),
        *((0.5, "stl", 1.0), (80.0, "stl", 0.001), (150.0, "off", 0.01)),
    ],
)
def test_a_file_without_a_unit_is_taken_to_be_of_a_plausible_size(tmp_path, edge, suffix, unit):
    import trimesh

    path = tmp_path / f"box.{suffix}"
    trimesh.creation.box(extents=(edge, 0.7 * edge, 0.5 * edge)).export(path)
    facts = read_asset(path).facts
    assert (facts.units.meters_per_unit, facts.unit_from) == (unit, "assumed")
    (note,) = [note for note in facts.notes if "state no unit" in note]
    chosen = f", which makes the body {edge * unit:g} m wide instead of {edge:g} m"
    assert f"{unit:g} m per unit is assumed{chosen * (unit != 1.0)} (--meters-per-unit)" in note


def test_the_layer_is_a_whole_asset(cube, tmp_path):
    path = convert(cube, meters_per_unit=0.01).write(tmp_path / "my cube.source.usdc")
    stage = Usd.Stage.Open(str(path))
    root = stage.GetDefaultPrim()
    assert root.GetPath() == "/my_cube"
    assert root.GetDisplayName() == "my cube"
    assert Usd.ModelAPI(root).GetKind() == Kind.Tokens.component
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/my_cube/mesh"))
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert np.array(mesh.GetExtentAttr().Get()).tolist() == [[0, 0, 0], [1, 1, 1]]


def test_the_layer_passes_the_validators_of_usd(tmp_path):
    maker = GltfMaker()
    uvs = CORNERS[:, :2].astype(np.float32)
    lower = maker.primitive(CORNERS, TRIANGLES[:6], TEXCOORD_0=uvs) | {"material": 0}
    upper = maker.primitive(CORNERS, TRIANGLES[6:], TEXCOORD_0=uvs) | {"material": 1}
    maker.mesh(lower, upper, name="box", translation=[0, 1, 0])
    texture = {"index": 0}
    maker.tree["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": texture, "metallicRoughnessTexture": texture},
         "normalTexture": texture, "emissiveTexture": texture, "emissiveFactor": [1, 1, 1]},
        {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}},
    ]  # fmt: skip
    maker.tree["textures"] = [{"source": 0}]
    maker.tree["images"] = [{"bufferView": maker.view(png()), "mimeType": "image/png"}]
    source = convert(maker.glb(tmp_path / "thing.glb"))
    stage = Usd.Stage.Open(str(source.write(tmp_path / "out.source.usdc")))
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    errors = [str(error.GetErrorAsString()) for error in context.Validate(stage)]
    assert errors == []


def test_writing_again_keeps_what_is_the_same(cube, tmp_path):
    target = tmp_path / "my cube.source.usdc"
    source = convert(cube)
    assert not source.is_at(target)
    source.write(target)
    before = target.stat().st_mtime_ns, target.read_bytes()
    os.utime(target, ns=(1, 1))
    convert(cube).write(target)
    assert target.stat().st_mtime_ns == 1
    assert target.read_bytes() == before[1]
    other = convert(cube, up_axis="Z")
    assert not other.is_at(target)
    target.write_bytes(b"PXR-USDC but no more")
    assert not source.is_at(target)
    cube.write_text(cube_obj().replace("1.0", "2.0"))
    convert(cube).write(target)
    assert read_asset(target).surfaces[0].points.max() == 2.0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["my cube.obj", "my cube.source.usdc"]


def test_a_layer_of_another_converter_is_made_again(cube, tmp_path, monkeypatch):
    """An older one lacks what the converter has learned since, and counted as current."""
    target = tmp_path / "my cube.source.usdc"
    source = convert(cube)
    assert not source.is_of_other_version(target)
    source.write(target)
    assert not source.is_of_other_version(target)
    for record in ({"converter": "0"}, {}):  # the first converters recorded no number
        layer = Sdf.Layer.FindOrOpen(str(target))
        kept = {k: v for k, v in source.record.items() if k != "converter"}
        layer.customLayerData = {RECORD: kept | record}
        layer.Save()
        assert source.is_of_other_version(target)
        assert not source.is_at(target)
        assert source.other_file(target) == ""
        source.write(target)
        assert source.is_at(target)
    monkeypatch.setattr("gf_usd.readers.mesh.to_usd.CONVERTER", CONVERTER_NUMBER + 1)
    assert convert(cube).is_of_other_version(target)
    assert not convert(cube, up_axis="Z").is_at(target)


def structure(layer) -> str:
    """The prims, properties and types of a layer, without values."""
    lines = []

    def visit(path):
        lines.append(f"{path} {getattr(layer.GetObjectAtPath(path), 'typeName', '')}")

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return "\n".join(sorted(lines))


def test_a_converter_that_writes_other_prims_has_another_number(tmp_path):
    """A layer of the converter before counts as current otherwise: where this fails because the
    layer has changed, raise `CONVERTER`, and set the digest for the new number.
    """
    maker = gltf_arm.maker()
    (primitive,) = maker.tree["meshes"][0]["primitives"]
    count = len(arm.points())
    primitive["targets"] = [{"POSITION": maker.accessor(np.ones((count, 3), np.float32))}]
    primitive["material"] = 0
    maker.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}]
    (animation,) = maker.tree["animations"]
    weights = maker.accessor(np.array([0.0, 1.0], np.float32))
    animation["samplers"].append({**animation["samplers"][0], "output": weights})
    animation["channels"].append({"sampler": 2, "target": {"node": 0, "path": "weights"}})
    source = convert(gltf_arm.write(tmp_path, maker), rigged=True)
    text = structure(Sdf.Layer.FindOrOpen(str(source.layer)))
    assert "BlendShape" in text
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    assert (CONVERTER_NUMBER, digest) == (1, "24720f493ca38bd6")


def test_pictures_inside_a_file_are_written_next_to_the_layer(tmp_path):
    maker = GltfMaker()
    uvs = CORNERS[:, :2].astype(np.float32)
    rows = []
    for i in range(3):
        maker.mesh(maker.primitive(CORNERS + i, TRIANGLES, TEXCOORD_0=uvs) | {"material": i})
        rows.append({"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}})
    maker.tree["materials"] = rows
    maker.tree["textures"] = [{"source": i} for i in range(3)]
    red, blue = maker.view(png((255, 0, 0))), maker.view(png((0, 0, 255)))
    maker.tree["images"] = [
        {"bufferView": red, "mimeType": "image/png", "name": "../skin"},
        {"bufferView": blue, "mimeType": "image/png", "name": "../skin"},
        {"bufferView": red, "mimeType": "image/png", "name": "again"},
    ]
    source = convert(maker.glb(tmp_path / "thing.glb"))
    target = tmp_path / "out" / "thing.source.usdc"
    target.parent.mkdir()
    folder = tmp_path / "out" / "thing.textures"
    assert source.textures(target) == (folder / "_skin.png", folder / "_skin_2.png")
    source.write(target)
    colors = [s.materials[0].texture.pixels[0, 0].tolist() for s in read_asset(target).surfaces]
    assert colors == [[255, 0, 0], [0, 0, 255], [255, 0, 0]]
    (folder / "_skin_2.png").unlink()
    assert not source.is_at(target)


def test_a_place_that_cannot_be_written_is_said(cube):
    with pytest.raises(BakeError, match="could not be written"):
        convert(cube).write(cube / "below a file" / "my cube.source.usdc")


CONVERTER = """#!{python}
import sys
from pxr import Usd, UsdGeom
assert sys.argv[1::2] == ["-i", "-o", "--preview-surface"]
if "broken" in sys.argv[2]:
    sys.exit("no such format")
stage = Usd.Stage.CreateNew(sys.argv[4])
UsdGeom.SetStageMetersPerUnit(stage, 0.01)
UsdGeom.SetStageUpAxis(stage, "Z")
cube = UsdGeom.Cube.Define(stage, "/World")
stage.SetDefaultPrim(cube.GetPrim())
stage.Save()
"""


def test_fbx_without_its_program_is_refused_with_a_hint(tmp_path, monkeypatch):
    path = tmp_path / "thing.fbx"
    path.write_bytes(b"Kaydara FBX Binary")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="usd-convert-asset, which is not on PATH") as error:
        read_asset(path)
    assert "pip install usd-convert-asset" in error.value.hint


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="the stand-in for the program is a script")
def test_fbx_by_its_program(tmp_path, monkeypatch):
    program = tmp_path / "bin" / "usd-convert-asset"
    program.parent.mkdir()
    program.write_text(CONVERTER.format(python=sys.executable))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    path = tmp_path / "thing.fbx"
    path.write_bytes(b"Kaydara FBX Binary")
    source = convert(path, meters_per_unit=0.1)
    asset = source.asset()
    assert asset.facts.path == path
    assert asset.facts.up_axis == "Z"
    assert asset.surfaces[0].points.max() == pytest.approx(0.1)
    assert asset.facts.notes[0] == "FBX was converted by usd-convert-asset"
    written = read_asset(source.write(tmp_path / "thing.source.usdc"))
    assert written.facts.units.length == 0.1
    path.rename(tmp_path / "broken.fbx")
    with pytest.raises(InputError, match="failed with status 1: no such format"):
        read_asset(tmp_path / "broken.fbx")
