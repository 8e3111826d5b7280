"""The bodies with limbs, and the measure of what lies inside a body."""

from __future__ import annotations

import numpy as np
import pytest
from limbed import LIMBED, write_limbed
from pxr import Usd, UsdGeom
from solids import CUBE_POINTS, CUBE_TRIANGLES

from gf_usd.core.mesh import boundary_edges, signed_volume, weld
from tools.acceptance.limbs import shares_inside, triangles_at, which_inside


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
    inside, area = which_inside(points, triangles)
    assert inside.tolist() == [False] * 12 + [True] * 12
    np.testing.assert_allclose(area, np.repeat([0.5, 0.125], 12))
    assert not which_inside(CUBE_POINTS, CUBE_TRIANGLES)[0].any()


def test_what_is_inside_at_rest_is_told_apart_from_what_comes_there() -> None:
    """Of three cubes one lies in the large one at rest, one comes into it."""
    stage = Usd.Stage.CreateInMemory()
    within, beside = 0.2 + 0.25 * CUBE_POINTS, [2.0, 0.0, 0.0] + 0.25 * CUBE_POINTS
    for name, places in (
        ("Large", (CUBE_POINTS, CUBE_POINTS)),
        ("Shell", (within, within)),
        ("Comes", (beside, within + [0.0, 0.0, 0.4])),
    ):
        mesh = UsdGeom.Mesh.Define(stage, f"/{name}")
        for time, points in enumerate(places):
            mesh.GetPointsAttr().Set([tuple(map(float, p)) for p in points], float(time))
        mesh.GetFaceVertexCountsAttr().Set([3] * 12)
        mesh.GetFaceVertexIndicesAttr().Set(CUBE_TRIANGLES.ravel().tolist())
    small = 0.25**2 / (1.0 + 2.0 * 0.25**2)
    assert shares_inside(stage) == pytest.approx((small, small))


def test_a_frame_in_the_world_is_read_in_triangles() -> None:
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Square")
    mesh.AddTranslateOp().Set((0.0, 5.0, 0.0))
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], float)
    for time in (1.0, 2.0):
        mesh.GetPointsAttr().Set([tuple(time * p) for p in square], time)
    mesh.GetFaceVertexCountsAttr().Set([4, 3])
    mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2, 3, 1, 4, 2])
    UsdGeom.Mesh.Define(stage, "/Still")
    np.testing.assert_allclose(triangles_at(stage, 0)[0], square + [0.0, 5.0, 0.0])
    points, triangles = triangles_at(stage, -1)
    np.testing.assert_allclose(points, 2.0 * square + [0.0, 5.0, 0.0])
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
    mesh.GetOrientationAttr().Set(UsdGeom.Tokens.leftHanded)
    assert triangles_at(stage, -1)[1].tolist() == [[2, 1, 0], [3, 2, 0], [2, 4, 1]]
