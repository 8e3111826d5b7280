"""Each mesh keeps what it was, and nothing above it disagrees with its motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from small_sources import IMPLICIT, INSTANCES, MOVING, PLAIN, ROOT_MESH, SKINNED, Source
from small_stages import (
    EPS,
    bake,
    frames_of,
    motion,
    world,
    write_cache,
)


def test_normals_come_back_and_their_indices_are_gone(tmp_path: Path) -> None:
    asset = MOVING.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    prim = stage.GetPrimAtPath("/root/arm/m")
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    assert not primvar.IsIndexed()
    assert primvar.GetInterpolation() == "vertex"
    assert not prim.GetAttribute("normals").HasAuthoredValue()
    assert prim.GetAttribute("accelerations").Get(1) is None
    at_rest = np.array(primvar.Get(Usd.TimeCode.Default()))
    np.testing.assert_array_equal(at_rest, [(0, 0, 1), (0, 1, 0)] * 4)
    for frame in frames_of(asset, particles, info):
        xforms = UsdGeom.XformCache(frame.time_code)
        matrix = np.array(xforms.GetLocalToWorldTransform(prim))[:3, :3]
        found = np.array(primvar.Get(frame.time_code), np.float64) @ np.linalg.inv(matrix).T
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        # scales of 2 to 50 spread the rounding of a float32 direction by their ratio
        np.testing.assert_allclose(found, frame.meshes["/root/arm/m"].normals, atol=5e-6)


def test_normals_that_were_not_carried_are_blocked_and_noted(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    body = replace(asset.surfaces[0], normals=None, normals_interpolation="")
    asset = replace(asset, surfaces=(body,))
    summary, _, _ = write_cache(tmp_path / "c.usdc", asset)
    assert summary.notes == (
        "</duck/geo/body>: its authored normals cannot follow the motion and are blocked",
    )
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "c.usdc"))
    assert layer.GetAttributeAtPath("/duck/geo/body.normals").default == Sdf.ValueBlock()


def test_of_two_kinds_of_normals_neither_is_left_at_rest(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(asset.facts.path))
    mesh = layer.GetPrimAtPath("/duck/geo/body")
    Sdf.AttributeSpec(mesh, "primvars:normals", Sdf.ValueTypeNames.Normal3fArray).default = [
        (0, 1, 0)
    ]
    layer.Save()
    body = replace(asset.surfaces[0], normals=None, normals_interpolation="")
    write_cache(tmp_path / "c.usdc", replace(asset, surfaces=(body,)))
    cache = Sdf.Layer.FindOrOpen(str(tmp_path / "c.usdc"))
    for name in ("normals", "primvars:normals"):
        assert cache.GetAttributeAtPath(f"/duck/geo/body.{name}").default == Sdf.ValueBlock()


@pytest.mark.parametrize("binding", ["on the mesh", "on the SkelRoot"])
def test_baked_skin_is_not_skinned_again(binding: str, tmp_path: Path) -> None:
    asset = SKINNED.asset(tmp_path)
    if binding == "on the SkelRoot":
        layer = Sdf.Layer.FindOrOpen(str(asset.facts.path))
        skin, above = (layer.GetPrimAtPath(p) for p in ("/root/figure/skin", "/root/figure"))
        above.SetInfo("apiSchemas", skin.GetInfo("apiSchemas"))
        for name in [p.name for p in skin.properties if "skel:" in p.name]:
            Sdf.CopySpec(
                layer, skin.path.AppendProperty(name), layer, above.path.AppendProperty(name)
            )
            skin.RemoveProperty(skin.properties[name])
        layer.Save()
    theirs = Usd.Stage.Open(str(asset.facts.path))
    assert skinned_prims(theirs) == ["/root/figure/skin"]
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    assert skinned_prims(stage) == []
    # USD's own baker leaves the points alone
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/root/figure")))
    for frame in frames_of(asset, particles, info):
        found = world(stage, "/root/figure/skin", "points", frame.time_code)
        expected = frame.meshes["/root/figure/skin"].points
        np.testing.assert_allclose(found, expected, atol=EPS * 10)


def skinned_prims(stage: Usd.Stage) -> list[str]:
    root, cache = UsdSkel.Root(stage.GetPrimAtPath("/root/figure")), UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    bindings = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    return [str(q.GetPrim().GetPath()) for b in bindings for q in b.GetSkinningTargets()]


def test_boxes_above_the_mesh_follow_it(tmp_path: Path) -> None:
    for source, path in ((SKINNED, "/root/figure/skin"), (PLAIN, "/duck/geo/body")):
        asset = source.asset(tmp_path, f"{path.count('/')}{path[1:5]}.usda")
        root, particles, info = bake(asset, tmp_path)
        stage = Usd.Stage.Open(str(root.path))
        for frame in frames_of(asset, particles, info):
            boxes = UsdGeom.BBoxCache(frame.time_code, ["default", "render"], useExtentsHint=True)
            box = boxes.ComputeWorldBound(stage.GetPseudoRoot()).ComputeAlignedRange()
            points = frame.meshes[path].points
            np.testing.assert_allclose(box.GetMin(), points.min(axis=0), atol=EPS * 10)
            np.testing.assert_allclose(box.GetMax(), points.max(axis=0), atol=EPS * 10)


def test_other_skins_of_the_skeleton_stay_in_its_box(tmp_path: Path) -> None:
    asset = SKINNED.asset(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(asset.facts.path))
    hat = Sdf.Path("/root/figure/hat")
    Sdf.CopySpec(layer, "/root/figure/skin", layer, hat)
    layer.GetAttributeAtPath(hat.AppendProperty("extent")).default = [(0, 0, 0), (9, 9, 9)]
    layer.Save()
    write_cache(tmp_path / "c.usdc", asset)
    cache = Usd.Stage.Open(str(tmp_path / "c.usdc"))
    # the skeleton lifts the hat by 7 at the last frame
    extent = cache.GetAttributeAtPath("/root/figure.extent").Get(5)
    np.testing.assert_allclose(extent[1], (9, 16, 9), rtol=1e-6)


def test_instances_with_baked_proxies_end_only_in_the_bake(tmp_path: Path) -> None:
    asset = INSTANCES.asset(tmp_path)
    root, _, _ = bake(replace(asset, surfaces=asset.surfaces[:1]), tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    assert asset.surfaces[0].path == "/root/left/seat"
    assert not stage.GetPrimAtPath("/root/left").IsInstance()
    assert len(stage.GetAttributeAtPath("/root/left/seat.points").GetTimeSamples()) == 5


def test_an_implicit_shape_becomes_a_smooth_mesh_with_creases(tmp_path: Path) -> None:
    asset = IMPLICIT.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/root/box"))
    assert mesh.GetPrim().GetTypeName() == "Mesh"
    assert mesh.GetOrientationAttr().Get() == "rightHanded"
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetNormalsInterpolation() == "faceVarying"
    for frame in frames_of(asset, particles, info):
        a = motion(np.zeros(3), frame.index / info.settings.fps)[2]
        normals = np.array(mesh.GetNormalsAttr().Get(frame.time_code), np.float64)
        # the top of the box: its faces stay flat under the affine motion
        expected = np.array([0, 0, 1]) @ np.linalg.inv(a)
        expected /= np.linalg.norm(expected)
        np.testing.assert_allclose(normals[4:8], np.tile(expected, (4, 1)), atol=1e-6)


def test_changing_topology_is_pinned_to_the_surface(tmp_path: Path) -> None:
    body = ROOT_MESH.body.replace(
        "int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]",
        "int[] faceVertexCounts.timeSamples = { 0: [4, 4, 4, 4, 4, 4], 3: [3] }",
    )
    asset = Source(body, ROOT_MESH.head).asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    assert list(stage.GetAttributeAtPath("/blob.faceVertexCounts").Get(4)) == [4] * 6
