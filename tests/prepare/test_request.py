"""From options to settings, and the words for options that make no sense."""

from __future__ import annotations

import math

import numpy as np
import pytest
from solids import facts

from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import Settings
from gf_usd.core.units import StageUnits
from gf_usd.prepare.fill.notes import rate_notes
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.texts import parse_drop
from gf_usd.prepare.settings import (
    PAPER_FRAMES,
    PAPER_T,
    floor_plane,
    gravity_vector,
    resolve,
    time_scale_of,
)

UP = np.array([0.0, 1.0, 0.0])
ABOVE = "give a number above 0"
LENGTH = "give a length such as 2.5 (stage units) or 3r (radii of the body)"
GRAVITY = "give 9.81 (m/s^2, downward), three numbers x,y,z, or a .csv or .txt file"
SCALE = "give a number such as 0.2 (five times slower), or auto"

# options, message, hint
REFUSED = [
    ({"particles": 0}, "--particles is 0", ABOVE),
    ({"particles": -3}, "--particles is -3", ABOVE),
    ({"spacing": 0.0}, "--spacing is 0", ABOVE),
    ({"spacing": math.nan}, "--spacing is nan", ABOVE),
    ({"spacing": math.inf}, "--spacing is inf", ABOVE),
    ({"frames": 0}, "--frames is 0", ABOVE),
    ({"fps": -24.0}, "--fps is -24", ABOVE),
    ({"threads": 0}, "--threads is 0", "give a number from 1 to 1024"),
    ({"threads": 100000}, "--threads is 100000", "give a number from 1 to 1024"),
    ({"filter_rate": -1.0}, "--filter-rate is -1", "give a number of 0 or more"),
    ({"filter_rate": math.nan}, "--filter-rate is nan", "give a number of 0 or more"),
    ({"drag": math.inf}, "--drag is inf", "give a number from 0 to 1e+06"),
    ({"damping_time": -0.5}, "--damping-time is -0.5", "give a number from 0 to 1e+06"),
    ({"friction": 101.0}, "--friction is 101", "give a number from 0 to 100"),
    ({"restitution": 1.5}, "--restitution is 1.5", "give a number from 0 to 1"),
    ({"preset": "fast"}, "there is no preset 'fast'", "the only preset is paper"),
    ({"skin": "glue"}, "there is no skin 'glue'", "choose embed, idw, paper"),
    (
        {"particles": 100, "spacing": 0.5},
        "--particles 100 and --spacing 0.5 were both given",
        "give one: the number of particles follows from the spacing",
    ),
    ({"device": "tpu"}, "there is no device 'tpu'", "choose cpu or cuda"),
    ({"seed": -1}, "--seed is -1", "give a number from 0 to 2147483647"),
    ({"start": math.nan}, "--start is nan", "give a finite time code"),
    ({"time_scale": "slow"}, "--time-scale: 'slow' is not a number", SCALE),
    ({"time_scale": "inf"}, "--time-scale: 'inf' is not a number", SCALE),
    ({"time_scale": "0"}, "--time-scale is 0", "give a number above 0, or auto"),
    ({"drop": "high"}, "--drop: 'high' is not a number", LENGTH),
    ({"drop": "r"}, "--drop: '' is not a number", LENGTH),
    ({"drop": "-1"}, "--drop is -1", "give a length of 0 or more"),
    ({"drop": "-2r"}, "--drop is -2r", "give a length of 0 or more"),
    ({"gravity": "1,2"}, "--gravity is '1,2'", GRAVITY),
    ({"gravity": "down"}, "--gravity: 'down' is not a number", GRAVITY),
    ({"gravity": "0,nan,0"}, "--gravity: 'nan' is not a number", GRAVITY),
    ({"gravity": ""}, "--gravity: '' is not a number", GRAVITY),
]


@pytest.mark.parametrize(("options", "message", "hint"), REFUSED)
def test_options_that_make_no_sense(options: dict, message: str, hint: str) -> None:
    with pytest.raises(UsageError) as caught:
        Request(**options).check()
    assert (caught.value.message, caught.value.hint) == (message, hint)


