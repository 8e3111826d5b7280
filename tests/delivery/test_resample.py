"""Samples between those of a bake: boxes of balls, and points whose number changes."""

from __future__ import annotations

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from gf_usd.delivery.resample import Warp, resample


def vectors(rows: list[tuple[float, float, float]]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.array(rows, np.float32))


def half_speed(stage: Usd.Stage) -> Usd.Stage:
    """The stage at time codes 0, 1 and 2 where it has 0 and 1."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    resample(stage, layer, Warp(((0.0, 0.0), (2.0, 1.0))), [0.0, 1.0, 2.0])
    return Usd.Stage.Open(layer)


def test_a_box_of_balls_holds_them_where_one_flies_out_of_it() -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(1.0)
    points = UsdGeom.Points.Define(stage, "/Points")
    # The large ball flies from .5 to 1.5 and back, past the small one at 1; two make the box wide.
    place = [(1.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 100.0, 0.0), (0.0, -100.0, 0.0)]
    radii = np.array([0.01, 1.0, 0.01, 0.01], np.float32)
    points.CreateWidthsAttr(Vt.FloatArray.FromNumpy(2.0 * radii))
    for time, speed in ((0.0, 4.0), (1.0, -4.0)):
        points.CreatePointsAttr().Set(vectors(place), time)
        still = (0.0, 0.0, 0.0)
        points.CreateVelocitiesAttr().Set(vectors([still, (speed, 0.0, 0.0), still, still]), time)
        box = vectors([(-0.5, -100.01, -1.0), (1.5, 100.01, 1.0)])
        points.CreateExtentAttr().Set(box, time)
    slow = half_speed(stage)
    prim = UsdGeom.Points(slow.GetPrimAtPath("/Points"))
    between = np.array(prim.GetPointsAttr().Get(1.0))
    assert between[1, 0] == 1.5
    low, high = np.array(prim.GetExtentAttr().Get(1.0))
    assert (high >= (between + radii[:, None]).max(0)).all()
    assert (low <= (between - radii[:, None]).min(0)).all()


def test_points_whose_number_changes_continue_along_their_velocities() -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(2.0)
    mesh = UsdGeom.Mesh.Define(stage, "/Surface")
    for time, count in ((0.0, 3), (1.0, 4)):
        mesh.CreatePointsAttr().Set(vectors([(float(k), time, 0.0) for k in range(count)]), time)
        mesh.CreateVelocitiesAttr().Set(vectors([(0.0, 2.0, 0.0)] * count), time)
        mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray([count]), time)
        mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray(range(count)), time)
        mesh.CreateExtentAttr().Set(vectors([(0.0, time, 0.0), (count - 1.0, time, 0.0)]), time)
    slow = half_speed(stage)
    found = UsdGeom.Mesh(slow.GetPrimAtPath("/Surface"))
    # half a time code is a quarter of a second
    between = np.array(found.GetPointsAttr().Get(1.0))
    np.testing.assert_allclose(between, [(k, 0.5, 0.0) for k in range(3)], atol=1e-6)
    np.testing.assert_allclose(found.GetVelocitiesAttr().Get(1.0), [(0.0, 1.0, 0.0)] * 3)
    assert list(found.GetFaceVertexIndicesAttr().Get(1.0)) == [0, 1, 2]
    low, high = np.array(found.GetExtentAttr().Get(1.0))
    assert (low <= between.min(0)).all()
    assert (high >= between.max(0)).all()
    assert len(found.GetPointsAttr().Get(2.0)) == 4
