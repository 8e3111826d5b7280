"""A delivered body next to obstacles, which stay separate prims."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import pytest
from delivered import world_points
from pxr import Usd, UsdGeom, UsdSkel

import gf_usd
from gf_usd.delivery.deliver import deliver

TOLERANCE = 0.12  # few joints: what is tested here is where they are

# A soft box between a crate that stands still and a plate that moves, so close that the bounds of
# all meet, on a ground that is larger than all of them; under one prim.
PROPS = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
    timeCodesPerSecond = 24
)
def Xform "World" (kind = "assembly")
{
    def Xform "props"
    {
        def Xform "soft"
        {
            double3 xformOp:translate = (0, 0.6, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
            def Cube "body"
            {
                double size = 1
            }
        }
        def Cube "crate" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            double size = 1
            double3 xformOp:translate = (1.01, 0.5, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
        def Cube "plate" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            double size = 1
            double3 xformOp:translate.timeSamples = { 1: (-1.01, 0.5, 0), 6: (-1.01, 2.5, 0) }
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
        def Cube "ground" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            double size = 8
            double3 xformOp:translate = (0, -4, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
    }
}
"""
# Next to the soft box below the same prim, without an authored extent.
FLAG = """def Mesh "flag" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            int[] faceVertexCounts = [3]
            int[] faceVertexIndices = [0, 1, 2]
            point3f[] points.timeSamples = {
                1: [(1, 0, 5), (2, 0, 5), (1, 1, 5)], 6: [(1, 0, 5), (1, 4, 5), (1, 1, 5)],
            }
        }
            def Cube "body" """
# Likewise: a static post with a child that rises, and a lamp that appears.
POST = """def Cube "post" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            double size = 0.2
            double3 xformOp:translate = (0, 0, 9)
            uniform token[] xformOpOrder = ["xformOp:translate"]
            def Cube "knob" (prepend apiSchemas = ["PhysicsCollisionAPI"])
            {
                double size = 0.2
                double3 xformOp:translate.timeSamples = { 1: (0, 1, 0), 6: (0, 6, 0) }
                uniform token[] xformOpOrder = ["xformOp:translate"]
            }
        }
        def Cube "lamp" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            double size = 0.2
            double3 xformOp:translate = (0, 0, -7)
            uniform token[] xformOpOrder = ["xformOp:translate"]
            token visibility.timeSamples = { 1: "invisible", 4: "inherited" }
        }
            def Cube "body" """
PLACES = {"crate": (1.01, 0.5, 0.0), "plate": (-1.01, 0.5, 0.0), "ground": (0.0, -4.0, 0.0)}


