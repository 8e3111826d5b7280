"""`--max-edge-length` in a bake: the mesh shows what its body does, over a layer of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from small_bakes import names

from gf_usd import bake
from gf_usd.core.errors import UsageError

CUBE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{
    def Mesh "Cube"
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0,1,2,3, 4,7,6,5, 0,4,5,1, 1,5,6,2, 2,6,7,3, 3,7,4,0]
        point3f[] points = [(-1,0,-1), (1,0,-1), (1,0,1), (-1,0,1),
                            (-1,2,-1), (1,2,-1), (1,2,1), (-1,2,1)]
    }
}
"""
OPTIONS = {"material": "jelly", "particles": 600, "frames": 24, "drop": 3.0}


@pytest.fixture
def cube(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "cube.usda"
    path.write_text(CUBE)
    return path


def points(stage: Usd.Stage, code: float) -> np.ndarray:
    return np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/World/Cube")).GetPointsAttr().Get(code))


@pytest.mark.slow
def test_a_coarse_mesh_is_warned_of_and_a_divided_one_is_not(cube: Path) -> None:
    coarse = bake(cube, **OPTIONS)
    (warning,) = [w for _, w in coarse.warnings if w.about == "coarse-mesh"]
    assert "</World/Cube>" in warning.message
    assert "max_edge_length='auto'" in warning.hint
    assert coarse.health["outside_mesh_max_share"] > 0.01
    assert coarse.health["outside_meshes"] == ["/World/Cube"]
    before = cube.read_bytes()
    fine = bake(cube, **OPTIONS, max_edge_length=0.5, output="fine.usda")
    assert cube.read_bytes() == before
    assert [w for _, w in fine.warnings if w.about == "coarse-mesh"] == []
    assert (fine.health["outside_mesh_max_share"] or 0.0) <= 0.01
    assert names(Path()) == [
        "cube.jelly.cache.usdc", "cube.jelly.report.json", "cube.jelly.usda", "cube.usda",
        "fine.cache.usdc", "fine.report.json", "fine.source.usdc", "fine.usda",
    ]  # fmt: skip
    stage = Usd.Stage.Open("fine.usda")
    rest, bent = points(stage, 1), points(stage, 24)
    assert len(rest) == len(bent) > 8
    # the same cube at first, lifted, and faces that are flat no more in the end
    np.testing.assert_allclose(np.ptp(rest, axis=0), 2.0, rtol=1e-5)
    counts = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Cube")).GetFaceVertexCountsAttr().Get()
    assert set(counts) == {3}
    corners = np.linalg.norm(np.abs(rest - rest.mean(0)) - 1.0, axis=1) < 1e-5
    assert corners.sum() == 8
    assert np.ptp(bent[:, 1]) < np.ptp(rest[:, 1])
    # without the bake, the divided mesh of the source
    stage.GetPrimAtPath("/World").GetVariantSet("gaussianFlesh").SetVariantSelection("none")
    assert len(points(stage, 1)) == len(rest)


@pytest.mark.slow
def test_long_faces_are_told_of_once(gf_usd, cube: Path) -> None:
    """A note says it before the bake; the report has the warning of what was measured."""
    words = ("-m", "jelly", "--particles", "600", "--frames", "24", "--drop", "3")
    done = gf_usd("bake", cube, *words)
    assert done.status == 0
    assert done.err.count("note: faces of </World/Cube> (edges up to") == 1
    assert "coarse-mesh" not in done.out + done.err
    assert "coarse-mesh" in Path("cube.jelly.report.json").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_layer_is_used_again_for_the_same_and_refused_for_another(cube: Path) -> None:
    options = {**OPTIONS, "frames": 2}
    bake(cube, **options, max_edge_length=0.5)
    layer = Path("cube.jelly.source.usdc")
    made = layer.read_bytes()
    for path in Path().glob("cube.jelly.*"):
        if path != layer:
            path.unlink()
    bake(cube, **options, max_edge_length=0.5)
    assert layer.read_bytes() == made
    for path in Path().glob("cube.jelly.*"):
        if path != layer:
            path.unlink()
    with pytest.raises(UsageError, match="exists already, and was made from another file"):
        bake(cube, **options, max_edge_length=0.7)
    bake(cube, **options, max_edge_length=0.7, overwrite=True)
    assert layer.read_bytes() != made


@pytest.mark.parametrize(
    ("given", "message"),
    [("0", "max_edge_length is 0"), ("nan", "not a number"), ("inf", "not a number"),
     ("fine", "not a number")],
)  # fmt: skip
def test_lengths_that_are_none_are_refused(cube: Path, given: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as error:
        bake(cube, **OPTIONS, max_edge_length=given)
    assert "auto" in error.value.hint


@pytest.mark.slow
def test_two_spacings_of_the_particles(cube: Path) -> None:
    options = {**OPTIONS, "frames": 2}
    by_count = bake(cube, **options, max_edge_length="auto")
    there = len(points(Usd.Stage.Open(str(by_count.root)), 1))
    spacing = (8.0 / 600) ** (1.0 / 3.0)
    same = bake(cube, **options, max_edge_length=2.0 * spacing, output="same.usda")
    assert len(points(Usd.Stage.Open(str(same.root)), 1)) == there
    del options["particles"]
    spaced = bake(cube, **options, spacing=spacing, max_edge_length="auto", output="spaced.usda")
    assert len(points(Usd.Stage.Open(str(spaced.root)), 1)) == there


def test_one_file_needs_no_layer(cube: Path) -> None:
    options = {**OPTIONS, "frames": 2}
    bake(cube, **options, max_edge_length=0.5, output="one.usdz")
    assert names(Path()) == ["cube.usda", "one.report.json", "one.usdz"]
    assert len(points(Usd.Stage.Open("one.usdz"), 1)) > 8
