"""Deliveries of instances, which a bake makes ordinary prims, and next to a PointInstancer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from small_sources import Source
from small_stages import CUBE, bake, world

from gf_usd.delivery.deliver import deliver
from gf_usd.layers.check.run import review

TOLERANCE = 0.02
LIBRARY = f"""
class "library"
{{
    def Xform "box"
    {{
        def Mesh "skin"
        {{{CUBE}        }}
    }}
    def Xform "pair"
    {{
        def "inner" (
            instanceable = true
            references = </library/box>
        )
        {{
        }}
    }}
}}
"""


def stage_of(target: str, more: str = "") -> Source:
    return Source(
        f"""{LIBRARY}
def Xform "World"
{{
    def "i" (
        instanceable = true
        references = </library/{target}>
    )
    {{
        double3 xformOp:translate = (0, 1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
{more}
}}
"""
    )


INSTANCER = f"""
    def PointInstancer "many"
    {{
        point3f[] positions = [(0, 0, 3), (1, 0, 3)]
        int[] protoIndices = [0, 0]
        rel prototypes = </World/many/one>
        def Xform "one"
        {{
            def Mesh "skin"
            {{{CUBE}            }}
        }}
    }}
"""


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
@pytest.mark.parametrize(
    ("target", "path"), [("box", "/World/i/skin"), ("pair", "/World/i/inner/skin")]
)
def test_a_delivered_instance_is_an_ordinary_prim_with_the_mesh(
    tmp_path: Path, target: str, path: str, suffix: str
) -> None:
    root, *_ = bake(stage_of(target).asset(tmp_path), tmp_path, looks=("rubber", "jelly"))
    done = deliver(root.path, tmp_path / f"out{suffix}", error=TOLERANCE)
    assert {body.meshes for body in done.bodies} == {(path,)}
    assert review(done.path, tmp_path / "duck.usda") == []
    for variant in ("rubber", "jelly", "none"):
        bakes, delivered = (Usd.Stage.Open(str(p)) for p in (root.path, done.path))
        for stage in (bakes, delivered):
            stage.GetPrimAtPath("/World").GetVariantSet("gaussianFlesh").SetVariantSelection(
                variant
            )
        prim = delivered.GetPrimAtPath(path)
        assert prim.IsInstanceProxy() == (variant == "none")
        if variant == "none":
            continue
        assert UsdSkel.BindingAPI(prim).GetSkeletonRel().GetTargets()
        flat = Usd.Stage.Open(delivered.Flatten())
        UsdSkel.BakeSkinning(flat.Traverse())
        for code in (1.0, 2.0, 3.0):
            ours, theirs = (world(stage, path, "points", code) for stage in (bakes, flat))
            reach = TOLERANCE * np.linalg.norm(np.ptp(ours, axis=0))
            assert np.abs(ours - theirs).max() <= reach


@pytest.mark.parametrize("suffix", [".glb", ".usdz"])
def test_a_prototype_in_an_instancer_is_no_mesh_of_its_own(tmp_path: Path, suffix: str) -> None:
    asset = stage_of("box", INSTANCER).asset(tmp_path)
    baked = tuple(one for one in asset.surfaces if one.path == "/World/i/skin")
    root, *_ = bake(replace(asset, surfaces=baked), tmp_path)
    done = deliver(root.path, tmp_path / f"out{suffix}", error=TOLERANCE)
    assert [body.meshes for body in done.bodies] == [("/World/i/skin",)]
    note = "not drawn: PointInstancer"
    assert any(line.endswith(note) for line in done.notes) == (suffix == ".glb")
    if suffix != ".glb":
        stage = Usd.Stage.Open(str(done.path))
        assert UsdGeom.PointInstancer.Get(stage, "/World/many").GetPositionsAttr().Get()


def test_a_mesh_below_a_prim_without_a_type_moves(tmp_path: Path) -> None:
    """UsdSkel passes over what is below it, so that the file showed the first frame only."""
    source = Source(f"""
def Xform "World"
{{
    def "props"
    {{
        def Mesh "skin"
        {{{CUBE}        }}
    }}
}}
""")
    root, *_ = bake(source.asset(tmp_path), tmp_path)
    done = deliver(root.path, tmp_path / "out.usdz", error=TOLERANCE)
    assert done.error <= TOLERANCE
    stage = Usd.Stage.Open(str(done.path))
    assert stage.GetPrimAtPath("/World/props").GetTypeName() == "Scope"


MESHES = {"/Shot/one/m", "/Shot/two/m"}


def test_a_shot_delivers_all_its_bakes_over_all_their_frames(tmp_path: Path) -> None:
    source = Source(f'def Xform "duck"\n{{\n def Mesh "m" {{{CUBE} }}\n}}\n')
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        bake(source.asset(tmp_path / name), tmp_path / name, frames=4)
    shot = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    UsdGeom.SetStageMetersPerUnit(shot, 1.0)
    for name, offset in (("one", 0.0), ("two", 3.0)):
        duck = shot.DefinePrim(f"/Shot/{name}", "Xform")
        offset = Sdf.LayerOffset(offset)
        duck.GetReferences().AddReference(f"./{name}/duck.rubber.usda", "/duck", offset)
    UsdGeom.Xform.Define(shot, "/Shot")
    shot.SetDefaultPrim(shot.GetPrimAtPath("/Shot"))
    shot.Save()
    for suffix in ("usda", "glb"):
        done = deliver(tmp_path / "shot.usda", tmp_path / f"all.{suffix}", error=TOLERANCE)
        assert {mesh for body in done.bodies for mesh in body.meshes} == MESHES
        assert done.frames == 7
    delivered = Usd.Stage.Open(str(tmp_path / "all.usda"))
    for path in MESHES:
        mesh = delivered.GetPrimAtPath(path)
        assert mesh.HasAPI(UsdSkel.BindingAPI)
        assert mesh.GetAttribute("points").GetNumTimeSamples() == 0
