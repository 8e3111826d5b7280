"""Solid and flowing bodies in one bake: its plan, its results and its errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mixed_stages import TRAY, body, castle_of, scene
from pxr import Usd, UsdGeom

import gf_usd
from gf_usd.core.errors import InputError, UsageError


@pytest.fixture
def castle(tmp_path: Path) -> Path:
    return castle_of(tmp_path)


SMALL: dict[str, Any] = {"particles": 300, "drop": 0}


@pytest.mark.slow
def test_the_law_of_each_body_says_how_it_is_simulated(castle: Path) -> None:
    plan = gf_usd.inspect(castle, **SMALL).plan
    assert plan.settings.solver == "mixed"
    assert plan.choices.flowing == ("/World/Sand",)
    assert plan.choices.shapes == ("mesh", "gaussians", "points")
    assert plan.bodies.count == 2
    grains = int((np.asarray(plan.particles.body) == 0).sum())
    assert int((np.asarray(plan.samples.body) == 0).sum()) == grains, "contact at every particle"
    assert any("</World/Sand>: flows without limit (dry-sand" in note for note in plan.notes)
    assert set(plan.points) == {"/World/Block"}, "no mesh is drawn of what flows"
    alone = gf_usd.inspect(castle, solver="ul", **SMALL).plan
    assert alone.settings.solver == "ul"
    assert alone.bodies.count == 1
    boxed = gf_usd.inspect(
        castle, material="rubber", material_boxes=["wet-sand:-1,-0.01,-1,1,0.21,1"], **SMALL
    ).plan
    assert boxed.settings.solver == "mixed"
    assert boxed.choices.flowing == ("/World/Sand",)


def test_bodies_that_touch_stay_apart_where_one_flows(tmp_path: Path) -> None:
    sand, rubber = ("Sand", "dry-sand", "0, 0.1, 0"), ("Block", "rubber", "0, 0.3, 0")
    plan = gf_usd.inspect(scene(tmp_path, body(*sand), body(*rubber)), **SMALL).plan
    assert plan.bodies.count == 2


def test_sand_that_the_stage_asks_for_flows(tmp_path: Path) -> None:
    """It was simulated as a solid body, without a word."""
    plan = gf_usd.inspect(scene(tmp_path, body("Sand", "dry-sand", "0, 0.1, 0")), **SMALL).plan
    assert plan.settings.solver == "ul"
    assert any("flows without limit" in note for note in plan.notes)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"solver": "tl"}, "cannot be combined with dry-sand"),
        (
            {"combine": True},
            r"combine(=True)? cannot be combined with flowing bodies .*</World/Sand>",
        ),
        ({"rigid": "box:-1,0.3,-1,1,1,1"}, "rigid cannot be combined with flowing bodies"),
        ({"fields": ["wind:1,0,0"]}, "fields? cannot be combined with flowing bodies"),
        ({"settle_only": True}, "settle.only(=True)? cannot be combined with flowing bodies"),
        ({"frames": "rest"}, "frames .*rest.* cannot be combined with flowing bodies"),
        ({"certify": True}, "certify(=True)? cannot be combined with flowing bodies"),
        ({"tets": True}, "tets(=True)? cannot be combined with flowing bodies"),
        ({"skin": "idw"}, "skin.*idw.* cannot be combined with flowing bodies"),
        ({"rolling_resistance": 0.1}, "rolling.resistance cannot be combined with"),
    ],
)
def test_options_that_a_mixed_scene_does_not_support_are_refused(
    castle: Path, more: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        gf_usd.inspect(castle, **(SMALL | more))


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_body_of_which_a_part_flows_is_moved_as_a_whole_by_the_solver_of_what_flows(
    tmp_path: Path,
) -> None:
    """The upper half of a block of rubber is water: the lower half stays a block."""
    path = scene(tmp_path, body("Block", "rubber", "0, 0.1, 0"), body("Far", "rubber", "3, 0.1, 0"))
    options = {"material": "rubber", "material_boxes": ["water:-1,0.1,-1,1,1,1"], "drop": 0}
    seen = gf_usd.inspect(path, particles=2000, **options).plan
    assert seen.settings.solver == "mixed"
    assert seen.choices.flowing == ("/World/Block",), "particles replace it"
    done = gf_usd.bake(path, frames=24, particles=2000, output=tmp_path / "out.usda", **options)
    assert not done.findings
    stage = Usd.Stage.Open(str(done.root))
    flow = UsdGeom.Points(stage.GetPrimAtPath("/World/GaussianFlesh/Flow"))
    first, last = (np.asarray(flow.GetPointsAttr().Get(code)) for code in (1.0, 24.0))
    water = first[:, 1] > 0.1
    assert water.sum() == 500, "both halves are shown"
    spacing = seen.particles.spacing
    assert np.linalg.norm(last[~water] - first[~water], axis=1).max() < spacing
    assert (last[water, 1] < 0.1).mean() > 0.2, "it runs over the edges"


@pytest.mark.slow
def test_what_flows_must_not_start_inside_a_solid_body(tmp_path: Path) -> None:
    water, ball = ("Water", "water", "0, 0.1, 0"), ("Block", "rubber", "0.1, 0.2, 0")
    with pytest.raises(InputError, match="flowing particles start inside a solid body"):
        gf_usd.bake(scene(tmp_path, body(*water), body(*ball)), **SMALL)


@pytest.mark.slow
def test_samples_of_flowing_bodies_next_to_solid_ones_are_left_out(
    castle: Path, tmp_path: Path
) -> None:
    """It ended with a ValueError: the tolerances were those of all particles."""
    done = gf_usd.bake(
        castle, output=tmp_path / "out.usda", frames=8, fps=120, precision="1%",
        adaptive_samples=True, **{**SMALL, "particles": 150},
    )  # fmt: skip
    assert not done.findings
    stage = Usd.Stage.Open(str(done.root))
    flow = UsdGeom.Points(stage.GetPrimAtPath("/World/GaussianFlesh/Flow"))
    twin = UsdGeom.Points(stage.GetPrimAtPath("/World/GaussianFlesh/Points"))
    assert len(flow.GetPointsAttr().GetTimeSamples()) < 8
    radius = 0.2 * (3.0 / (4.0 * np.pi)) ** (1.0 / 3.0)  # [m] of a ball of a cube's volume
    for code in np.arange(1.0, 9.0):
        grains, every = (np.asarray(one.GetPointsAttr().Get(code)) for one in (flow, twin))
        way = np.linalg.norm(grains - every[: len(grains)], axis=1).max()
        assert way < 2.0 * 0.01 * radius, "both are within the precision"


@pytest.mark.slow
def test_a_tray_moves_sand_and_rubber_and_the_result_is_checked(tmp_path: Path) -> None:
    sand, rubber = ("Sand", "dry-sand", "0, 0.12, 0"), ("Block", "rubber", "0.03, 0.35, 0.02")
    path = scene(tmp_path, TRAY, body(*sand), body(*rubber))
    done = gf_usd.bake(path, output=tmp_path / "out.usda", frames=16, **SMALL)
    assert not done.findings
    stage = Usd.Stage.Open(str(done.root))
    flow = stage.GetPrimAtPath("/World/GaussianFlesh/Flow")
    image = UsdGeom.Imageable(flow)
    assert image.ComputeVisibility(8.0) != "invisible", "sand is shown next to the mesh"
    hidden = UsdGeom.Imageable(stage.GetPrimAtPath("/World/Sand"))
    assert hidden.ComputeVisibility(8.0) == "invisible"
    grains = np.asarray(UsdGeom.Points(flow).GetPointsAttr().Get(16.0))
    every = np.asarray(
        UsdGeom.Points(stage.GetPrimAtPath("/World/GaussianFlesh/Points")).GetPointsAttr().Get(16.0)
    )
    assert 0 < len(grains) < len(every) == done.particles
    # the tray's top is at -.02 m and rises by .1 m / 23 a frame
    top = -0.02 + 0.1 / 23.0 * 15.0
    near = np.abs(grains[:, [0, 2]]).max(1) < 0.45
    assert grains[near, 1].min() > top - 0.5 * 0.03


@pytest.mark.slow
def test_sand_that_misses_the_tray_is_counted_and_warned_of(tmp_path: Path) -> None:
    sand, rubber = ("Sand", "dry-sand", "0.47, 0.12, 0"), ("Block", "rubber", "-0.2, 0.12, 0")
    path = scene(tmp_path, TRAY, body(*sand), body(*rubber))
    done = gf_usd.bake(
        path, output=tmp_path / "out.usda", frames=24, floor=False, **SMALL
    )  # fmt: skip
    (bake,) = done.bakes
    (about,) = [w.message for _, w in done.warnings if "below" in w.message]
    assert about.startswith(f"{bake.health['lost_particles']} flowing particles")
    # Half of the block is beyond the edge and is 3 m deep after 23 frames; a heap slides after it.
    assert 0.1 < bake.health["lost_share"] < 0.5
    assert bake.health["first_lost_frame"] > 8, "not before it has fallen past the tray"
    assert bake.health["flow_volume_min"] == pytest.approx(1.0, abs=0.02)
