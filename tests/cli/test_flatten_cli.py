"""One file from the command line: what is written, what is refused, what is left of a failure."""

from __future__ import annotations

import hashlib
import io
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Sdf, Usd, UsdShade
from small_bakes import SAMPLES, SMALL, names, strict

from gf_usd.core.errors import SolverError
from gf_usd.layers.check.run import check_file


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one.usdz", "one.usdc"])
def test_one_file_and_a_report(gf_usd, here: Path, block: Path, name: str) -> None:
    before = hashlib.sha256(block.read_bytes()).hexdigest()
    done = gf_usd("bake", block, *SMALL, "--flatten", "-o", name, "--json")
    assert done.status == 0
    assert names(here) == sorted([name, "one.report.json"])
    result = strict(done.out)
    assert result["outputs"] == [name, "one.report.json"]
    assert (result["root"], result["bakes"][0]["cache"]) == (name, name)
    assert result["check"] == []
    assert hashlib.sha256(block.read_bytes()).hexdigest() == before
    block.unlink()
    assert check_file(here / name).ok
    stage = Usd.Stage.Open(str(here / name))
    points = stage.GetAttributeAtPath("/World/Block.points")
    assert points.GetTimeSamples() == [101.0, 102.0, 103.0, 104.0, 105.0, 106.0]
    assert stage.GetPrimAtPath("/World/GaussianFlesh/Gaussians")
    # nothing but the file itself, and the stage's session
    assert {layer.realPath for layer in stage.GetUsedLayers()} == {str(here / name), ""}


@pytest.mark.slow
def test_the_suffix_decides_and_the_name_has_a_default(gf_usd, here: Path, block: Path) -> None:
    assert gf_usd("bake", block, *SMALL, "-q", "-o", "a.usdz").status == 0
    assert gf_usd("bake", block, *SMALL, "-q", "--flatten").status == 0
    assert names(here) == [
        "a.report.json", "a.usdz", "block.rubber.report.json", "block.rubber.usdc",
    ]  # fmt: skip
    again = gf_usd("bake", block, *SMALL, "-q", "-o", "a.usdz")
    assert again.status == 2
    assert "a.usdz exists already" in again.err
    first = (here / "a.usdz").read_bytes()
    assert gf_usd("bake", block, *SMALL, "-q", "-o", "a.usdz", "--overwrite").status == 0
    assert len((here / "a.usdz").read_bytes()) == len(first)


def test_one_file_holds_one_material(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "-m", "rubber,jelly", "-o", "a.usdz")
    assert done.status == 2
    assert "a.usdz would be one file for 2 materials: rubber, jelly" in done.err
    clips = gf_usd("bake", block, *SMALL, "--flatten", "--clip-frames", "2")
    assert clips.status == 2
    assert "--clip-frames 2 and --flatten were both given" in clips.err
    clips = gf_usd("bake", block, *SMALL, "-o", "a.usdz", "--clip-frames", "2")
    assert clips.status == 2
    assert "--clip-frames 2 and a package were both given" in clips.err
    assert names(here) == []


def toy(folder: Path) -> Path:
    """A glb with a picture inside."""
    box = trimesh.creation.box((0.2, 0.4, 0.6))
    pixels = np.zeros((4, 8, 3), np.uint8)
    pixels[:2], pixels[2:] = (250, 0, 0), (0, 0, 250)
    material = trimesh.visual.material.PBRMaterial(
        name="skin", baseColorTexture=Image.fromarray(pixels)
    )
    box.visual = trimesh.visual.TextureVisuals(
        uv=box.vertices[:, :2] * [1.0, 1.5] + 0.5, material=material
    )
    path = folder / "toy.glb"
    path.write_bytes(trimesh.Scene(box).export(file_type="glb"))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["toy.usdz", "toy.usdc"])
def test_a_mesh_file_becomes_one_file(gf_usd, here: Path, tmp_path: Path, name: str) -> None:
    glb = toy(tmp_path)
    done = gf_usd("bake", glb, *SMALL, "--flatten", "-o", name, "--json")
    assert done.status == 0
    written = sorted(p.relative_to(here).as_posix() for p in here.rglob("*") if p.is_file())
    assert written == sorted(strict(done.out)["outputs"])
    assert not any("source" in path for path in written)
    glb.unlink()
    moved = tmp_path / "moved"
    shutil.move(here, moved)
    stage = Usd.Stage.Open(str(moved / name))
    mesh = next(p for p in stage.Traverse() if p.GetTypeName() == "Mesh")
    material = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
    texture = stage.GetPrimAtPath(material.GetPath().AppendChild("diffuseColor_texture"))
    file = texture.GetAttribute("inputs:file").Get()
    assert file.resolvedPath.startswith(str(moved))
    assert Image.open(io.BytesIO(_read(file.resolvedPath))).size == (8, 4)


def _read(resolved: str) -> bytes:
    outer, _, inner = resolved.rstrip("]").partition("[")
    if not inner:
        return Path(outer).read_bytes()
    return bytes(Sdf.ZipFile.Open(outer).GetFile(inner))


@pytest.mark.slow
def test_a_failure_leaves_the_layers_it_worked_on(
    gf_usd, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gf_usd.physics.frame_loop import Solver

    sound = Solver.next

    def fails(self, index, last):
        if index == 3:
            raise SolverError("frame 3: broken", "mend it", frame=3, particle=0)
        return sound(self, index, last)

    monkeypatch.setattr(Solver, "next", fails)
    done = gf_usd("bake", SAMPLES / "sphere.usda", *SMALL, "-o", "a.usdz")
    assert done.status == 1
    assert names(here) == ["a.cache.partial.usdc", "a.layers.partial.usda", "a.report.json"]
    stage = Usd.Stage.Open("a.layers.partial.usda")
    assert stage.GetAttributeAtPath("/Sphere/Geom/Body.points").GetTimeSamples() == [1.0, 2.0, 3.0]
    del stage  # a layer that is open cannot be made anew
    monkeypatch.setattr(Solver, "next", sound)
    assert gf_usd("bake", SAMPLES / "sphere.usda", *SMALL, "-o", "a.usdz", "-q").status == 0
    assert names(here) == ["a.report.json", "a.usdz"]


@pytest.mark.slow
def test_a_report_of_one_file_names_its_variant(gf_usd, here: Path, block: Path) -> None:
    from gf_usd.readers.pictures.recording import BakedMotion

    assert gf_usd("bake", block, *SMALL, "-q", "-o", "a.usdz").status == 0
    motion = BakedMotion(here / "a.usdz")
    assert (motion.variants, motion.variant) == (("rubber",), "rubber")
    assert motion.recording().ground == 0.0
    assert gf_usd("report", "a.usdz").status == 0
    assert "does not record how it was baked" not in (here / "a.html").read_text()
