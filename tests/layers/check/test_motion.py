"""What the rule about velocities leaves alone: contact, rest, motion too fast for the samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from checked_stages import (
    CODES,
    CUBE,
    GAUSSIANS,
    GRID,
    MESH,
    OURS,
    POINTS,
    RATE,
    box,
    good_stage,
    motion,
    vec3,
)
from pxr import Gf, Usd, UsdGeom

from gf_usd.core.errors import counted
from gf_usd.layers.check import motion as motion_rule
from gf_usd.layers.check.run import check_stage


def test_contact_and_rest_do_not_count_against_right_velocities(tmp_path: Path) -> None:
    """A ball that bounces and comes to rest: velocities jump, and finite differences with them."""
    stage = good_stage(tmp_path / "bounce.usda")
    codes = np.arange(1.0, 91.0)
    height, speed, state = 3.0, 0.0, []
    for _ in codes:
        state.append((height, speed))
        for _ in range(200):
            step = 1.0 / (RATE * 200)
            speed -= 9.81 * step
            height += speed * step
            if height < 0.0 and speed < 0.0:
                speed *= -0.5
    for path, name, rest in ((MESH, "velocities", CUBE), (GAUSSIANS, OURS + "velocities", GRID)):
        prim = stage.GetPrimAtPath(path)
        position = prim.GetAttribute("points" if path == MESH else "positions")
        for code, (y, v) in zip(codes, state):
            x = rest + np.array([0.0, y, 0.0])
            position.Set(vec3(x), code)
            prim.GetAttribute(name).Set(vec3(np.tile([0.0, v, 0.0], (len(rest), 1))), code)
            prim.GetAttribute("extent").Set(box(x, 0.3), code)
    stage.SetEndTimeCode(codes[-1])
    stage.RemovePrim(POINTS)
    stage.GetPrimAtPath(GAUSSIANS).RemoveProperty(OURS + "vonMisesStress")
    result = check_stage(stage)
    assert result.findings == ()
    assert result.skipped == ()


def test_motion_faster_than_the_samples_is_left_undecided(tmp_path: Path) -> None:
    """Random positions have no derivative: the check says so rather than guess."""
    stage = good_stage(tmp_path / "noise.usda")
    random = np.random.default_rng(1)
    prim = stage.GetPrimAtPath(MESH)
    for code in CODES:
        x = random.uniform(-1.0, 1.0, CUBE.shape)
        prim.GetAttribute("points").Set(vec3(x), code)
        prim.GetAttribute("extent").Set(box(x), code)
    result = check_stage(stage)
    assert result.findings == ()
    (skip,) = result.skipped
    assert (skip.rule, skip.prim_path) == ("velocities", MESH)
    assert "too few for this check" in skip.reason


def test_few_samples_are_left_undecided(tmp_path: Path) -> None:
    stage = good_stage(tmp_path / "short.usda")
    for name in ("points", "velocities"):
        attribute = stage.GetPrimAtPath(MESH).GetAttribute(name)
        for code in CODES[4:]:
            attribute.ClearAtTime(code)
    (skip,) = check_stage(stage).skipped
    assert skip.reason == "4 samples of motion; this check needs 5"


@pytest.mark.parametrize(
    ("samples", "factor", "wrong"),
    [(5, 1.14, False), (6, 1.25, False), (6, RATE, True), (5, 1 / RATE, True), (7, 1.25, True)],
)
def test_one_or_two_windows_show_a_wrong_unit_only(
    tmp_path: Path, samples: int, factor: float, wrong: bool
) -> None:
    """A block that lands on sand had 1.14 in five samples, and 1.00 in eight times as many."""
    stage = good_stage(tmp_path / "short.usda")
    prim = stage.GetPrimAtPath(MESH)
    for code in CODES:
        prim.GetAttribute("velocities").Set(vec3(factor * motion(CUBE, code)[1]), code)
    for code in CODES[samples:]:
        for name in ("points", "velocities", "extent"):
            prim.GetAttribute(name).ClearAtTime(code)
    result = check_stage(stage)
    assert [finding.rule for finding in result.findings] == ["velocities"] * wrong
    message = f"they are {factor:.3g} times the motion in only {counted(samples - 4, 'window')}"
    assert [skip.reason.startswith(message) for skip in result.skipped] == [True] * (not wrong)


@pytest.mark.parametrize("factor", [1.0, 1.25])
def test_a_long_motion_is_judged_by_some_of_it_all_along(factor: float) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(RATE)
    prim = UsdGeom.Points.Define(stage, "/Points").GetPrim()
    position, velocity = (prim.GetAttribute(name) for name in ("points", "velocities"))
    for code in np.arange(float(10 * motion_rule.MOST)):
        at = 2.0 * code / RATE
        position.Set(vec3(CUBE + [np.sin(at), 0.0, np.cos(at)]), code)
        v = 2.0 * np.tile([np.cos(at), 0.0, -np.sin(at)], (len(CUBE), 1))
        velocity.Set(vec3(factor * v), code)
    tally = motion_rule.tally_of(position, velocity, RATE)
    assert len(tally.factors) == motion_rule.MOST
    assert tally.moving == tally.smooth == motion_rule.MOST * len(CUBE)
    assert tally.factor == pytest.approx(factor, rel=1e-4)
    # Where it is wrong only at the end, windows at the end are among them.
    for code in np.arange(0.9 * 10 * motion_rule.MOST):
        velocity.Set(vec3(np.zeros_like(CUBE)), code)
    late = motion_rule.tally_of(position, velocity, RATE)
    assert sum(np.array(late.factors) > 0.5) == pytest.approx(0.1 * motion_rule.MOST, abs=2)


def shaken(stage: Usd.Stage, scale: float) -> None:
    """Give the Gaussians a vibration of 13 periods in 10 samples, as fast as they fall.

    Its velocity is as large as the fall's, its amplitude is too small to show in the positions.
    """
    random = np.random.default_rng(2)
    omega = 2.0 * np.pi * 1.3 * RATE
    phase = random.uniform(0.0, 2.0 * np.pi, (len(GRID), 1))
    way = random.normal(size=(len(GRID), 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    prim = stage.GetPrimAtPath(GAUSSIANS)
    for code in CODES:
        angle = omega * (code - CODES[0]) / RATE + phase
        x, v = motion(GRID, code)
        x, v = x + 2.0 / omega * np.sin(angle) * way * 0.1, v + 2.0 * np.cos(angle) * way
        prim.GetAttribute("positions").Set(vec3(x), code)
        prim.GetAttribute(OURS + "velocities").Set(vec3(scale * v), code)


def test_a_vibration_in_the_velocities_drops_out(tmp_path: Path) -> None:
    """Both the right velocities and those per time code are told apart in spite of it."""
    stage = good_stage(tmp_path / "shaken.usda")
    shaken(stage, 1.0)
    assert check_stage(stage).findings == ()
    shaken(stage, 1.0 / RATE)
    (finding,) = check_stage(stage).findings
    assert (finding.rule, finding.prim_path) == ("velocities", GAUSSIANS)


def test_velocities_of_points_that_stand_still(tmp_path: Path) -> None:
    stage = good_stage(tmp_path / "still.usda")
    prim = stage.GetPrimAtPath(MESH)
    for code in CODES:
        prim.GetAttribute("points").Set(vec3(CUBE), code)
        prim.GetAttribute("extent").Set(box(CUBE), code)
    (finding,) = check_stage(stage).findings
    assert finding.message == (
        # 8 points in 8 windows of 5 among 12 samples
        "velocities is not zero in 64 of 64 places where points does not move"
    )


def test_what_swings_from_sample_to_sample_does_not_stand_still(tmp_path: Path) -> None:
    """A vibration at half the rate of the samples has no speed by them: nothing can be decided."""
    stage = good_stage(tmp_path / "swinging.usda")
    prim = stage.GetPrimAtPath(MESH)
    for at, code in enumerate(CODES):
        x = CUBE + np.array([0.0, 0.25 * (-1) ** at, 0.0])
        prim.GetAttribute("points").Set(vec3(x), code)
        prim.GetAttribute("velocities").Set(vec3(np.full(CUBE.shape, 0.5 * (-1) ** at)), code)
        prim.GetAttribute("extent").Set(box(x), code)
    result = check_stage(stage)
    assert result.findings == ()
    (skip,) = result.skipped
    assert (skip.rule, skip.prim_path) == ("velocities", MESH)
    assert "too fast for the samples" in skip.reason


def test_windows_that_disagree_are_left_undecided(tmp_path: Path) -> None:
    """Bounces too fast for the samples stretch each moment in its own way, a wrong unit not."""
    stage = good_stage(tmp_path / "bounces.usda")
    prim = stage.GetPrimAtPath(MESH)
    bounces, unit = (0.8, 1.4, 0.3, 1.3, 0.6, 0.8), (0.8, 0.75, 0.85, 0.8, 0.78, 0.8)
    back = tuple(-factor for factor in unit)  # of the wrong sign
    for factors, found, left in ((bounces, 0, 1), (unit, 1, 0), (back, 1, 0)):
        for at, code in enumerate(CODES):
            v = motion(CUBE, code)[1]
            prim.GetAttribute("velocities").Set(vec3(factors[at % len(factors)] * v), code)
        result = check_stage(stage)
        assert [f.rule for f in result.findings] == ["velocities"] * found
        message = f"{motion_rule.TOO_FAST}: the points turn between two of them"
        assert [s.reason for s in result.skipped] == [message] * left


@pytest.mark.parametrize("factor", [0.8, 1.25])
@pytest.mark.parametrize("turn", [0.2, 0.4, 0.5])
def test_a_wrong_rate_shows_in_a_vibration_that_the_samples_resolve(
    factor: float, turn: float
) -> None:
    """turn : of the vibration [rad] from a sample to the next.  Where it turns back a window cannot
    say that its factor is not 1, which does not count against the others.
    """
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(RATE)
    points = UsdGeom.Points.Define(stage, "/Points")
    for code in np.arange(100.0):
        x, v = np.sin(turn * code), turn * RATE * np.cos(turn * code)
        points.CreatePointsAttr().Set(vec3(CUBE + [x, 0.0, 0.0]), code)
        points.CreateVelocitiesAttr().Set(vec3(0.0 * CUBE + [factor * v, 0.0, 0.0]), code)
    (message,) = [f.message for f in check_stage(stage).findings if f.rule == "velocities"]
    # the finite differences are off by up to turn^4 / 30
    assert float(message.split()[2]) == pytest.approx(factor, rel=0.005)


def test_factors_far_from_one_may_disagree_too(tmp_path: Path) -> None:
    """Of a ball of rubber that two plates squeeze: all are negative, and no unit is among them."""
    stage = good_stage(tmp_path / "squeezed.usda")
    prim = stage.GetPrimAtPath(MESH)
    for at, code in enumerate(CODES):
        v = motion(CUBE, code)[1] * (-9.9, -4.6, -6.3, -7.5)[at % 4]
        prim.GetAttribute("velocities").Set(vec3(v), code)
    result = check_stage(stage)
    assert result.findings == ()
    (skip,) = result.skipped
    assert skip.reason == f"{motion_rule.TOO_FAST}: the points turn between two of them"


@pytest.mark.parametrize("periods", [0.97, 1.03, 2.04])
def test_what_trembles_faster_than_the_samples_is_left_undecided(
    tmp_path: Path, periods: float
) -> None:
    """Near a multiple of the rate the samples show a slow and smooth motion that is not there."""
    stage = good_stage(tmp_path / "trembling.usda")
    prim = stage.GetPrimAtPath(MESH)
    omega, way = 2.0 * np.pi * periods * RATE, np.array([0.3, 0.0, 0.1])
    for code in CODES:
        angle = omega * (code - CODES[0]) / RATE
        x, v = CUBE + np.sin(angle) * way, 0.0 * CUBE + omega * np.cos(angle) * way
        prim.GetAttribute("points").Set(vec3(x), code)
        prim.GetAttribute("velocities").Set(vec3(v), code)
        prim.GetAttribute("extent").Set(box(x), code)
    result = check_stage(stage)
    assert result.findings == ()
    assert [
        "too fast for the samples: the points vibrate" in skip.reason for skip in result.skipped
    ] == [True]


def test_what_trembles_after_it_moved_far_is_left_undecided(tmp_path: Path) -> None:
    """Its range is that of the moment, not that of the way before."""
    stage = good_stage(tmp_path / "moved.usda")
    prim = stage.GetPrimAtPath(MESH)
    omega, way = 2.0 * np.pi * 0.97 * RATE, np.array([0.3, 0.0, 0.1])
    far = np.array([0.0, 100.0, 0.0])
    for at, code in enumerate(CODES):
        angle = omega * (code - CODES[0]) / RATE
        x, v = CUBE + np.sin(angle) * way, 0.0 * CUBE + omega * np.cos(angle) * way
        x = x + far * (at > 1)  # at once: no window in which it moves is smooth
        prim.GetAttribute("points").Set(vec3(x), code)
        prim.GetAttribute("velocities").Set(vec3(v), code)
        prim.GetAttribute("extent").Set(box(x), code)
    result = check_stage(stage)
    assert result.findings == ()
    assert [
        "too fast for the samples: the points vibrate" in skip.reason for skip in result.skipped
    ] == [True]


def jump(at: float, after: float) -> motion_rule.Tally:
    """What is seen of a body whose speed changes from 1 to ``after`` at a time code."""
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(RATE)
    prim = UsdGeom.Points.Define(stage, "/Points").GetPrim()
    position, velocity = (prim.GetAttribute(name) for name in ("points", "velocities"))
    for code in np.arange(5.0):
        way = (min(code, at) + after * max(code - at, 0.0)) / RATE
        position.Set(vec3(CUBE + [0.0, way, 0.0]), code)
        speed = after if code > at else 1.0
        velocity.Set(vec3(np.tile([0.0, speed, 0.0], (len(CUBE), 1))), code)
    return motion_rule.tally_of(position, velocity, RATE)


@pytest.mark.parametrize("after", [0.0, -0.5, -1.0, 0.7, 0.9, 1.5, 100.0])
def test_wherever_a_velocity_jumps_the_error_has_a_bound(after: float) -> None:
    """Five samples are one window, so all points agree on it by the same chance.

    A stop at the middle sample has the same derivative by three samples as by five: the mean of
    the velocities before and after.
    """
    for at in np.linspace(0.0, 4.0, 81):
        seen = jump(at, after)
        for factor, bound in zip(seen.factors, seen.bounds, strict=True):
            assert abs(factor - 1.0) <= bound + 1e-5, at  # of the rounding of float
            assert abs(factor - 1.0) < motion_rule.WRONG or seen.agreed == 0.0, at


def test_a_ribbon_that_falls_two_samples_and_stays_is_left_undecided(tmp_path: Path) -> None:
    """All that a bake of toothpaste has of motion; it was reported to be of a wrong unit."""
    stage = good_stage(tmp_path / "landed.usda")
    prim = stage.GetPrimAtPath(MESH)
    heights = (0.0, -0.852, -2.007)
    for at, code in enumerate(CODES):
        y = heights[min(at, 2)]
        speed = (0.0, -40.9, 0.9)[at] * RATE / 24.0 if at < 3 else 0.0
        prim.GetAttribute("points").Set(vec3(CUBE + [0.0, y, 0.0]), code)
        prim.GetAttribute("velocities").Set(vec3(0.0 * CUBE + [0.0, speed, 0.0]), code)
        prim.GetAttribute("extent").Set(box(CUBE + [0.0, y, 0.0]), code)
    result = check_stage(stage)
    assert result.findings == ()
    assert ["too fast for the samples" in skip.reason for skip in result.skipped] == [True]


@pytest.mark.parametrize("factor", [100.0, RATE, 1.0 / RATE, -1.0, -RATE])
def test_a_wrong_unit_is_no_trembling(tmp_path: Path, factor: float) -> None:
    stage = good_stage(tmp_path / "unit.usda")
    prim = stage.GetPrimAtPath(MESH)
    for code in CODES:
        prim.GetAttribute("velocities").Set(vec3(factor * motion(CUBE, code)[1]), code)
    (finding,) = check_stage(stage).findings
    assert finding.rule == "velocities"


def test_a_sheared_prim_is_judged_by_its_motion_in_the_world(tmp_path: Path) -> None:
    """In its own space a vibration across the shear would be most of the motion."""
    stage = good_stage(tmp_path / "sheared.usda")
    prim = stage.GetPrimAtPath(MESH)
    shear = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 500.0, 1.0]])  # rows
    matrix = np.eye(4)
    matrix[:3, :3] = shear
    fall = np.array([0.0, 1.0, 0.0])
    UsdGeom.Xformable(prim).AddTransformOp().Set(Gf.Matrix4d(matrix.tolist()))
    back = np.linalg.inv(shear)
    omega, way = 2.0 * np.pi * 1.03 * RATE, np.array([0.0, 0.0, 0.002])
    for code in CODES:
        angle = omega * (code - CODES[0]) / RATE
        t = (code - CODES[0]) / RATE
        x = CUBE - 0.5 * 9.81 * t**2 * fall + np.sin(angle) * way
        v = 0.0 * CUBE - 9.81 * t * fall + omega * np.cos(angle) * way
        prim.GetAttribute("points").Set(vec3(x @ back), code)
        prim.GetAttribute("velocities").Set(vec3(v @ back), code)
        prim.GetAttribute("extent").Set(box(x @ back), code)
    assert [f for f in check_stage(stage).findings if f.rule == "velocities"] == []


@pytest.mark.parametrize("other", ["nothing", "velocities", "places"])
def test_a_twin_is_judged_once_and_only_one_that_is_alike(
    monkeypatch: pytest.MonkeyPatch, other: str
) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(RATE)
    for path in ("/One", "/Two"):
        points = UsdGeom.Points.Define(stage, path)
        off = 1.0 if path == "/Two" and other == "places" else 0.0
        factor = 2.0 if path == "/Two" and other == "velocities" else 1.0
        for code in np.arange(20.0):
            x, v = motion(GRID, code)
            points.GetPointsAttr().Set(vec3(x + off), code)
            points.GetVelocitiesAttr().Set(vec3(factor * v), code)
    judged = []
    tally_of = motion_rule.tally_of
    monkeypatch.setattr(
        motion_rule, "tally_of", lambda *given: judged.append(1) or tally_of(*given)
    )
    found = list(motion_rule.velocities(stage))
    assert len(judged) == (1 if other == "nothing" else 2)
    assert len(found) == (1 if other == "velocities" else 0)


def test_prims_that_differ_are_not_compared_sample_by_sample(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(RATE)
    for k in range(6):  # each at a place or in a frame of its own
        points = UsdGeom.Points.Define(stage, f"/P{k}")
        if k % 2:
            points.AddRotateXOp().Set(10.0 * k)
        for code in np.arange(20.0):
            x, v = motion(GRID, code)
            points.GetPointsAttr().Set(vec3(x + k - k % 2), code)
            points.GetVelocitiesAttr().Set(vec3(v), code)
    compared = []
    monkeypatch.setattr(motion_rule, "_is_twin", lambda *given: compared.append(1))
    assert list(motion_rule.velocities(stage)) == []
    assert not compared


@pytest.mark.parametrize(("factor", "checked"), [(1.0, True), (0.9, False), (RATE, False)])
def test_central_differences_of_an_animation_with_linear_keys_are_right(
    tmp_path: Path, factor: float, checked: bool
) -> None:
    """A dance that turns at each of its samples, where no motion is smooth."""
    stage = good_stage(tmp_path / "dance.usda")
    random = np.random.default_rng(1)
    prim = stage.GetPrimAtPath(MESH)
    x = [CUBE + random.uniform(-1.0, 1.0, 3) for _ in CODES]
    v = factor * RATE * np.gradient(np.array(x), axis=0)
    for code, at, speed in zip(CODES, x, v, strict=True):
        prim.GetAttribute("points").Set(vec3(at), code)
        prim.GetAttribute("velocities").Set(vec3(speed), code)
        prim.GetAttribute("extent").Set(box(at), code)
    result = check_stage(stage)
    assert result.findings == ()
    assert [skip.rule for skip in result.skipped] == ([] if checked else ["velocities"])
