"""The default length of a bake whose pins or obstacles move longer than a bake usually lasts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from physics_stages import SLIDE, head, mesh, prim
from planned import noted, planner

import gf_usd
from gf_usd.core.frames.settings import written
from gf_usd.prepare.plan import Plan
from gf_usd.prepare.settings import REST_WORK

LONG = SLIDE.replace("3: (4, 0, 0)", "200.5: (1, 0, 0), 250: (1, 0, 0), 260: (1, 0, 0)")
BESIDE = LONG.replace("(0, 0, 0)", "(0.9, 0, 0)")


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


def lengths(plan: Callable[..., Plan], *prims: str, layer: str = head(), **more: Any) -> Plan:
    return plan(*prims, layer=layer, **({"frames": None, "pins": ("/Handle",)} | more))


def test_a_bake_lasts_as_long_as_its_pins_move(plan) -> None:
    """It ended after 83 frames: the handle continued, and the body stayed where it was."""
    made = lengths(plan, mesh("One"), mesh("Handle", BESIDE))
    assert made.settings.frames == 201, "the first at which the pin stays"
    assert noted(made, "201 frames are simulated, as what is pinned moves until time code 200.5:")


@pytest.mark.parametrize(
    ("more", "frames"), [({"frames": 12}, 12), ({"range": "1:30"}, 30), ({"handles": 2}, 203)]
)
def test_a_given_length_stays(plan, more: dict[str, Any], frames: int) -> None:
    made = lengths(plan, mesh("One"), mesh("Handle", BESIDE), **more)
    assert made.settings.frames == frames
    assert noted(made, "as what is pinned moves") == ("handles" in more)


def test_the_note_counts_the_frames_that_are_written(plan) -> None:
    """It said 203 frames where the plan said 205."""
    made = lengths(plan, mesh("One"), mesh("Handle", BESIDE), handles=2)
    assert written(made.settings) == 205
    assert noted(made, "205 frames are written, 203 of them simulated, as what is pinned moves")


@pytest.mark.parametrize(("seconds", "frames"), [(5.0, 120), (0.5, 93)])
def test_playback_limits_the_length(plan, monkeypatch, seconds: float, frames: int) -> None:
    """A handle that turned through 20,000 samples made as many frames."""
    monkeypatch.setattr("gf_usd.prepare.fill.shot.REST_SECONDS", seconds)
    made = lengths(plan, mesh("One"), mesh("Handle", BESIDE))
    assert made.settings.frames == frames, "at least those of the default length"
    assert noted(
        made,
        f"{frames} frames are simulated, although what is pinned moves until time code 200.5, which"
        f" would take more than {seconds:g} s of playback; use --frames 201 for that",
    )


@pytest.mark.parametrize(("times", "frames"), [(0.99, 201), (2.0, 100), (99.0, 93)])
def test_work_limits_the_length(plan, monkeypatch, times: float, frames: int) -> None:
    monkeypatch.setattr("gf_usd.pipeline.prepared._work", lambda prepared: times * REST_WORK)
    made = lengths(plan, mesh("One"), mesh("Handle", BESIDE))
    assert made.settings.frames == frames
    (note,) = (note for note in made.notes if "frames are simulated" in note)
    limited = (
        f"{frames} frames are simulated, although what is pinned moves until time code 200.5, which"
        " would take more than 20 billion particle substeps; use --frames 201 for that"
    )
    assert (note == limited) == (times > 1.0)


def test_an_obstacle_that_moves_for_longer_than_the_pin_has_the_note(plan) -> None:
    later = LONG.replace("(0, 0, 0)", "(-5, 0, 0)").replace("200.5:", "240:")
    wall = mesh("Wall", later, apis=("PhysicsCollisionAPI",))
    made = lengths(plan, mesh("One"), mesh("Handle", BESIDE), wall)
    (note,) = (note for note in made.notes if "frames are simulated" in note)
    assert note.startswith("240 frames are simulated, as an obstacle moves until time code 240:")


def test_the_end_of_the_stage_bounds_the_motion(plan) -> None:
    layer = head(extra="endTimeCode = 120")
    made = lengths(plan, mesh("One"), mesh("Handle", BESIDE), layer=layer)
    assert made.settings.frames == 120


@pytest.mark.parametrize("pin", ["box:0.5,-1,-1,3,3,3", "/Handle", "/Rig"])
def test_what_moves_the_pin_counts_however_it_is_named(plan, pin: str) -> None:
    still = mesh("One")
    rig = prim("Xform", "Rig", BESIDE, mesh("Handle"))
    name = "/Rig/Handle" if pin == "/Handle" else pin
    assert lengths(plan, still, rig, pins=(name,)).settings.frames == 201


def test_points_that_move_count(plan) -> None:
    points = "point3f[] points.timeSamples = { 1: %s, 150: %s }"
    at = "[(0,0,0),(1,0,0),(0,1,0),(1,1,0),(0,0,1),(1,0,1),(0,1,1),(1,1,1)]"
    moved = points % (at, at.replace("(1,1,1)", "(1,1,1.2)"))
    place = BESIDE.splitlines()[-1] + "\ndouble3 xformOp:translate = (0.9, 0, 0)"
    made = lengths(plan, mesh("One"), mesh("Handle", moved, place))
    assert made.settings.frames == 150


def test_a_pin_that_stays_leaves_the_length(plan) -> None:
    """A static transform may be sampled at every frame."""
    still = BESIDE.replace("(1, 0, 0)", "(0.9, 0, 0)")
    made = lengths(plan, mesh("One"), mesh("Handle", still))
    assert made.settings.frames < 100
    assert not noted(made, "as what is pinned moves")


def test_an_obstacle_beside_a_field_counts(plan) -> None:
    wall = mesh("Wall", LONG.replace("(0, 0, 0)", "(-5, 0, 0)"), apis=("PhysicsCollisionAPI",))
    made = lengths(plan, mesh("One"), wall, pins=(), fields=("wind:1,0,0",))
    assert made.settings.frames == 201
    assert noted(made, "201 frames are simulated, as an obstacle moves until time code 200.5:")


@pytest.mark.parametrize("samples", [1, 2])
def test_an_obstacle_counts_where_rest_would_take_too_long(
    monkeypatch, tmp_path: Path, samples: int
) -> None:
    """Also for the fraction of a frame in which it still moves."""
    monkeypatch.setattr("gf_usd.pipeline.prepared.REST_WORK", 100.0)
    wall = mesh("Wall", LONG.replace("(0, 0, 0)", "(-5, 0, 0)"), apis=("PhysicsCollisionAPI",))
    path = tmp_path / "asset.usda"
    path.write_text(head() + mesh("One") + wall, encoding="utf-8")
    made = gf_usd.inspect(path, particles=100, samples_per_frame=samples).plan
    assert made is not None
    assert made.settings.frames == 201
    assert noted(made, "201 frames are simulated, not until rest")
