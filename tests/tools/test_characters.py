"""What the acceptance of characters requires of a baked stage."""

from __future__ import annotations

from pathlib import Path

from arm import FIRST, LAST, arm, write
from pxr import Sdf, Usd, UsdGeom

from tools.acceptance.characters import skinned


def test_a_mesh_that_moves_and_is_bound_is_skinned_twice(tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(write(tmp_path, arm())))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Arm/Skin"))
    assert skinned(stage) == []  # it does not move by itself
    for code in (FIRST, LAST):
        mesh.GetPointsAttr().Set(mesh.GetPointsAttr().Get(), code)
    assert skinned(stage) == ["/Arm/Skin"]
    for name in ("jointIndices", "jointWeights"):
        prim = mesh.GetPrim()
        prim.CreateAttribute(f"primvars:skel:{name}", Sdf.ValueTypeNames.IntArray).Block()
    assert skinned(stage) == []