def test_sensible_options_pass() -> None:
    Request().check()
    Request(
        particles=1, frames=1, fps=0.5, filter_rate=math.inf, drag=0.0, friction=0.0,
        restitution=1.0, drop="0r", gravity="0", time_scale="auto", preset="paper", skin="idw",
        start=-10.0, device="cuda", threads=1,
    ).check()  # fmt: skip


def gravity_of(text: str | None) -> tuple[float, float, float]:
    """[m/s^2] that a text states."""
    return gravity_vector(Request(gravity=text).parsed["gravity"], UP)


def settled(
    radius: float = 1.0, lowest: float = 0.0, stage_facts: StageFacts | None = None, **options
):
    """The settings of a request on a body."""
    return resolve(Request(**options), stage_facts or facts(), radius, lowest)


def height(settings: Settings) -> float:
    """[m] along the up axis that the asset is lifted by."""
    return float(np.dot(settings.lift, settings.up))


def test_a_stage_that_says_nothing_gets_the_defaults() -> None:
    s = settled(radius=9.81, lowest=-2.0)  # T = 1 s
    assert (s.fps, s.time_codes_per_second, s.start) == (24.0, 24.0, 1.0)
    # 13.6 T are 326.4 intervals; one more frame for their beginning.
    assert s.frames == 328
    assert s.gravity == (0.0, -9.81, 0.0)
    assert s.floor == 0.0
    assert height(s) == pytest.approx(3.0 * 9.81 + 2.0)
    assert s.filter_rate == 10.0
    assert (s.drag, s.time_scale, s.skin, s.seed) == (0.0, 1.0, "embed", 0)
    assert s.substeps is s.cell is s.contact_rate is None
    assert s.followers
    assert s.sampling == "strata"


def test_what_the_stage_says_is_kept() -> None:
    stage_facts = facts(time_codes_per_second=48.0, start_time_code=101.0, up_axis="Z")
    s = settled(stage_facts=stage_facts)
    assert (s.fps, s.time_codes_per_second, s.start) == (48.0, 48.0, 101.0)
    assert s.up == (0.0, 0.0, 1.0)
    assert s.gravity == (0.0, 0.0, -9.81)
    assert s.lift == (0.0, 0.0, 3.0)
    # Minus zero would be written to files as such.
    assert not any(np.signbit(s.gravity[:2]))


def test_frames_of_playback_lie_time_codes_apart() -> None:
    stage_facts = facts(time_codes_per_second=48.0, frames_per_second=24.0, start_time_code=1.0)
    s = settled(stage_facts=stage_facts)
    assert (s.fps, s.time_codes_per_second, s.time_code(1)) == (24.0, 48.0, 3.0)
    assert settled(stage_facts=stage_facts, fps=48.0).fps == 48.0


def test_time_codes_that_are_hardly_frames_are_named() -> None:
    """A stage with the step of its simulator, 1 ms, as the time code got 5,000 frames, 4 GB."""
    stage_facts = facts(time_codes_per_second=1000.0)
    (note,) = rate_notes(stage_facts, settled(stage_facts=stage_facts), None)
    assert note.startswith("1000 frames per second are written, one for each time code")
    assert note.endswith("--fps 24 writes fewer")
    for fps, said in ((24.0, {}), (None, {"frames_per_second": 1000.0}), (None, {"codes": 48.0})):
        codes = said.pop("codes", 1000.0)
        other = facts(time_codes_per_second=codes, **said)
        assert rate_notes(other, settled(stage_facts=other, fps=fps), fps) == ()


@pytest.mark.parametrize(("codes", "frames", "step"), [(23.976, 23.976, 1), (59.94, 29.97, 2)])
def test_time_codes_of_film_rates_are_whole(codes: float, frames: float, step: int) -> None:
    """47 * 23.976 / 23.976 is 46.99999999999999: the last sample was before endTimeCode."""
    stage_facts = facts(
        time_codes_per_second=codes, frames_per_second=frames, start_time_code=-10.0
    )
    s = settled(stage_facts=stage_facts)
    assert [s.time_code(k) for k in range(240)] == [-10.0 + step * k for k in range(240)]


def test_options_win_over_the_stage() -> None:
    stage_facts = facts(time_codes_per_second=48.0, start_time_code=101.0)
    s = settled(
        stage_facts=stage_facts, fps=30.0, start=0.0, frames=7, gravity="1.62", drag=0.25, seed=3
    )
    assert (s.fps, s.time_codes_per_second, s.start, s.frames) == (30.0, 48.0, 0.0, 7)
    assert s.gravity == (0.0, -1.62, 0.0)
    assert (s.drag, s.seed) == (0.25, 3)


