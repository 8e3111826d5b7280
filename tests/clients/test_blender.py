"""Blender plays what we wrote: where, how it shades, and what of the particles it shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm import LAST
from client_assets import DRIVEN, FRAMES, Baked, bake_driven, shot, world_points
from client_runs import in_blender, needs
from pxr import Usd, UsdGeom, UsdShade, Vt

pytestmark = [pytest.mark.clients, needs("blender")]

NEAR = 1e-5  # of the size of the scene: positions and matrices are single precision in Blender
SHADE = 2e-3  # custom normals are two 16-bit angles in Blender


def off(theirs: dict[str, np.ndarray], ours: dict[str, np.ndarray]) -> float:
    """The largest distance of vertices over the size of the scene, of all prims and frames."""
    found = {k.removeprefix("points:"): v for k, v in theirs.items() if k.startswith("points:")}
    assert found.keys() == ours.keys()
    size = max(float(np.abs(points).max()) for points in ours.values())
    assert all(found[path].shape == points.shape for path, points in ours.items())
    return max(float(np.abs(found[path] - points).max()) for path, points in ours.items()) / size


@pytest.mark.parametrize("asset", ["duck", "blocks", "obj", "character"])
def test_every_vertex_is_where_we_put_it_in_every_frame(
    asset: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    baked: Baked = request.getfixturevalue(asset)
    ours = world_points(baked.root)
    theirs, report = in_blender(baked.root, tmp_path)
    assert all(points.shape[0] in (FRAMES, LAST) for points in ours.values())
    # it does move: a still picture would pass otherwise
    assert all(np.ptp(points, axis=0).max() > 100 * NEAR for points in ours.values())
    assert off(theirs, ours) < NEAR
    stage = Usd.Stage.Open(str(baked.root))
    assert report["range"] == [stage.GetStartTimeCode(), stage.GetEndTimeCode()]


@pytest.mark.parametrize("what", DRIVEN)
def test_flesh_plays_as_it_was_baked(what: str, tmp_path: Path) -> None:
    """Springs, limits, fields and a loop: where we put every vertex, and so not skinned twice."""
    baked = bake_driven(tmp_path, what)
    ours = world_points(baked.root)
    theirs, report = in_blender(baked.root, tmp_path)
    assert all(np.ptp(points, axis=0).max() > 100 * NEAR for points in ours.values())
    assert off(theirs, ours) < NEAR
    stage = Usd.Stage.Open(str(baked.root))
    assert report["range"] == [stage.GetStartTimeCode(), stage.GetEndTimeCode()]


def test_samples_that_are_left_out_are_interpolated(sparse: Baked, tmp_path: Path) -> None:
    ours = world_points(sparse.root)
    stage = Usd.Stage.Open(str(sparse.root))
    for path in ours:
        points = UsdGeom.Mesh(stage.GetPrimAtPath(path)).GetPointsAttr()
        assert 1 < points.GetNumTimeSamples() < FRAMES
    theirs, report = in_blender(sparse.root, tmp_path)
    assert off(theirs, ours) < NEAR
    assert report["range"] == [stage.GetStartTimeCode(), stage.GetEndTimeCode()]


@pytest.mark.parametrize("asset", ["duck", "blocks"])
def test_normals_uvs_and_materials_arrive(
    asset: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    baked: Baked = request.getfixturevalue(asset)
    theirs, _ = in_blender(baked.root, tmp_path)
    stage = Usd.Stage.Open(str(baked.root))
    for path in world_points(baked.root):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get())
        assert np.array_equal(theirs[f"corners:{path}"], corners)
        uv = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").ComputeFlattened()
        assert np.allclose(theirs[f"uv:{path}"], np.array(uv), atol=1e-6)
        ours = _world_normals(mesh, stage.GetEndTimeCode(), corners)
        assert np.abs(theirs[f"normals:{path}"] - ours).max() < SHADE
        assert theirs[f"subset:{path}"].tolist() == _material_names(mesh)


@pytest.mark.parametrize("asset", ["duck", "blocks"])
def test_points_arrive_with_samples_in_a_shot_that_selects_them(
    asset: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    baked: Baked = request.getfixturevalue(asset)
    root = shot(baked, tmp_path / "shot.usda", "points")
    theirs, report = in_blender(root, tmp_path)
    ours = world_points(root, "Points")
    assert len(ours) == 1
    assert off(theirs, ours) < NEAR
    assert "MESH" not in report["objects"].values()
    (names,) = report["attributes"].values()
    assert {"position", "radius", "id", "velocity", "displayColor"} <= set(names)


def test_gaussians_are_an_empty_in_blender(duck: Baked, tmp_path: Path) -> None:
    root = shot(duck, tmp_path / "shot.usda", "gaussians")
    _, report = in_blender(root, tmp_path)
    assert report["objects"]["Gaussians"] == "EMPTY"
    assert not {"MESH", "POINTCLOUD"} & set(report["objects"].values())


def test_a_vertex_out_of_place_is_seen(blocks: Baked, tmp_path: Path) -> None:
    ours = world_points(blocks.root)
    damaged = blocks.with_output_folder(tmp_path / "damaged")
    cache = Usd.Stage.Open(str(damaged.caches[0]))
    points = UsdGeom.Mesh(cache.GetPrimAtPath("/Blocks/left/Mesh")).GetPointsAttr()
    (*_, last) = points.GetTimeSamples()
    moved = np.array(points.Get(last))
    moved[7] *= 1.01
    points.Set(Vt.Vec3fArray.FromNumpy(moved), last)
    cache.Save()
    theirs, _ = in_blender(damaged.root, tmp_path)
    assert off(theirs, ours) > NEAR


def test_a_lost_unit_is_seen(blocks: Baked, tmp_path: Path) -> None:
    ours = world_points(blocks.root)
    damaged = blocks.with_output_folder(tmp_path / "damaged")
    layer = Usd.Stage.Open(str(damaged.root))
    UsdGeom.SetStageMetersPerUnit(layer, 1.0)
    layer.Save()
    theirs, _ = in_blender(damaged.root, tmp_path)
    assert off(theirs, ours) > NEAR


def _material_names(mesh: UsdGeom.Mesh) -> list[str]:
    """Of the material that each face shows, by its subset."""
    names = {}
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(mesh.GetPrim())):
        material, _ = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()
        names |= dict.fromkeys(subset.GetIndicesAttr().Get(), material.GetPrim().GetName())
    return [names[face] for face in range(len(mesh.GetFaceVertexCountsAttr().Get()))]


def _world_normals(mesh: UsdGeom.Mesh, time: float, corners: np.ndarray) -> np.ndarray:
    """(corners, 3), unit, in a Z-up world, as Blender shows them."""
    matrix = np.array(mesh.ComputeLocalToWorldTransform(time))[:3, :3]
    normals = np.array(mesh.GetNormalsAttr().Get(time), np.float64)
    if mesh.GetNormalsInterpolation() == UsdGeom.Tokens.vertex:
        normals = normals[corners]
    world = normals @ np.linalg.inv(matrix).T
    if UsdGeom.GetStageUpAxis(mesh.GetPrim().GetStage()) == UsdGeom.Tokens.y:
        world = world @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return world / np.linalg.norm(world, axis=1, keepdims=True)
