"""Captured Gaussians of a stage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from captures import ball, define
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from gf_usd.core.errors import InputError
from gf_usd.readers import read_asset

HALF = 1e-3  # two roundings of half precision, relative to 1
NAMES = ("positions", "orientations", "scales", "opacities", "harmonics")


@pytest.fixture
def stage(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "capture.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, "Y")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    return stage


def saved(stage):
    stage.Save()
    return read_asset(stage.GetRootLayer().realPath)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("half", [False, True])
def test_every_attribute_in_both_precisions(stage, half, degree):
    rest = ball(60, degree=degree)
    define(stage, "/World/Ball", rest, half=half)
    (found,) = saved(stage).splats
    assert (found.path, found.half, found.degree) == ("/World/Ball", half, degree)
    for name in NAMES:
        np.testing.assert_allclose(
            getattr(found, name), getattr(rest, name), atol=HALF if half else 1e-7, err_msg=name
        )


def test_float_is_preferred(stage):
    prim = define(stage, "/World/Ball", ball(60))
    wrong = Vt.Vec3hArray.FromNumpy(np.zeros((60, 3), np.float16))
    prim.CreateAttribute("positionsh", Sdf.ValueTypeNames.Point3hArray, False).Set(wrong)
    (found,) = saved(stage).splats
    np.testing.assert_array_equal(found.positions, ball(60).positions)


def test_they_stand_where_their_prim_stands(stage):
    rest = ball(60)
    define(stage, "/World/Ball", rest)
    matrix = Gf.Matrix4d().SetScale(3.0) * Gf.Matrix4d().SetTranslate(Gf.Vec3d(10, 20, 30))
    UsdGeom.Xformable(stage.GetPrimAtPath("/World")).AddTransformOp().Set(matrix)
    (found,) = saved(stage).splats
    np.testing.assert_array_equal(found.positions, rest.positions)
    np.testing.assert_allclose(found.points, 0.03 * rest.positions + [0.1, 0.2, 0.3], atol=1e-9)
    np.testing.assert_allclose(found.axes, 0.03 * rest.axes, atol=1e-9)


def test_what_is_missing_has_the_fallbacks_of_usdvol(stage):
    prim = define(stage, "/World/Ball", ball(60))
    for name in ("orientations", "scales", "opacities"):
        prim.RemoveProperty(name)
    prim.GetAttribute("radiance:sphericalHarmonicsDegree").Set(2)
    asset = saved(stage)
    (found,) = asset.splats
    np.testing.assert_array_equal(found.orientations, np.tile([1, 0, 0, 0], (60, 1)))
    np.testing.assert_array_equal(found.scales, 1.0)
    np.testing.assert_array_equal(found.opacities, 1.0)
    np.testing.assert_array_equal(found.harmonics, np.zeros((60, 1, 3)))
    assert any(
        "60 spherical harmonics coefficients are fewer than 9" in n for n in asset.facts.notes
    )


def test_arrays_that_are_too_short_are_ignored_and_too_long_ones_cut(stage):
    prim = define(stage, "/World/Ball", ball(60))
    prim.GetAttribute("opacities").Set(Vt.FloatArray([0.5] * 70))
    prim.GetAttribute("scales").Set(Vt.Vec3fArray([(2, 2, 2)] * 9))
    asset = saved(stage)
    (found,) = asset.splats
    np.testing.assert_array_equal(found.opacities, np.full(60, 0.5))
    np.testing.assert_array_equal(found.scales, 1.0)
    assert any("9 scales for 60 positions are ignored" in note for note in asset.facts.notes)


def test_broken_ones_are_refused(stage):
    """The cache lies over the prim: none of its Gaussians can be left out."""
    prim = define(stage, "/World/Ball", ball(60))
    points = np.array(ball(60).positions)
    points[7] = np.nan
    prim.GetAttribute("positions").Set(Vt.Vec3fArray.FromNumpy(points))
    with pytest.raises(InputError, match="</World/Ball>: 1 of its 60 Gaussians are not finite"):
        saved(stage)


def test_particles_of_a_bake_are_no_capture(stage):
    prim = define(stage, "/World/Ball", ball(60))
    prim.CreateAttribute("gaussianFlesh:restPositions", Sdf.ValueTypeNames.Point3fArray, False).Set(
        Vt.Vec3fArray.FromNumpy(ball(60).positions)
    )
    with pytest.raises(InputError, match="these Gaussians are the particles of a bake"):
        saved(stage)


def test_a_prim_without_positions_is_left_alone(stage):
    define(stage, "/World/Ball", ball(60))
    define(stage, "/World/Empty", ball(60)).RemoveProperty("positions")
    asset = saved(stage)
    assert [s.path for s in asset.splats] == ["/World/Ball"]
    assert ("/World/Empty", "has no positions") in asset.skipped


def test_halves_that_are_not_finite_are_refused(stage):
    rest = ball(60)
    positions = np.array(rest.positions)
    positions[3, 1] = np.inf
    define(stage, "/World/Ball", replace(rest, positions=positions), half=True)
    with pytest.raises(InputError, match="1 of its 60 Gaussians are not finite"):
        saved(stage)
