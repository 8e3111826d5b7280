"""World to local: points, normals and rates of change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from small_sources import MOVING
from small_stages import motion

from gf_usd.core.errors import InputError
from gf_usd.layers.space import Space
from gf_usd.layers.stage import Clock

CLOCK = Clock(rate=24.0, source_rate=24.0, start=1.0, end=9.0, step=1.0)


def space_of(path: Path, prim: str) -> Space:
    stage = Usd.Stage.Open(str(path))
    space = Space(stage.GetPrimAtPath(prim), CLOCK, 0.01)
    space.keep = stage
    return space


def test_velocities_are_the_rate_of_the_local_points(tmp_path: Path) -> None:
    # rounded to floats the turn itself would be rough
    exact = replace(MOVING, body=MOVING.body.replace("float3 xformOp:rot", "double3 xformOp:rot"))
    space = space_of(exact.asset(tmp_path).facts.path, "/root/arm/m")
    rest = np.random.default_rng(1).normal(size=(20, 3))
    h = 1e-4
    # between two samples of the transform, where it is smooth
    for time_code in (2.3, 4.7):

        def local(code: float) -> np.ndarray:
            return space.points(motion(rest, code / 24.0)[0], code)

        x, v, _ = motion(rest, time_code / 24.0)
        rate = (local(time_code + h) - local(time_code - h)) / (2 * h / 24.0)
        found = space.velocities(x, v, time_code)
        # 17 degrees a frame: (0.3 rad)^2 / 2400 = 4e-5 of terms that partly cancel
        np.testing.assert_allclose(found, rate, rtol=0, atol=1e-4 * np.abs(rate).max())


def test_outside_the_bake_no_motion_is_made_up(tmp_path: Path) -> None:
    space = space_of(MOVING.asset(tmp_path).facts.path, "/root/arm/m")
    still = np.zeros((1, 3))
    # the transform rests after code 5; the rate at the last frame looks back from there
    assert np.all(space.velocities(still + 1, still, 9.0) == 0)
    assert np.any(space.velocities(still + 1, still, 1.0) != 0)


def test_normals_stay_perpendicular_to_the_surface(tmp_path: Path) -> None:
    space = space_of(MOVING.asset(tmp_path).facts.path, "/root/arm/m")
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 50, 3))
    n = np.cross(a, b)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    w = space.from_world(3.0)[:3, :3]
    local = space.normals(n, 3.0)
    for side in (a, b):
        across = side @ w
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        # the scales of 2 to 50 amplify 1e-16 by their ratio
        np.testing.assert_allclose(np.einsum("ij,ij->i", local, across), 0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1, rtol=1e-12)


def test_a_flat_transform_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flat.usda"
    path.write_text(
        MOVING.asset(tmp_path).facts.path.read_text().replace("(2, 50, -5)", "(2, 0, 5)")
    )
    with pytest.raises(InputError) as caught:
        space_of(path, "/root/arm/m").from_world(1.0)
    assert caught.value.message == (
        "</root/arm/m>: the local-to-world transform at time code 1 flattens space (scales 5 to 0)"
    )
