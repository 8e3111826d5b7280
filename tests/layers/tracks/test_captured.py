"""Captured Gaussians in the cache: what has samples, what stays the source's, in which space."""

from __future__ import annotations

import numpy as np
import pytest
from captures import ball, define
from pxr import Gf, Usd, UsdGeom
from scipy.spatial.transform import Rotation

from gf_usd.core.asset import SplatPose
from gf_usd.core.errors import BakeError
from gf_usd.geometry.splat_hull import hull
from gf_usd.layers.stage import Clock
from gf_usd.layers.tracks.captured import SplatTrack

COEFFICIENTS = "radiance:sphericalHarmonicsCoefficients"
CLOCK = Clock(rate=24.0, source_rate=24.0, start=1.0, end=3.0, step=1.0)


def make(tmp_path, rest, *, half=False, matrix=None):
    """A source with the capture, a cache over it, and the track."""
    source = Usd.Stage.CreateNew(str(tmp_path / "source.usda"))
    UsdGeom.SetStageMetersPerUnit(source, 0.01)
    root = UsdGeom.Xform.Define(source, "/World")
    if matrix is not None:
        root.AddTransformOp().Set(matrix)
    prim = define(source, "/World/Ball", rest, half=half)
    source.Save()
    cache = Usd.Stage.CreateNew(str(tmp_path / "cache.usda"))
    cache.GetRootLayer().subLayerPaths = ["./source.usda"]
    surface, _ = hull(rest, up=1)
    surface = type(surface)(**{**vars(surface), "path": "/World/Ball"})
    return cache, SplatTrack(cache, prim, surface, CLOCK, 0.01)


def pose(rest, **more):
    return SplatPose(
        positions=0.01 * rest.positions,
        orientations=rest.orientations,
        scales=rest.scales,
        **more,
    )


@pytest.mark.parametrize("half", [False, True])
def test_what_moves_has_samples_and_the_rest_stays(tmp_path, half):
    rest = ball(60, degree=1)
    cache, track = make(tmp_path, rest, half=half)
    for time in (1.0, 2.0):
        track.write(pose(rest, harmonics=rest.harmonics * time), time)
    prim = cache.GetPrimAtPath("/World/Ball")
    for name in ("positions", "orientations", "scales", "extent", f"{COEFFICIENTS}h"):
        assert prim.GetAttribute(name).GetTimeSamples() == [1.0, 2.0], name
    # what would be preferred, or would be another word for the same, does not speak
    for name in (COEFFICIENTS, "positionsh", "orientationsh", "scalesh"):
        assert prim.GetAttribute(name).Get(1.0) is None, name
    over = cache.GetRootLayer().GetPrimAtPath("/World/Ball")
    for name in ("opacities", "opacitiesh", "radiance:sphericalHarmonicsDegree"):
        assert name not in over.properties
    shown = np.asarray(prim.GetAttribute(f"{COEFFICIENTS}h").Get(2.0), np.float64)
    expected = 2.0 * rest.harmonics.reshape(-1, 3)
    np.testing.assert_allclose(shown, expected, rtol=1e-3, atol=1e-6)  # half precision
    np.testing.assert_allclose(prim.GetAttribute("positions").Get(1.0), rest.positions, atol=1e-6)


def test_degree_0_writes_no_coefficients(tmp_path):
    rest = ball(60)
    cache, track = make(tmp_path, rest)
    track.write(pose(rest), 1.0)
    prim = cache.GetPrimAtPath("/World/Ball")
    assert prim.GetAttribute(COEFFICIENTS).GetNumTimeSamples() == 0
    assert len(prim.GetAttribute(COEFFICIENTS).Get(1.0)) == 60


def test_positions_go_into_the_space_of_the_prim(tmp_path):
    turn = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()
    matrix = np.eye(4)
    matrix[:3, :3] = 2.0 * turn
    matrix[3, :3] = [10, 20, 30]
    rest = ball(60)
    cache, track = make(tmp_path, rest, matrix=Gf.Matrix4d(matrix))
    world = 0.01 * (rest.positions @ matrix[:3, :3] + matrix[3, :3])
    track.write(SplatPose(positions=world, orientations=rest.orientations, scales=rest.scales), 1.0)
    found = cache.GetPrimAtPath("/World/Ball").GetAttribute("positions").Get(1.0)
    np.testing.assert_allclose(found, rest.positions, atol=1e-6)


def test_the_extent_holds_three_standard_deviations(tmp_path):
    rest = ball(60)
    cache, track = make(tmp_path, rest)
    track.write(pose(rest), 1.0)
    low, high = np.asarray(cache.GetPrimAtPath("/World/Ball").GetAttribute("extent").Get(1.0))
    reach = 3.0 * np.linalg.norm(rest.axes, axis=2)
    np.testing.assert_allclose(low, (rest.positions - reach).min(axis=0), atol=1e-6)
    np.testing.assert_allclose(high, (rest.positions + reach).max(axis=0), atol=1e-6)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: {"positions": p.positions[:-1]}, "have shape"),
        (lambda p: {"scales": np.full_like(p.scales, np.nan)}, "not finite"),
    ],
)
def test_a_faulty_pose_is_refused(tmp_path, spoil, message):
    rest = ball(60)
    _, track = make(tmp_path, rest)
    good = pose(rest)
    with pytest.raises(BakeError, match=message):
        track.write(type(good)(**{**vars(good), **spoil(good)}), 1.0)
