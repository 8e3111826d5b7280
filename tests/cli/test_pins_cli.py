"""Pins and floors through the command line: what is held follows the source, the rest moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

import gf_usd

ARM = """#usda 1.0
( metersPerUnit = 0.01
  upAxis = "Z"
  defaultPrim = "Arm"
  startTimeCode = 1
  endTimeCode = 13
  timeCodesPerSecond = 24 )
def Xform "Arm" {
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 50), 13: (20, 0, 50) }
    float xformOp:rotateY.timeSamples = { 1: 0, 13: 20 }
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]
    def Mesh "Bar" {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0,2,3,1, 4,5,7,6, 0,1,5,4, 2,6,7,3, 0,4,6,2, 1,3,7,5]
        point3f[] points = [
            (0,0,0), (80,0,0), (0,20,0), (80,20,0), (0,0,20), (80,0,20), (0,20,20), (80,20,20)
        ]
        def GeomSubset "end" {
            uniform token elementType = "face"
            int[] indices = [4]
        }
    }
}
"""
HELD, LOOSE = [0, 2, 4, 6], [1, 3, 5, 7]


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.usda"
    path.write_text(ARM)
    return path


def world(path: Path, time: float) -> np.ndarray:
    """Points of the bar, stage units, world."""
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath("/Arm/Bar")
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(time), float)
    M = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time))
    return points @ M[:3, :3] + M[3, :3]


@pytest.mark.slow
@pytest.mark.parametrize("pin", ["/Arm/Bar/end", "box:-5,-5,45,6,25,75"])
def test_what_is_held_follows_the_source_and_the_rest_swings(arm: Path, pin: str) -> None:
    out = arm.with_name("out.usda")
    result = gf_usd.bake(
        arm, material="soft-silicone", particles=800, pins=[pin], floor="none", output=out
    )
    assert result.frames > 13
    for time in (1.0, 5.0, 13.0):
        # stage units are float32 of some ten: 1e-5 is a few units in the last place
        np.testing.assert_allclose(world(out, time)[HELD], world(arm, time)[HELD], atol=2e-5)
    assert np.abs(world(out, 13.0) - world(arm, 13.0))[LOOSE].max() > 0.5  # it sags
    assert result.health["rollbacks"] == 0
    assert f"--pin {pin}" in result.root.read_text()
    assert not result.findings


def test_pins_and_floors_that_do_nothing_are_refused(arm: Path) -> None:
    for options, message in (
        ({"pins": ["box:900,0,0,901,1,1"]}, "does not touch the asset"),
        ({"pins": ["/Arm/Bar"]}, "contain all"),
        ({"pins": ["/Arm/Bra"]}, "there is no prim"),
        ({"pins": ["box:1,2"]}, "is not a box"),
        ({"floor": "1,1"}, "floor is"),
    ):
        with pytest.raises(gf_usd.GfUsdError) as caught:
            gf_usd.bake(arm, particles=300, frames=3, output=arm.with_name("x.usda"), **options)
        assert message in caught.value.message
        assert caught.value.hint
        assert sorted(p.name for p in arm.parent.iterdir()) == ["arm.usda"]


@pytest.mark.slow
def test_a_ball_rolls_down_a_tilted_floor(tmp_path: Path) -> None:
    ball = tmp_path / "ball.usda"
    ball.write_text(
        '#usda 1.0\n( metersPerUnit = 1\n upAxis = "Y" )\n'
        'def Sphere "Ball" {\ndouble radius = 0.5\n}'
    )
    result = gf_usd.bake(
        ball, particles=400, frames=24, drop="0.05", floor="0.3,1,0", output=tmp_path / "o.usda"
    )
    first, last = result.bakes[0].per_frame[0], result.bakes[0].per_frame[-1]
    assert last["center"][0] - first["center"][0] > 0.3  # down the slope, which points to +x
    assert result.health["deepest_penetration_spacings"] < 1.0
    # it stays on the plane, not on the ground below it
    n = np.array([0.3, 1.0, 0.0]) / np.hypot(0.3, 1.0)
    assert min(np.dot(f["center"], n) for f in result.bakes[0].per_frame) > 0.3


@pytest.mark.slow
def test_a_rigid_end_turns_and_keeps_its_shape(arm: Path) -> None:
    """Free of pins it falls on the floor, and its faces stay as they are."""
    arm.write_text(ARM.replace("13: 20 }", "13: 0 }").replace("13: (20, 0, 50)", "13: (0, 0, 50)"))
    out = arm.with_name("out.usda")
    result = gf_usd.bake(
        arm, output=out, material="jelly", particles=300, frames=13, drop=0.0,
        rigid="box:-5,-5,45,26,25,75", floor=(45.0, (0.3, 0.0, 1.0)),
    )  # fmt: skip
    assert not result.findings
    before, after = world(arm, 1.0)[HELD], world(out, 13.0)[HELD]
    assert np.abs(after - before).max() > 1.0  # it went somewhere
    # float32 points of some 100 units
    away = [np.linalg.norm(x[:, None] - x[None], axis=-1) for x in (before, after)]
    np.testing.assert_allclose(away[1], away[0], atol=1e-3)


def test_a_rigid_region_next_to_the_body_is_refused(arm: Path) -> None:
    with pytest.raises(gf_usd.InputError, match="rigid box:900") as caught:
        gf_usd.bake(arm, output=arm.with_name("out.usda"), rigid="box:900,0,0,901,1,1")
    assert caught.value.hint


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gravity", "warned"), [pytest.param(10, False, marks=pytest.mark.slow), (60, True)]
)
def test_a_body_that_expands_and_stretches_below_its_pin_is_warned_of(
    gf_usd, tmp_path: Path, gravity: float, warned: bool
) -> None:
    path = tmp_path / "ball.usda"
    ball = 'def Sphere "Ball"\n{\n double radius = 0.1\n}\n'
    path.write_text(f'#usda 1.0\n(metersPerUnit = 1\nupAxis = "Y")\n{ball}')
    pinned = ["-m", "jelly", "--pin", "box:-1,0.05,-1,1,2,1", "--gravity", f"0,-{gravity},0"]
    done = gf_usd(
        "bake", path, "-o", tmp_path / "out.usda", *pinned, "--particles", "300", "--frames", "12"
    )
    assert done.status == 0, done.err
    assert ("</Ball> expanded to" in done.err + done.out) == warned
    assert ("[expanded]" in done.err + done.out) == warned
    # The largest stretches of particles are 2.3 and 9.7.
    assert ("of the volume of </Ball> was stretched more" in done.err + done.out) == warned
    assert ("[stretched]" in done.err + done.out) == warned
