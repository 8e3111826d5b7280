"""Sand: which solver simulates it, what is written of it, and options that it does not support."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from resumed import require_same

import gf_usd
from gf_usd.core.errors import Unfinished, UsageError

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
SAND: dict[str, Any] = {"material": "dry-sand", "particles": 300}


def test_granular_presets_choose_the_solver_and_what_is_written() -> None:
    plan = gf_usd.inspect(SPHERE, **SAND).plan
    assert plan.settings.solver == "ul"
    assert plan.choices.shapes == ("gaussians", "points")
    assert len(plan.samples.X) == len(plan.particles), "contact at every particle"
    assert any("dry-sand: flows without limit" in note and "hidden" in note for note in plan.notes)
    planned = gf_usd.inspect(SPHERE, only="mesh,points", **SAND).plan
    assert planned.choices.shapes == ("mesh", "points")
    assert not any("hidden" in note for note in planned.notes)


@pytest.mark.slow
def test_a_surface_is_planned_in_place_of_the_mesh() -> None:
    plan = gf_usd.inspect(SPHERE, surface=True, **SAND).plan
    assert plan.choices.shapes == ("mesh", "gaussians", "points")
    assert plan.choices.flows == (0,)
    assert plan.choices.flowing == tuple(s.path for s in plan.asset.surfaces)
    assert not any(plan.choices.drawn(s.path) for s in plan.asset.surfaces)
    assert plan.points == {}, "no vertex is carried along"
    assert any("instead of the mesh" in note for note in plan.notes)
    without = gf_usd.inspect(SPHERE, **SAND).plan
    assert without.choices.flows == without.choices.flowing == ()
    assert plan.frame_bytes > without.frame_bytes


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"material": "jelly", "surface": True}, "surface=True needs a material"),
        ({"surface": True, "only": "points"}, "which only points leaves out"),
        ({"certify": True}, "certify=True does not support materials"),
        ({"surface": True, "certify": True}, "certify=True does not support materials"),
        ({"solver": "tl"}, "cannot be combined with dry-sand"),
        ({"material": ["rubber", "dry-sand"]}, "some of these materials flow without limit"),
        ({"pins": "box:-9,-9,-9,9,-0.5,9"}, "a body that flows, which cannot be pinned"),
    ],
)
def test_options_that_sand_does_not_support_are_refused(more: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        gf_usd.inspect(SPHERE, **(SAND | more))


@pytest.mark.slow
def test_a_ball_of_sand_becomes_a_heap_that_stands(tmp_path: Path) -> None:
    done = gf_usd.bake(
        SPHERE, output=tmp_path / "s.usda", frames=60, drop=0, internal=True, **SAND
    )  # fmt: skip
    (bake,) = done.bakes
    last = bake.per_frame[-1]
    assert last["kinetic"] < 1e-3 * bake.health["energy_scale_J"]
    assert bake.health["plastic_dissipation_J"] > 0.0
    assert not done.findings
    stage = Usd.Stage.Open(str(done.root))
    points = UsdGeom.Points(stage.GetPrimAtPath("/Sphere/GaussianFlesh/Points"))
    first, end = (np.asarray(points.GetPointsAttr().Get(t)) for t in (1.0, 60.0))
    assert len(end) == len(first) == done.particles
    wide = np.ptp(end, axis=0)
    # A cone of the volume of a ball of 1 m with a slope of at most 0.6: its height is at most
    # (4 * 0.36)^(1/3) = 1.13 m, where the ball was 2 m high.
    assert wide[1] < 1.13 + 0.2
    assert min(wide[0], wide[2]) > 2.5
    gaussians = stage.GetPrimAtPath("/Sphere/GaussianFlesh/Gaussians")
    loose = gaussians.GetAttribute("gaussianFlesh:loosening").Get(60.0)
    assert np.min(loose) >= 0.0
    again = gf_usd.bake(
        SPHERE, output=tmp_path / "t.usda", frames=60, drop=0, internal=True, **SAND
    )  # fmt: skip
    assert again.bakes[0].cache.read_bytes() == bake.cache.read_bytes()


@pytest.mark.slow
def test_surfaces_are_resumed_to_the_bit_and_sound(tmp_path: Path) -> None:
    more: dict[str, Any] = {**SAND, "surface": True, "frames": 9, "drop": 0, "clip_frames": 3}
    whole = gf_usd.bake(SPHERE, output=tmp_path / "whole" / "s.usda", **more)
    assert not whole.findings
    with pytest.raises(Unfinished):
        gf_usd.bake(SPHERE, output=tmp_path / "parts" / "s.usda", slice=1, **more)
    gf_usd.bake(SPHERE, output=tmp_path / "parts" / "s.usda", resume=True, **more)
    require_same(tmp_path / "whole", tmp_path / "parts")
    stage = Usd.Stage.Open(str(whole.root))
    surface = UsdGeom.Mesh(stage.GetPrimAtPath("/Sphere/GaussianFlesh/Surface"))
    assert UsdGeom.Imageable(surface).ComputeVisibility(3.0) != UsdGeom.Tokens.invisible
    source = UsdGeom.Imageable(stage.GetPrimAtPath(plan_path(whole)))
    assert source.ComputeVisibility(3.0) == UsdGeom.Tokens.invisible
    color = np.array(surface.GetDisplayColorAttr().Get(9.0))
    points = UsdGeom.Points(stage.GetPrimAtPath("/Sphere/GaussianFlesh/Points"))
    mean = np.array(points.GetDisplayColorAttr().Get()).mean(0)
    np.testing.assert_allclose(color.mean(0), mean, atol=1e-3)  # the sphere has one color
    # The surface falls and spreads as its particles do.
    v = np.array(surface.GetVelocitiesAttr().Get(6.0))
    assert np.abs(v).max() <= np.abs(np.array(points.GetVelocitiesAttr().Get(6.0))).max()


def plan_path(done: gf_usd.BakeResult) -> str:
    """The mesh that was baked."""
    return json.loads(done.report.read_text())["bodies"][0]
