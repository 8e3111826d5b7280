"""TetMesh and Points prims in the cache: their own points move, their topology is the source's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from gf_usd.core.frames.frame import MeshPose
from gf_usd.layers.stage import Clock
from gf_usd.layers.tracks.meshes import MeshTrack
from gf_usd.readers import read_asset

CLOCK = Clock(rate=24.0, source_rate=24.0, start=1.0, end=2.0, step=1.0)
TETS = """#usda 1.0
(metersPerUnit = 0.01
 upAxis = "Y")
def TetMesh "T"
{
    point3f[] points = [(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4), (1, 1, 1)]
    int4[] tetVertexIndices = [(4, 1, 2, 3), (0, 4, 2, 3), (0, 1, 4, 3), (0, 1, 2, 4)]
    double3 xformOp:translate = (0, 10, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
POINTS = """#usda 1.0
(metersPerUnit = 0.01
 upAxis = "Y")
def Points "P"
{
    point3f[] points = [(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4)]
    float[] widths = [4, 3, 2, 3]
    normal3f[] normals = [(0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 1, 0)]
}
"""
UP = np.array([0.0, 0.5, 0.0])  # [m] and [m/s]


def moved(tmp_path: Path, text: str) -> tuple[Usd.Stage, Usd.Prim, int]:
    """Stage and prim of a bake that lifts all by UP over a frame; and points of its surface."""
    source = tmp_path / "a.usda"
    source.write_text(text)
    (surface,) = read_asset(source).surfaces
    stage = Usd.Stage.Open(str(source))
    layer = Sdf.Layer.CreateAnonymous(".usda")
    cache = Usd.Stage.Open(layer)
    prim = stage.GetPrimAtPath(surface.path)
    track = MeshTrack(cache, prim, surface, CLOCK, 0.01)
    v = np.broadcast_to(UP, surface.points.shape)
    for frame in (0, 1):
        track.write(
            MeshPose(points=surface.points + frame * UP, velocities=v, normals=surface.normals),
            1.0 + frame,
        )
    root = Sdf.Layer.CreateAnonymous(".usda")
    root.subLayerPaths = [layer.identifier, str(source)]
    result = Usd.Stage.Open(root)
    return result, result.GetPrimAtPath(surface.path), len(surface.points)


@pytest.mark.slow
@pytest.mark.parametrize(("text", "kind"), [(TETS, "TetMesh"), (POINTS, "Points")])
def test_each_of_its_own_points_moves(tmp_path: Path, text: str, kind: str) -> None:
    _stage, prim, count = moved(tmp_path, text)
    assert prim.GetTypeName() == kind
    at = prim.GetAttribute("points")
    before, after = np.array(at.Get(1.0)), np.array(at.Get(2.0))
    source = np.array(at.Get(Usd.TimeCode.Default()))
    np.testing.assert_allclose(before, source, atol=1e-5)
    np.testing.assert_allclose(after - before, np.broadcast_to(UP / 0.01, before.shape), atol=1e-5)
    np.testing.assert_allclose(prim.GetAttribute("velocities").Get(2.0), after - before, atol=1e-5)
    assert (count > len(before)) == (kind == "Points")


def test_tetrahedra_keep_their_topology(tmp_path: Path) -> None:
    _stage, prim, _ = moved(tmp_path, TETS)
    stack = prim.GetAttribute("tetVertexIndices").GetPropertyStack()
    assert [spec.layer.realPath for spec in stack] == [str(tmp_path / "a.usda")]
    assert not prim.HasAttribute("faceVertexIndices")


@pytest.mark.slow
def test_the_extent_of_points_is_that_of_their_balls(tmp_path: Path) -> None:
    _stage, prim, _ = moved(tmp_path, POINTS)
    for time in (1.0, 2.0):
        wanted = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), time)
        np.testing.assert_array_equal(prim.GetAttribute("extent").Get(time), wanted)


@pytest.mark.slow
def test_normals_of_points_are_carried(tmp_path: Path) -> None:
    _stage, prim, _ = moved(tmp_path, POINTS)
    np.testing.assert_allclose(
        prim.GetAttribute("normals").Get(2.0), np.tile((0, 1, 0), (4, 1)), atol=1e-6
    )
