"""The can and the star of the pictures: closed, outward, and of the size that they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom, UsdPhysics

from tools.samples import crumple


def body(points: np.ndarray, counts: np.ndarray, indices: np.ndarray) -> trimesh.Trimesh:
    faces, at = [], 0
    for n in counts:
        ring = indices[at : at + n]
        faces += [[ring[0], ring[k], ring[k + 1]] for k in range(1, n - 1)]
        at += n
    return trimesh.Trimesh(points, faces, process=False)


def test_the_star_is_a_closed_slab() -> None:
    made = body(*crumple.star())
    kites = crumple.POINTS * crumple.REACH * crumple.WAIST * np.sin(np.pi / crumple.POINTS)
    assert made.is_watertight
    assert made.volume == pytest.approx(kites * crumple.FOIL)


def test_the_can_is_a_closed_wall_with_a_floor_and_ribs() -> None:
    made = body(*crumple.can())
    assert made.is_watertight
    R, t, d = crumple.RADIUS, crumple.WALL, crumple.RIB
    high = crumple.HEIGHT - t
    # Of a ring at r to r - t the area is pi t (2 r - t); the mean of the ribs is half their depth.
    exact = np.pi * (R * R * t + t * high * (2.0 * (R - 0.5 * d) - t))
    chords = (2.0 * np.pi / crumple.AROUND) ** 2 / 6.0  # less area of a polygon
    # The sides of the wall are drawn through points at equal heights: half an edge at either end.
    assert made.volume == pytest.approx(exact * (1.0 - chords), rel=5e-3)
    assert made.bounds[:, 1] == pytest.approx([0.0, crumple.HEIGHT])


def test_the_press_comes_down_and_goes_up_again(tmp_path: Path) -> None:
    crumple.write_can(tmp_path / "can.usda")
    stage = Usd.Stage.Open(str(tmp_path / "can.usda"))
    press = stage.GetPrimAtPath("/Can/Press")
    assert UsdPhysics.RigidBodyAPI(press).GetKinematicEnabledAttr().Get()
    times = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1)
    y = [UsdGeom.Xformable(press).GetLocalTransformation(t).ExtractTranslation()[1] for t in times]
    under = np.array(y) - 0.5 * crumple.PLATE
    assert under.min() == pytest.approx(crumple.LEFT)
    assert under[[0, -1]] == pytest.approx(crumple.HEIGHT + 0.05)


def test_the_star_falls_on_a_ball(tmp_path: Path) -> None:
    crumple.write_star(tmp_path / "star.usda")
    stage = Usd.Stage.Open(str(tmp_path / "star.usda"))
    ball = stage.GetPrimAtPath("/Star/Ball")
    assert ball.HasAPI(UsdPhysics.CollisionAPI)
    boxes = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_])
    under, over = (
        boxes.ComputeWorldBound(prim).ComputeAlignedRange()
        for prim in (ball, stage.GetPrimAtPath("/Star/Body"))
    )
    assert under.GetMin()[1] == pytest.approx(0.0, abs=1e-6)
    assert over.GetMin()[1] > under.GetMax()[1]
    for axis in (0, 2):
        assert over.GetMin()[axis] < under.GetMin()[axis]
        assert over.GetMax()[axis] > under.GetMax()[axis]
