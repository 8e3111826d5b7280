"""What the rule about velocities leaves alone: contact, rest, motion too fast for the samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from check_damage import GAUSSIANS, MESH, OURS, POINTS
from check_stages import CODES, CUBE, GRID, RATE, box, good_stage, vec3

from gf_usd.usd.check import check_stage


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
    assert "too few to judge" in skip.reason


def test_few_samples_are_left_undecided(tmp_path: Path) -> None:
    stage = good_stage(tmp_path / "short.usda")
    for name in ("points", "velocities"):
        attribute = stage.GetPrimAtPath(MESH).GetAttribute(name)
        for code in CODES[4:]:
            attribute.ClearAtTime(code)
    (skip,) = check_stage(stage).skipped
    assert skip.reason == "velocities: 4 samples of motion, 5 are wanted to judge"
