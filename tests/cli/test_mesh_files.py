"""gf-usd bake on mesh files: the result is USD over NAME.source.usdc."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Sdf, Usd, UsdGeom, UsdShade

SIZES = ["--particles", "300", "--frames", "2", "-q"]


@pytest.fixture(autouse=True)
def in_the_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def glb(tmp_path):
    """A box with a red and blue picture, turned and lifted by its node."""
    box = trimesh.creation.box((0.2, 0.4, 0.6))
    pixels = np.zeros((4, 8, 3), np.uint8)
    pixels[:2], pixels[2:] = (250, 0, 0), (0, 0, 250)
    material = trimesh.visual.material.PBRMaterial(
        name="skin", baseColorTexture=Image.fromarray(pixels), metallicFactor=0.0
    )
    uv = box.vertices[:, :2] * [1.0, 1.5] + 0.5
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    scene = trimesh.Scene()
    matrix = trimesh.transformations.rotation_matrix(0.5, (0, 0, 1), (1.0, 0, 0))
    scene.add_geometry(box, node_name="box", transform=matrix)
    path = tmp_path / "toy.glb"
    path.write_bytes(scene.export(file_type="glb"))
    return path


def test_a_textured_glb_from_file_to_layers(gf_usd, glb, tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.chdir(out)
    dry = gf_usd("bake", glb, *SIZES[:4], "--dry-run", "--json")
    assert dry.status == 0, dry.err
    assert list(out.iterdir()) == []
    planned = json.loads(dry.out)["outputs"]
    done = gf_usd("bake", glb, *SIZES)
    assert done.status == 0, done.err
    written = sorted(p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file())
    assert written == sorted(planned)
    assert "toy.source.usdc" in written
    report = json.loads((out / "toy.rubber.report.json").read_text())
    assert report["check"] == []
    stage = Usd.Stage.Open(str(out / "toy.rubber.usda"))
    (mesh,) = (UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    assert mesh.GetPointsAttr().GetTimeSamples() == [1.0, 2.0]
    material = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
    texture = stage.GetPrimAtPath(material.GetPath().AppendChild("diffuseColor_texture"))
    file = texture.GetAttribute("inputs:file").Get()
    assert file.resolvedPath.startswith(str(out / "toy.textures"))
    gaussians = stage.GetPrimAtPath(f"{stage.GetDefaultPrim().GetPath()}/GaussianFlesh/Points")
    colors = np.array(UsdGeom.PrimvarsAPI(gaussians).GetPrimvar("displayColor").Get())
    # the picture reaches the particles: each is red or blue, hardly one in between
    assert colors[:, 1].max() < 0.01
    assert (colors[:, 0] > 0.5).mean() > 0.3
    assert (colors[:, 2] > 0.5).mean() > 0.3


@pytest.mark.skipif(os.name == "nt", reason="symbolic links need a permission there")
def test_textures_by_absolute_paths_are_noted(gf_usd, tmp_path):
    """Of a mesh file next to its texture, baked into a folder that is a link to one elsewhere."""
    box = trimesh.creation.box((0.2, 0.4, 0.6))
    box.visual = trimesh.visual.TextureVisuals(
        uv=box.vertices[:, :2], image=Image.new("RGB", (2, 2))
    )
    (tmp_path / "models").mkdir()
    box.export(tmp_path / "models/box.obj")
    (tmp_path / "deep/er").mkdir(parents=True)
    (tmp_path / "out").symlink_to("deep/er")
    done = gf_usd("bake", "models/box.obj", *SIZES[:4], "-o", "out/")
    notes = [line for line in done.err.splitlines() if "is reached through a symbolic link" in line]
    notes += [line for line in done.out.splitlines() if "is reached through a" in line]
    assert notes == [
        "note: out is reached through a symbolic link: box.source.usdc refers to material_0.png by"
        " its absolute path, which is the same by any path to it"
    ]


@pytest.mark.slow
def test_bakes_of_one_file_share_its_layer(gf_usd, tmp_path):
    path = tmp_path / "box.obj"
    path.write_text(trimesh.creation.box((0.2, 0.4, 0.6)).export(file_type="obj"))
    assert gf_usd("bake", path, *SIZES, "--meters-per-unit", "0.5").status == 0
    source = tmp_path / "box.source.usdc"
    before = source.read_bytes()
    again = gf_usd("bake", path, *SIZES, "-m", "jelly", "--meters-per-unit", "0.5")
    assert again.status == 0, again.err
    assert source.read_bytes() == before
    stage = Usd.Stage.Open(str(tmp_path / "box.jelly.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.5
    other = gf_usd("bake", path, *SIZES, "-m", "metal", "--up-axis", "Z")
    assert other.status == 2
    assert "box.source.usdc exists already, and was made from another file" in other.err
    assert not (tmp_path / "box.metal.usda").exists()
    forced = gf_usd("bake", path, *SIZES, "-m", "metal", "--up-axis", "Z", "--overwrite")
    assert forced.status == 0, forced.err
    # this process has the earlier layer open and would show that
    assert Sdf.Layer.OpenAsAnonymous(str(source)).pseudoRoot.GetInfo("upAxis") == "Z"


@pytest.mark.slow
def test_no_layer_of_another_mesh_file_is_replaced(gf_usd, tmp_path):
    """Bakes of `box.obj` lie over `box.source.usdc`: they would show `box.ply`."""
    box = trimesh.creation.box((0.2, 0.4, 0.6))
    for suffix in ("obj", "ply"):
        box.export(tmp_path / f"box.{suffix}")
    assert gf_usd("bake", tmp_path / "box.obj", *SIZES).status == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    other = gf_usd("bake", tmp_path / "box.ply", *SIZES, "-o", "other.usda", "--overwrite")
    assert other.status == 2
    assert (
        "box.source.usdc was made from box.obj, and bakes of it may be layered over it" in other.err
    )
    assert "another folder with -o" in other.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    # a layer over the divided faces is that of one bake
    divided = ("--max-edge-length", "auto", "-o", "fine.usda")
    assert gf_usd("bake", tmp_path / "box.obj", *SIZES, *divided).status == 0
    assert gf_usd("bake", tmp_path / "box.ply", *SIZES, *divided, "--overwrite").status == 0


def test_a_refused_file_leaves_nothing(gf_usd, tmp_path):
    path = tmp_path / "broken.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n")
    refused = gf_usd("bake", path, *SIZES)
    assert refused.status == 3
    assert "broken.obj, line 4: the face names v 4, but there are 3" in refused.err
    assert [p.name for p in tmp_path.iterdir()] == ["broken.obj"]