@pytest.fixture(scope="module")
def props(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The baked stage."""
    asset = tmp_path_factory.mktemp("props") / "props.usda"
    asset.write_text(PROPS, encoding="utf-8")
    return bake(asset, 100)


def bake(asset: Path, particles: int) -> Path:
    done = gf_usd.bake(
        asset, particles=particles, frames=6, material="jelly", output=asset.with_name("baked.usda")
    )
    return Path(done.root)


def tree_of(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_gltf_has_obstacles_as_nodes_of_their_own(props: Path, tmp_path: Path, kind: str) -> None:
    done = deliver(props, tmp_path / "out.glb", error=TOLERANCE, kind=kind)
    bodies = {tuple(path.rpartition("/")[2] for path in one.meshes): one for one in done.bodies}
    assert set(bodies) == {("body",), ("crate",), ("plate",), ("ground",)}
    assert {name for (name,), one in bodies.items() if one.joints or one.shapes} == {"body"}
    assert {name for (name,), one in bodies.items() if one.moves} == {"body", "plate"}
    tree = tree_of(done.path)
    nodes = {node["name"]: node for node in tree["nodes"] if "mesh" in node}
    moved = {channel["target"]["node"] for channel in tree["animations"][0]["channels"]}
    for name in ("crate", "ground"):
        assert "skin" not in nodes[name]
        number = tree["nodes"].index(nodes[name])
        assert number in tree["nodes"][0]["children"], "no joint is above it"
        assert number not in moved
        (primitive,) = tree["meshes"][nodes[name]["mesh"]]["primitives"]
        assert "targets" not in primitive
        where = tree["accessors"][primitive["attributes"]["POSITION"]]
        middle = [0.5 * (low + high) for low, high in zip(where["min"], where["max"])]
        assert middle == pytest.approx(PLACES[name], abs=1e-6)
    assert "skin" not in nodes["plate"]


@pytest.mark.slow
def test_usd_changes_the_prim_of_the_soft_body_alone(props: Path, tmp_path: Path) -> None:
    done = deliver(props, tmp_path / "out.usda", error=TOLERANCE)
    (body,) = done.bodies
    assert body.meshes == ("/World/props/soft/body",)
    stage, source = Usd.Stage.Open(str(done.path)), Usd.Stage.Open(str(props))
    types = {str(prim.GetPath()): prim.GetTypeName() for prim in stage.Traverse()}
    assert types["/World"] == types["/World/props"] == "Xform"
    assert types["/World/props/soft"] == "SkelRoot"
    assert types["/World/props/soft/Skeleton"] == "Skeleton"
    for name in PLACES:
        prim = stage.GetPrimAtPath(f"/World/props/{name}")
        assert prim.GetTypeName() == "Cube"
        assert not prim.HasAPI(UsdSkel.BindingAPI)
        assert prim.GetPropertyNames() == source.GetPrimAtPath(prim.GetPath()).GetPropertyNames()
    assert set(world_points(done.path)) == {"/World/props/soft/body"}


def bound(stage: Usd.Stage, path: str, code: float) -> list[float]:
    cache = UsdGeom.BBoxCache(Usd.TimeCode(code), [UsdGeom.Tokens.default_])
    box = cache.ComputeWorldBound(stage.GetPrimAtPath(path)).ComputeAlignedRange()
    return [*box.GetMin(), *box.GetMax()]


@pytest.mark.slow
def test_the_bounds_above_a_body_contain_all_below_it(tmp_path: Path) -> None:
    asset = tmp_path / "flag.usda"
    asset.write_text(PROPS.replace('def Cube "body"', FLAG), encoding="utf-8")
    baked = bake(asset, 100)
    done = deliver(baked, tmp_path / "out.usda", error=TOLERANCE)
    stage, source = Usd.Stage.Open(str(done.path)), Usd.Stage.Open(str(baked))
    for code in (1.0, 4.0, 6.0):
        assert bound(stage, "/World", code) == pytest.approx(bound(source, "/World", code), abs=0.1)


@pytest.mark.slow
def test_the_bounds_follow_what_moves_below_what_does_not(tmp_path: Path) -> None:
    asset = tmp_path / "post.usda"
    asset.write_text(PROPS.replace('def Cube "body"', POST), encoding="utf-8")
    done = deliver(bake(asset, 100), tmp_path / "out.usda", error=TOLERANCE)
    stage = Usd.Stage.Open(str(done.path))
    extent = stage.GetPrimAtPath("/World/props/soft").GetAttribute("extent")
    for code, knob in ((1.0, 1.0), (4.0, 4.0), (6.0, 6.0)):
        low, high = extent.Get(code)
        assert high[1] == pytest.approx(knob + 0.1, abs=1e-5)
        assert (low[2], high[2]) == pytest.approx((-7.1, 9.1), abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("apart", [pytest.param(True, marks=pytest.mark.slow), False])
def test_bodies_have_skel_roots_of_their_own_that_do_not_nest(tmp_path: Path, apart: bool) -> None:
    asset = tmp_path / "two.usda"
    start, end = PROPS.index('        def Xform "soft"'), PROPS.index('        def Cube "crate"')
    second = PROPS[start:end]
    second = second.replace('"soft"', '"other"').replace("(0, 0.6, 0)", "(2.2, 0.6, 0)")
    if not apart:  # directly below the prim of all
        second = second.replace('def Xform "other"', 'def Cube "other"')
        second = re.sub(r"def Cube .body.\s*{[^}]*}", "", second)
    asset.write_text(PROPS[:start] + second + PROPS[start:])
    root = bake(asset, 200)
    done = deliver(root, tmp_path / "out.usda", error=TOLERANCE)
    stage, source = Usd.Stage.Open(str(done.path)), Usd.Stage.Open(str(root))
    roots = [str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]
    both = ["/World/props/other", "/World/props/soft"]
    assert roots == (both if apart else ["/World/props"])
    for code in (1.0, 6.0):
        assert bound(stage, "/World", code) == pytest.approx(bound(source, "/World", code), abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale", "home"), [("(2, 2, -2)", "/World/props/soft"), ("(2, 2, 1)", "/World/props")]
)
def test_a_skeleton_never_has_to_undo_unequal_scales(tmp_path: Path, scale: str, home: str) -> None:
    """The inverse of turned unequal scales has a shear, which Blender drops."""
    asset = tmp_path / "scaled.usda"
    scaled = f"""double3 xformOp:translate = (0, 3, 0)
            float3 xformOp:rotateXYZ = (0, 40, 20)
            float3 xformOp:scale = {scale}
            uniform token[] xformOpOrder = [
                "xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale",
            ]
            def Cube "body\""""
    own = re.compile(r'double3 xformOp:translate = \(0, 0.6, 0\)\s*uniform[^\n]*\s*def Cube "body"')
    text, count = own.subn(scaled, PROPS)
    assert count == 1
    asset.write_text(text, encoding="utf-8")
    done = deliver(bake(asset, 100), tmp_path / "out.usda", error=TOLERANCE)
    stage = Usd.Stage.Open(str(done.path))
    assert [str(p.GetPath()) for p in stage.Traverse() if p.IsA(UsdSkel.Root)] == [home]
