"""Which body carries a mesh that is not filled."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd, UsdGeom, Vt
from solids import sphere, surface

import gf_usd


def stage(path, *meshes) -> str:
    made = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(made, 1.0)
    made.SetDefaultPrim(UsdGeom.Xform.Define(made, "/Root").GetPrim())
    for one in meshes:
        mesh = UsdGeom.Mesh.Define(made, f"/Root{one.path}")
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(one.points.astype(np.float32)))
        mesh.CreateFaceVertexIndicesAttr(one.triangles.ravel().tolist())
        mesh.CreateFaceVertexCountsAttr([3] * len(one.triangles))
        mesh.CreateSubdivisionSchemeAttr("none")
    made.Save()
    return str(path)


def moved(body, at, path, keep=None):
    triangles = body.triangles
    if keep is not None:
        triangles = triangles[keep(body.points[triangles].mean(1))]
    return surface(body.points + at, triangles, path=path)


@pytest.mark.parametrize(("gap", "carrier"), [(0.0, "/Root/Torso"), (0.5, "/Root/Tooth")])
def test_an_open_head_moves_with_the_body_it_touches_and_not_with_a_tooth(
    tmp_path, gap: float, carrier: str
) -> None:
    torso = moved(sphere(1.0), [0.0, 0.0, 0.0], "/Torso")
    # Open towards the torso by more than a quarter of its closed area
    head = moved(sphere(0.4), [1.25 + gap, 0.0, 0.0], "/Head", keep=lambda at: at[:, 0] > -0.1)
    tooth = moved(sphere(0.2), [1.45 + gap, 0.0, 0.0], "/Tooth")
    seen = gf_usd.inspect(stage(tmp_path / "a.usda", torso, head, tooth), particles=4000)
    assert seen.plan is not None
    bodies = seen.plan.bodies
    assert bodies is not None
    (names,) = (group for group in bodies.surfaces if carrier in group)
    assert bodies.surfaces[bodies.embedded["/Root/Head"]] == names