def test_drop_in_stage_units_and_in_radii() -> None:
    stage_facts = facts(units=StageUnits(meters_per_unit=0.01))
    assert height(
        settled(radius=0.5, lowest=0.25, stage_facts=stage_facts, drop="200")
    ) == pytest.approx(1.75)
    assert height(
        settled(radius=0.5, lowest=0.25, stage_facts=stage_facts, drop="2r")
    ) == pytest.approx(0.75)


def test_a_stage_with_physics_stays_where_it_is() -> None:
    # A physics stage has placed its things: they fall from there, but not from below the floor.
    stage_facts = facts(says_physics=True)
    assert height(settled(lowest=0.5, stage_facts=stage_facts)) == 0.0
    assert height(settled(lowest=0.5, stage_facts=stage_facts, floor="0.2")) == 0.0
    assert height(settled(lowest=-0.5, stage_facts=stage_facts)) == pytest.approx(0.5)
    assert height(settled(lowest=0.1, stage_facts=stage_facts, floor="0.2")) == pytest.approx(0.1)
    assert height(settled(lowest=-0.5, stage_facts=stage_facts, floor="none")) == 0.0
    assert height(settled(lowest=0.5, stage_facts=stage_facts, drop="1r")) == pytest.approx(0.5)
    assert height(settled(lowest=0.5, stage_facts=stage_facts, drop="0")) == pytest.approx(-0.5)


def test_rates_are_in_units_of_the_body() -> None:
    small, large = settled(radius=0.0981), settled(radius=9.81)  # T = 0.1 s and 1 s
    assert small.filter_rate == pytest.approx(100.0)
    assert large.filter_rate == pytest.approx(10.0)
    assert settled(radius=9.81, filter_rate=2.5).filter_rate == pytest.approx(2.5)
    assert settled(filter_rate=math.inf).filter_rate == math.inf
    assert settled(filter_rate=0.0).filter_rate == 0.0


def test_auto_plays_every_size_like_a_meter() -> None:
    small, meter = settled(radius=0.01, time_scale="auto"), settled(time_scale="auto")
    # T of a centimeter is a tenth of that of a meter: ten times slower.
    assert small.time_scale == pytest.approx(0.1)
    assert meter.time_scale == pytest.approx(1.0)
    assert small.frames == meter.frames
    assert settled(radius=0.01).frames < small.frames
    assert settled(time_scale="0.5").time_scale == 0.5
    assert time_scale_of(None, PAPER_T) == 1.0


@pytest.mark.parametrize("radius", [0.025, 1.0, 5.0])
def test_the_paper_s_set_up_scales_with_the_body(radius: float) -> None:
    s = settled(radius=radius, preset="paper")
    T = math.sqrt(radius / 9.81)
    assert (s.frames, s.substeps, s.sampling) == (PAPER_FRAMES, 10, "rejection")
    assert (s.skin, s.followers, s.filter_rate) == ("paper", False, math.inf)
    assert s.cell == pytest.approx(radius / 4.0)
    # 60 frames per second, drag 0.5 /s and k/m = 2000 /s^2 are those of r = 1 m, T = 0.3193 s.
    assert s.fps * T == pytest.approx(60.0 * 0.31928, rel=1e-4)
    assert s.drag * T == pytest.approx(0.5 * 0.31928, rel=1e-4)
    assert s.contact_rate == pytest.approx(2000.0 * 0.31928**2 / T**2, rel=1e-4)
    # the step then is the same part of the body's own time at every size
    assert s.time_scale / s.fps / T == pytest.approx(1.0 / (60.0 * 0.31928), rel=1e-4)


def test_options_win_over_the_paper() -> None:
    s = settled(preset="paper", frames=5, fps=24.0, drag=0.0, filter_rate=1.0, skin="embed")
    assert (s.frames, s.fps, s.drag, s.skin) == (5, 24.0, 0.0, "embed")
    assert s.filter_rate == pytest.approx(1.0 / PAPER_T)
    # the paper drops its body even onto a stage with physics
    assert height(settled(stage_facts=facts(says_physics=True), preset="paper")) == pytest.approx(
        3.0
    )


