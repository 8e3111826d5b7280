"""Targets as texts, as points over time and as numbers of a motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gf_usd.core.errors import UsageError
from gf_usd.core.materials.presets import find_preset
from gf_usd.fitting.figures import FIGURES, Number, check_number, number
from gf_usd.fitting.observation import (
    Observation,
    Scene,
    TrackedPoints,
    load,
    save,
    vertices_as_points,
)
from gf_usd.fitting.read_targets import farthest_points
from gf_usd.fitting.targets import Motion, clusters, parse, residuals
from gf_usd.pipeline.measures.figures import Recorder

FPS = 24.0
TALL = 0.4  # [m] height at rest
SINK, DAMPED, FREQUENCY = 0.05, 3.0, 2.5  # [m], [1/s], [Hz]


def bar(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2, 3) places and velocities of the foot, which stands, and the top, which vibrates."""
    w = 2.0 * np.pi * FREQUENCY
    wave = np.exp(-DAMPED * t)
    y = TALL - SINK * (1.0 - wave * np.cos(w * t))
    rate = SINK * wave * (-DAMPED * np.cos(w * t) - w * np.sin(w * t))
    x, v = np.zeros((len(t), 2, 3)), np.zeros((len(t), 2, 3))
    x[:, 1, 1], v[:, 1, 1] = y, rate
    return x, v


def observation(frames: int = 49) -> Observation:
    t = np.arange(frames) / FPS
    x, v = bar(t)
    recorder = Recorder(np.array([0.0, 1.0, 0.0]), 0.0, np.array([0.0, -9.81, 0.0]))
    for k in range(frames):
        recorder.add(t[k], x[k], v[k], center=x[k].mean(0), velocity=v[k].mean(0), touching=True)
    return Observation(seconds=t, x=x, v=v, series=recorder.series())


def scene(unit: float = 1.0) -> Scene:
    return Scene(
        material=find_preset("rubber").material(0.1), radius=0.1, particles=100, fps=FPS,
        frames=49, start=1.0, time_codes_per_second=FPS, unit=unit, up=np.array([0.0, 1.0, 0.0]),
        floor=0.0, surfaces={"/bar": np.array([[0.0, 0.0, 0.0], [0.0, TALL, 0.0]])},
        triangles={"/bar": np.zeros((0, 3), int)}, lift=np.zeros(3), notes=(), identity="",
    )  # fmt: skip


def target_of(text: str) -> Number:
    found = parse(text)
    check_number(found)
    return number(found, scene())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("film.usda", {"file": Path("film.usda"), "sigma": None}),
        ("a b/film.USDC+-2%", {"file": Path("a b/film.USDC"), "sigma": 0.02, "share": True}),
        ("film.usd±0.003", {"file": Path("film.usd"), "sigma": 0.003, "share": False}),
        ("rebound=0.6", {"figure": "rebound", "value": 0.6, "time_code": None}),
        ("height=.15+-2e-3@12", {"value": 0.15, "sigma": 2e-3, "time_code": 12.0}),
        ("deflection=1:at=0,-1,2.5@3", {"position": (0.0, -1.0, 2.5), "time_code": 3.0}),
    ],
)
def test_a_text_is_taken_apart(text: str, expected: dict[str, object]) -> None:
    found = parse(text)
    assert {name: getattr(found, name) for name in expected} == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("film.mov", "is not a target"),
        ("rebound", "is not a target"),
        ("rebound=high", "is not a target"),
        ("rebound=0.6+-0", "above 0"),
        ("rebond=0.6", "did you mean rebound"),
        ("deflection=0.1", "add :at=X,Y,Z"),
        ("rebound=0.6:at=0,0,0", "leave out :at"),
        ("rebound=0.6@3", "leave out @3"),
        ("sag=0+-5%", "a standard deviation cannot be a share of 0"),
        ("height=0.4@0", "before the first frame"),
        ("deflection=0.1:at=5,0,0", "nearest vertex"),
    ],
)
def test_a_text_that_makes_no_sense_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        target_of(text)
    assert message in str(refused.value)


def test_lengths_are_in_stage_units_and_deviations_in_shares() -> None:
    centimeters = scene(unit=0.01)
    found = number(parse("height=40+-5%@13"), centimeters)
    assert (found.value, found.sigma, found.stated) == pytest.approx((0.4, 0.02, True))
    assert found.seconds == pytest.approx(0.5)
    assumed = number(parse("squash=0.4"), centimeters)
    assert (assumed.value, assumed.sigma, assumed.stated) == (0.4, 0.004, False)


