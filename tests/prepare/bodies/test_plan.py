"""Which body carries a mesh that is not filled."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd, UsdGeom, Vt
from solids import cube, sphere, surface

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


def cylinder(r: float, height: float, sides: int = 24, caps: bool = True):
    """Around y, from its middle; without caps it is an open tube."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([r * np.sin(turn), 0.0 * turn, r * np.cos(turn)], 1)
    up = np.array([0.0, 0.5 * height, 0.0])
    points = np.concatenate([ring - up, ring + up, [-up, up]])
    i = np.arange(sides)
    j = (i + 1) % sides
    low, high = 2 * sides, 2 * sides + 1
    wall = [np.stack([i, j, j + sides], 1), np.stack([i, j + sides, i + sides], 1)]
    ends = [np.stack([j, i, 0 * i + low], 1), np.stack([i + sides, j + sides, 0 * i + high], 1)]
    triangles = np.concatenate([*wall, *(ends if caps else ())])
    return surface(points if caps else points[:low], triangles)


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


def test_a_label_moves_with_the_can_that_it_is_around_and_not_with_the_table(tmp_path) -> None:
    can = moved(cylinder(0.3, 0.6), [0.0, 0.68, 0.0], "/Can")
    label = moved(cylinder(0.31, 0.6, caps=False), [0.0, 0.68, 0.0], "/Label")
    table = cube(low=(-0.8, 0.0, -0.8), edge=(1.6, 0.3, 1.6), path="/Table")
    seen = gf_usd.inspect(stage(tmp_path / "a.usda", can, label, table), particles=2000)
    assert seen.plan is not None
    bodies = seen.plan.bodies
    assert bodies is not None
    assert "/Root/Can" in bodies.surfaces[bodies.embedded["/Root/Label"]]
