"""What a bake says of its stages while it runs, without a terminal."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from gf_usd.cli.console import Lines, Spent, disk_of, frames_of, summarize, time_of
from gf_usd.pipeline.cost.forecast import (
    CHECKING,
    COMPILING,
    FILLING,
    READING,
    SIMULATING,
    Activity,
)
from gf_usd.pipeline.health.warnings import HealthWarning
from gf_usd.pipeline.result import BakeResult
from gf_usd.prepare.plan import Plan

HEALTH = (
    "restitution", "deepest_overlap_spacings", "rollbacks", "deepest_penetration_spacings",
    "deepest_penetration_m", "min_J", "max_J", "substeps",
)  # fmt: skip


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def frame(done: int, left: float = 40.0) -> Activity:
    return Activity(stage=SIMULATING, what="rubber", done=done, total=100, left=left)


def test_each_stage_has_a_line_and_every_tenth_of_the_frames() -> None:
    printed: list[str] = []
    lines = Lines(printed.append, Clock())
    for now in (
        Activity(stage=READING, what="duck.usda"),
        Activity(stage=FILLING),
        Activity(stage=SIMULATING, what="rubber", total=100),
        *(frame(k) for k in range(1, 22)),
        frame(100, 0.0),
        Activity(stage=CHECKING),
    ):
        lines(now)
    assert printed == [
        "simulating rubber",
        "simulating rubber: frame 10/100, about 40 s left",
        "simulating rubber: frame 20/100, about 40 s left",
        "simulating rubber: frame 100/100, about 0 s left",
        "checking",
    ]


def test_a_bake_that_ends_at_rest_has_frames_and_time_at_most() -> None:
    printed: list[str] = []
    lines = Lines(printed.append, Clock())
    lines(replace(frame(10), ends_early=True))
    assert printed == ["simulating rubber: frame 10 of at most 100, at most 40 s left"]
    forecast = {
        "frames": 100, "usual_frames": 60, "estimated_seconds": 50.0, "usual_seconds": 30.0,
        "most_seconds": 70.0, "usual_most_seconds": 44.0,
        "estimated_bytes": 2e6, "ends_early": True,
    }  # fmt: skip
    assert frames_of(forecast) == "at most 100 frames (usually about 60)"
    assert time_of(forecast) == "about 30 s, at most 50 s"
    assert disk_of(forecast) == "at most 2 MB"
    wide = forecast | {"most_seconds": 130.0, "usual_most_seconds": 46.0}
    assert time_of(wide) == "about 30 to 46 s, at most 2.2 minutes"
    forecast |= {"ends_early": False}
    assert (frames_of(forecast), time_of(forecast)) == ("100 frames", "about 50 s")
    assert disk_of(forecast) == "about 2 MB"


def test_what_takes_long_is_said_again() -> None:
    printed: list[str] = []
    clock = Clock()
    lines = Lines(printed.append, clock)
    lines(Activity(stage=READING, what="duck.usda"))
    for clock.now in (1.0, 4.0, 5.5, 20.0, 36.0):
        lines.tick()
    assert printed == ["reading duck.usda"] * 2
    lines(frame(3))
    clock.now = 67.0
    lines.tick()
    assert printed[2:] == ["simulating rubber: frame 3/100, about 40 s left"] * 2


def test_steps_of_the_fill_are_said_where_all_of_it_takes_long() -> None:
    printed: list[str] = []
    clock = Clock()
    lines = Lines(printed.append, clock)
    for clock.now, step in ((0.0, "(checking the meshes)"), (3.0, "(placing particles)")):
        lines(Activity(stage=FILLING, what=step))
    for clock.now in (4.0, 6.0, 7.0):
        lines.tick()
    assert printed == ["filling (placing particles)"]


def test_compiling_is_said_once() -> None:
    printed: list[str] = []
    lines = Lines(printed.append, Clock())
    for now in (frame(1), Activity(stage=COMPILING), frame(1), Activity(stage=COMPILING), frame(2)):
        lines(now)
    assert [line.partition(" (")[0] for line in printed[1:]] == ["compiling kernels"]


def test_every_second_belongs_to_a_stage() -> None:
    clock, shown = Clock(), []
    spent = Spent(shown.append, clock)
    for at, now in (
        (0.0, Activity(stage=READING)),
        (2.0, Activity(stage=SIMULATING)),
        (5.0, Activity(stage=COMPILING)),
        (9.0, Activity(stage=SIMULATING, done=1, total=2)),
        (10.0, Activity(stage=CHECKING)),
    ):
        clock.now = at
        spent(now)
    clock.now = 10.5
    assert (
        spent.text() == "10.5 s: reading 2.0, simulating 4.0, compiling kernels 4.0, checking 0.5"
    )
    assert len(shown) == 5


@pytest.mark.parametrize("done", [0, 5])
def test_a_frame_that_takes_minutes_is_not_silent(done: int) -> None:
    printed: list[str] = []
    clock = Clock()
    lines = Lines(printed.append, clock)
    lines(frame(done))
    for clock.now in range(0, 120, 10):
        lines.tick()
    assert len(printed) >= 4


@pytest.mark.parametrize(
    ("noted", "measured", "said"),
    [
        (("/Box",), ["/Box"], 0),
        (("/Box", "/Flows"), ["/Box"], 0),
        (("/Flows", "/Box"), ["/Box"], 0),
        (("/Other",), ["/Box"], 1),
        (("/BoxInside",), ["/Box"], 1),
        (("/Box",), ["/Cage", "/Box"], 1),
        ((), ["/Box"], 1),
    ],
)
def test_a_coarse_mesh_that_no_note_names_is_warned_of(
    capsys: pytest.CaptureFixture[str], noted: tuple[str, ...], measured: list[str], said: int
) -> None:
    """One note on any mesh took back the warnings on all others."""
    warning = HealthWarning(about="coarse-mesh", message="faces of </Box> are", hint="divide them")
    health = dict.fromkeys(HEALTH, 0.0) | {"outside_meshes": measured}
    one = SimpleNamespace(
        variant="rubber", clips=(), frames=2, at_rest=None, health=health, certificate=None,
        warnings=(warning,),
    )  # fmt: skip
    result = SimpleNamespace(bakes=(one,), outputs=(), particles=8, notes=(), findings=())
    plan = SimpleNamespace(notes=(), coarse=noted)
    summarize(cast(BakeResult, result), cast(Plan, plan), "1 s")
    assert capsys.readouterr().out.count("[coarse-mesh]") == said