def test_numbers_of_a_vibrating_bar() -> None:
    simulation = observation()
    # cubic Hermite: w^4 h^4 / 384 of the amplitude, with h = 1 / 24 s
    between = SINK * (2.0 * np.pi * FREQUENCY / FPS) ** 4 / 384.0
    place, _ = bar(np.array([0.27]))
    shown = target_of("height=0.4@7.48").simulated(simulation, 0)  # 0.27 s after time code 1
    assert shown == pytest.approx(place[0, 1, 1], abs=between)
    # half an amplitude e^(-3) remains on the later half, of which the window keeps little
    top = target_of("deflection=0.05:at=0,0.4,0")
    assert top.simulated(simulation, 1) == pytest.approx(SINK, abs=0.01 * SINK)
    assert target_of("settled_height=0.3").simulated(simulation, 0) == pytest.approx(
        TALL - SINK, abs=0.01 * SINK
    )
    # damping broadens the line by DAMPED / 2 pi = 0.5 Hz; its peak stays within a tenth of that
    wave = target_of("frequency=2:at=0,0.4,0").simulated(simulation, 1)
    assert wave == pytest.approx(FREQUENCY, abs=0.05)
    # the envelope is 5 % after ln(20) / DAMPED, and a last swing may end up to half a period early
    settled = target_of("settling_time=1").simulated(simulation, 0)
    assert np.log(20.0) / DAMPED - 0.5 / FREQUENCY <= settled <= np.log(20.0) / DAMPED + 1.0 / FPS


def test_what_a_motion_does_not_show_is_no_number() -> None:
    simulation = observation()  # which never lands
    for name in ("rebound", "first_contact_time"):
        assert np.isnan(FIGURES[name].of(simulation, 0, None)), name


def test_points_between_frames_and_residuals_of_what_was_seen() -> None:
    simulation = observation()
    times = np.array([0.1, 0.27, 1.5])
    x, _ = bar(times)
    x[1, 0] = np.nan  # the foot is hidden once
    target = Motion(
        name="film", tracked=(vertices_as_points("/bar", np.array([0, 1])),),
        seconds=times, x=x, sigma=1e-3,
        stated=True,
    )  # fmt: skip
    found = residuals([target, target_of("height=0.4@13")], simulation)
    assert len(found) == 3 * 2 * 3 - 3 + 1
    between = SINK * (2.0 * np.pi * FREQUENCY / FPS) ** 4 / 384.0
    assert np.abs(found[:-1]).max() < between / 1e-3
    points, at = clusters([target, target_of("height=0.4@13")])
    assert len(np.unique(points)) == 3
    assert len(np.unique(at)) == 4
    assert clusters([target_of("height=0.4@13"), target_of("squash=0.4")]) == []
    assert target.distance(simulation, 0) == pytest.approx(0.0, abs=between)


def test_a_followed_point_lies_within_its_triangle() -> None:
    third = np.full((1, 3), 1.0 / 3.0)
    point = TrackedPoints(path="/a", vertices=np.array([[0, 2, 3]]), weights=third)
    corners = np.array([[0.0, 0, 0], [9, 9, 9], [3, 0, 0], [0, 3, 0]])
    assert point.of(corners)[0] == pytest.approx([1.0, 1.0, 0.0])


def test_points_are_spread() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(10.0)] * 3), axis=-1).reshape(-1, 3)
    chosen = grid[farthest_points(grid, 8)]
    apart = np.linalg.norm(chosen[:, None] - chosen, axis=2)
    gap = apart[~np.eye(8, dtype=bool)].min()
    farthest = np.linalg.norm(grid[:, None] - chosen, axis=2).min(1).max()
    assert len(chosen) == 8
    assert farthest <= gap  # of points that are each the farthest from those before it
    assert len(farthest_points(grid[:5], 8)) == 5


def test_an_observation_is_kept_to_the_bit(tmp_path: Path) -> None:
    simulation = observation()
    save(tmp_path / "one.run", simulation)
    again = load(tmp_path / "one.run")
    assert np.array_equal(again.x, simulation.x)
    assert np.array_equal(again.series.high, simulation.series.high)
    (tmp_path / "cut.run").write_bytes((tmp_path / "one.run").read_bytes()[:900])
    with pytest.raises(ValueError):
        load(tmp_path / "cut.run")
