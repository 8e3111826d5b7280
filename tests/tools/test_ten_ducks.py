"""The stage of ten ducks: what it says of physics, and that nothing overlaps at its start."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdValidation
from scipy.spatial import cKDTree

from gf_usd.core.asset import Asset
from gf_usd.core.stage import StagePhysics
from gf_usd.readers import read_asset
from gf_usd.readers.usd_bake.settings import read_bake_settings
from gf_usd.readers.usd_physics.scene import read_physics

STAGE = Path(__file__).resolve().parents[2] / "samples" / "ten_ducks.usda"
DUCKS = "/TenDucks/Ducks"
FRAMES = 97


@pytest.fixture(scope="module")
def asset() -> Asset:
    return read_asset(STAGE, prims=(DUCKS,))


@pytest.fixture(scope="module")
def physics(asset: Asset) -> StagePhysics:
    bodies = [surface.path for surface in asset.surfaces]
    times = [1.0 + k for k in range(FRAMES)]
    return read_physics(STAGE, asset.facts, bodies, rest=None, times=times)


def test_ten_ducks_of_three_materials(asset: Asset, physics: StagePhysics) -> None:
    assert len(asset.surfaces) == 10
    made_of = [body.material.name for body in physics.bodies if body.material]
    assert {name: made_of.count(name) for name in made_of} == {"Jelly": 3, "Rubber": 5, "Hard": 2}
    assert physics.gravity == pytest.approx((0.0, -9.81, 0.0))
    assert physics.notes == ()
    settings = read_bake_settings(STAGE, asset.facts, [s.path for s in asset.surfaces])
    assert all(one.enabled and not one.obstacle for one in settings)


def test_the_bowl_rocks_and_the_ground_stays(asset: Asset, physics: StagePhysics) -> None:
    bowl, ground = physics.colliders
    assert (bowl.path, bowl.role, bowl.frames, bowl.rigid) == (
        "/TenDucks/Bowl", "kinematic", FRAMES, True,
    )  # fmt: skip
    assert (ground.path, ground.role, ground.moves) == ("/TenDucks/Ground", "static", False)
    settings = read_bake_settings(STAGE, asset.facts, [bowl.path, ground.path])
    assert all(one.obstacle for one in settings)
    # it starts at rest, tilts by nine degrees and clears the ground
    tilt = np.degrees(np.arccos([bowl.linear[k][1, 1] for k in range(FRAMES)]))
    assert tilt[0] == pytest.approx(0.0, abs=1e-6)
    assert 8.5 < tilt.max() < 9.5
    assert min(bowl.positions(k)[:, 1].min() for k in range(FRAMES)) > 0.1
    # its rim moves at 3.6 m/s at most, less than the ducks that fall on it
    steps = [np.abs(bowl.positions(k) - bowl.positions(k - 1)).max() for k in range(1, FRAMES)]
    assert max(steps) < 0.15


def test_nothing_overlaps_at_the_start(asset: Asset, physics: StagePhysics) -> None:
    clouds = {s.path: s.points for s in asset.surfaces}
    for one, other in combinations(clouds, 2):
        gap = cKDTree(clouds[one]).query(clouds[other])[0].min()
        assert gap > 0.2, f"{one} and {other}"  # two meters long
    rim = physics.colliders[0].points[:, 1].max()
    lows = sorted(points[:, 1].min() for points in clouds.values())
    assert lows[0] > 1.8
    assert lows[-1] > rim + 8.0
    # they come one after the other
    assert np.diff(np.sqrt(2.0 * (np.array(lows) - 1.2) / 9.81)).min() > 0.03


def test_usd_validation_finds_nothing() -> None:
    stage = Usd.Stage.Open(str(STAGE))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [f"{error.GetName()}: {error.GetMessage()}" for error in errors] == []