def test_what_is_written_and_where_it_runs_is_handed_on() -> None:
    s = settled(stress=True, deformation_gradients=True, device="cuda", threads=2)
    assert s.stress
    assert s.deformation_gradients
    assert (s.device, s.threads) == ("cuda", 2)


def test_gravity_as_a_vector_ignores_the_up_axis() -> None:
    assert gravity_of("1,-2,3e0") == (1.0, -2.0, 3.0)
    assert gravity_of(" 9 ") == (0.0, -9.0, 0.0)
    assert gravity_of("-9") == (0.0, 9.0, 0.0)
    assert gravity_of(None) == (0.0, -9.81, 0.0)
    assert gravity_of("0") == (0.0, 0.0, 0.0)


def test_lengths() -> None:
    assert parse_drop("2.5").meters(3.0, 0.01) == pytest.approx(0.025)
    assert parse_drop("2.5r").meters(3.0, 0.01) == pytest.approx(7.5)
    assert parse_drop("0").meters(3.0, 0.01) == 0.0


@pytest.mark.parametrize(
    ("text", "distance", "normal"),
    [
        (None, 0.0, (0, 1, 0)),
        ("none", None, (0, 1, 0)),
        ("1.5", 0.15, (0, 1, 0)),
        ("0,2,0", 0.0, (0, 1, 0)),
        ("3,4,0", 0.0, (0.6, 0.8, 0)),
        ("-2:3,4,0", -0.16, (0.6, 0.8, 0)),  # 0.2 m below, seen along the normal
    ],
)
def test_floors(text: str | None, distance: float | None, normal: tuple) -> None:
    at, n = floor_plane(Request(floor=text).parsed["floor"], UP, 0.1)
    assert at == (None if distance is None else pytest.approx(distance))
    np.testing.assert_allclose(n, normal)


@pytest.mark.parametrize("text", ["low", "1,2", "1,2,x", "0,0,0", "0,-1,0", "1,0.05,0", "nan"])
def test_what_is_no_floor_is_refused(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        Request(floor=text).check()
    assert "--floor" in caught.value.message
    assert caught.value.hint


def test_a_floor_points_up_where_the_asset_has_up() -> None:
    request = Request(floor="0.5:0,0.6,0.8")
    request.check()  # before the asset is read either axis may be up
    at, n = floor_plane(request.parsed["floor"], np.array([0.0, 0.0, 1.0]), 1.0)
    assert at == pytest.approx(0.4)
    np.testing.assert_allclose(n, (0.0, 0.6, 0.8))
    with pytest.raises(UsageError, match="the normal 0,1,0 does not point up"):
        floor_plane(Request(floor="0,1,0").parsed["floor"], np.array([0.0, 0.0, 1.0]), 1.0)


def test_a_text_is_parsed_once() -> None:
    request = Request(clamp="0.5:2", drop="3r")
    assert request.parsed is request.parsed
    assert request.parsed["clamp"] == (0.5, 2.0)
    assert (request.parsed["drop"].value, request.parsed["drop"].in_radii) == (3.0, True)
    assert request.parsed["floor"] is None
    with pytest.raises(UsageError, match="--drop: '' is not a number"):
        Request(drop="").check()


def test_a_body_falls_onto_a_tilted_floor_by_as_much_as_was_asked() -> None:
    made = settled(floor="3,4,0", drop="2")
    # lowest = 0 along the normal: 2 m straight down is 1.6 m along it
    assert np.dot(made.lift, made.normal) == pytest.approx(1.6)
    assert made.floor_normal == pytest.approx((0.6, 0.8, 0.0))


def test_what_is_pinned_or_has_no_floor_stays_where_it_is() -> None:
    assert settled(lowest=0.7, pins=("/A",)).lift == (0.0, 0.0, 0.0)
    assert settled(lowest=0.7, floor="none").lift == (0.0, 0.0, 0.0)
    assert settled(lowest=0.7, floor="none", drop="2").lift == (0.0, 2.0, 0.0)
    assert settled(lowest=0.7, pins=("/A",), drop="2").lift == pytest.approx((0.0, 1.3, 0.0))
