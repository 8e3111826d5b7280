"""Which bake shows, and which of its shapes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom
from small_sources import IMPLICIT, INSTANCES, PLAIN, ROOT_MESH, SEVERAL_ROOTS
from small_stages import bake, info_of, open_with

from gf_usd.core.errors import UsageError
from gf_usd.layers.root import write_root
from gf_usd.layers.variants import BakedVariant
from gf_usd.system.atomic_files import partial_path


@pytest.mark.parametrize(
    ("display", "shown"),
    [("mesh", {"body"}), ("gaussians", {"Gaussians"}), ("points", {"Points"})],
)
def test_each_display_shows_one_shape(display: str, shown: set[str], tmp_path: Path) -> None:
    root, _, _ = bake(PLAIN.asset(tmp_path), tmp_path)
    stage = open_with(root.path, "rubber")
    switch = stage.GetPrimAtPath("/duck").GetVariantSet("display")
    assert switch.GetVariantSelection() == "mesh"
    switch.SetVariantSelection(display)
    gprims = [UsdGeom.Gprim(p) for p in stage.Traverse() if p.IsA(UsdGeom.Gprim)]
    visible = {g.GetPrim().GetName() for g in gprims if g.ComputeVisibility() == "inherited"}
    assert visible == shown


def test_materials_are_variants_of_one_root_layer(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path, looks=("rubber", "jelly"))
    stage = open_with(root.path, "jelly")
    switch = stage.GetPrimAtPath("/duck").GetVariantSet("gaussianFlesh")
    assert sorted(switch.GetVariantNames()) == ["jelly", "none", "rubber"]
    material = stage.GetPrimAtPath("/duck/GaussianFlesh/Materials").GetChildren()[0]
    assert material.GetAttribute("gaussianFlesh:look").Get() == "jelly"
    fresh = Usd.Stage.Open(str(root.path))
    selected = fresh.GetPrimAtPath("/duck").GetVariantSet("gaussianFlesh")
    assert selected.GetVariantSelection() == "rubber"


def test_a_root_prim_that_is_a_mesh_has_its_particles_next_to_it(tmp_path: Path) -> None:
    root, _, _ = bake(ROOT_MESH.asset(tmp_path), tmp_path)
    assert root.switches == ("/blob", "/blob_GaussianFlesh")
    stage = Usd.Stage.Open(str(root.path))
    assert stage.GetDefaultPrim().GetPath() == "/blob"
    splats = stage.GetPrimAtPath("/blob_GaussianFlesh/Gaussians")
    meshes = splats.GetRelationship("gaussianFlesh:sourceMeshes").GetTargets()
    assert meshes == [Sdf.Path("/blob")]
    without = open_with(root.path, "none")
    assert [p.GetName() for p in without.Traverse()] == ["blob"]


def test_several_root_prims_are_switched_one_by_one(tmp_path: Path) -> None:
    root, _, _ = bake(SEVERAL_ROOTS.asset(tmp_path), tmp_path)
    assert root.switches == ("/one", "/two")
    assert root.default_prim == "one"
    stage = Usd.Stage.Open(str(root.path))
    splats = stage.GetPrimAtPath("/one/GaussianFlesh/Gaussians")
    meshes = splats.GetRelationship("gaussianFlesh:sourceMeshes").GetTargets()
    assert meshes == [Sdf.Path("/one/m"), Sdf.Path("/two/m")]
    stage.GetPrimAtPath("/two").GetVariantSet("gaussianFlesh").SetVariantSelection("none")
    assert stage.GetAttributeAtPath("/two/m.points").GetNumTimeSamples() == 0
    assert stage.GetAttributeAtPath("/one/m.points").GetNumTimeSamples() == 5


def test_names_that_the_asset_uses_are_left_to_it(tmp_path: Path) -> None:
    root, _, _ = bake(IMPLICIT.asset(tmp_path), tmp_path)
    assert root.display_set == "gaussianFleshDisplay"
    assert root.notes == (
        "the asset already has a variant set 'display': that of gf-usd is named"
        " 'gaussianFleshDisplay'",
    )
    stage = Usd.Stage.Open(str(root.path))
    prim = stage.GetPrimAtPath("/root")
    assert prim.GetVariantSet("display").GetVariantSelection() == "big"
    assert sorted(prim.GetVariantSet("display").GetVariantNames()) == ["big", "small"]
    assert stage.GetPrimAtPath("/root/GaussianFlesh_2/Gaussians")
    assert not stage.GetPrimAtPath("/root/GaussianFlesh").GetChildren()


def test_instancing_outside_the_bake_is_kept(tmp_path: Path) -> None:
    body = INSTANCES.body.replace("rel material:binding = </_materials/red>", "")
    asset = replace(INSTANCES, body=body).asset(tmp_path)
    root, _, _ = bake(replace(asset, surfaces=asset.surfaces[:1]), tmp_path)
    assert root.notes == ()
    stage = Usd.Stage.Open(str(root.path))
    assert not stage.GetPrimAtPath("/root/left").IsInstance()
    assert stage.GetPrimAtPath("/root/right").IsInstance()
    assert open_with(root.path, "none").GetPrimAtPath("/root/left").IsInstance()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), "there is no bake for which a root layer could be written"),
        (("my rubber",), "'my rubber' cannot be the name of a variant"),
        (("none",), "the variant name 'none' is taken"),
        (("a", "b", "a"), "the variant name 'a' is taken"),
    ],
)
def test_variant_names_that_do_not_do(names: tuple[str, ...], message: str, tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    info = info_of(asset)
    looks = [BakedVariant(name=n, cache=tmp_path / "c.usdc", info=info) for n in names]
    path = tmp_path / "root.usda"
    with pytest.raises(UsageError) as caught:
        write_root(path, asset, looks)
    assert caught.value.message == message
    assert not path.exists()
    assert not partial_path(path).exists()


def test_a_display_that_is_not_there(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    look = BakedVariant(name="a", cache=tmp_path / "c.usdc", info=info_of(asset))
    with pytest.raises(UsageError) as caught:
        write_root(tmp_path / "root.usda", asset, [look], display="voxels")
    assert str(caught.value) == (
        "unknown display 'voxels'\n\nhint: choose one of: mesh, gaussians, points"
    )
