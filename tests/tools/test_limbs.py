"""The bodies with limbs, and the measure of what lies inside a body."""

from __future__ import annotations

import numpy as np
import pytest
from limbed import LIMBED, write_limbed
from pxr import Usd, UsdGeom
from solids import CUBE_POINTS, CUBE_TRIANGLES

from gf_usd.core.mesh import boundary_edges, signed_volume, weld
from tools.acceptance.limbs import moved, share_inside


@pytest.mark.parametrize("name", LIMBED)
def test_what_is_made_is_watertight_and_right_side_out(name) -> None:
    for points, triangles in LIMBED[name]():
        assert len(boundary_edges(weld(points)[0][triangles])) == 0
        assert signed_volume(points, triangles) > 0.0
        assert points[:, 1].min() > -0.1


def test_a_written_one_is_a_stage_in_meters(tmp_path) -> None:
    stage = Usd.Stage.Open(str(write_limbed("rings", tmp_path / "rings.usda")))
    meshes = [p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    assert len(meshes) == 5
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0


def test_of_a_cube_in_a_cube_all_of_the_inner_one_is_inside() -> None:
    inner = 0.25 + 0.5 * CUBE_POINTS
    points = np.concatenate([CUBE_POINTS, inner])
    triangles = np.concatenate([CUBE_TRIANGLES, CUBE_TRIANGLES + 8])
    assert share_inside(points, triangles) == pytest.approx(0.25 / 1.25)
    assert share_inside(CUBE_POINTS, CUBE_TRIANGLES) == 0.0


def test_the_last_frame_in_the_world_is_read_in_triangles() -> None:
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Square")
    mesh.AddTranslateOp().Set((0.0, 5.0, 0.0))
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], float)
    for time in (1.0, 2.0):
        mesh.GetPointsAttr().Set([tuple(time * p) for p in square], time)
    mesh.GetFaceVertexCountsAttr().Set([4, 3])
    mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2, 3, 1, 4, 2])
    UsdGeom.Mesh.Define(stage, "/Still")
    points, triangles = moved(stage)
    np.testing.assert_allclose(points, 2.0 * square + [0.0, 5.0, 0.0])
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
    mesh.GetOrientationAttr().Set(UsdGeom.Tokens.leftHanded)
    assert moved(stage)[1].tolist() == [[2, 1, 0], [3, 2, 0], [2, 4, 1]]
