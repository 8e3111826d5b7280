"""What a bake reports of its time while it runs, and where it ends."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from traceback import extract_tb
from typing import Any

import pytest

import gf_usd
from gf_usd.core.errors import OutOfResources, SolverError
from gf_usd.physics.total_lagrangian import launch
from gf_usd.pipeline.cost import forecast as forecasts
from gf_usd.pipeline.cost.forecast import Forecast
from gf_usd.pipeline.run import run as runs

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def cost(seconds: float, *names: str) -> dict[str, Any]:
    """Of 100 samples of 100 substeps at rest each."""
    rows = [
        {"name": name, "seconds": seconds, "substeps_per_sample": 100.0}
        for name in names or ("clay",)
    ]
    return {"per_material": rows, "estimated_seconds": seconds * len(rows)}


def follow(
    made: Forecast,
    clock: Clock,
    substeps: list[int],
    each: float,
    first: int = 0,
    material: int = 0,
) -> None:
    """Samples of so many substeps, of each [s]."""
    following = [*substeps[1:], substeps[-1]]
    for k, (now, then) in enumerate(zip(substeps, following)):
        clock.now += each * now
        made.record_sample(material, first + k, now, then)


def test_a_bake_as_long_as_estimated_is_no_news() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 1.0, clock=clock)
    follow(made, clock, [100] * 100, 0.01 * 1.9)
    assert made.take_remarks() == ()


def test_a_shrinking_step_is_reported_once_with_its_reason() -> None:
    clock, remarks = Clock(), []
    made = Forecast(cost(100.0), 100, 1.0, clock=clock, remark=remarks.append)
    follow(made, clock, [100] * 10 + [400] * 90, 0.01)
    (line,) = made.take_remarks()
    assert remarks == [line]
    assert "not 100 s: in its current strain clay takes " in line
    assert line.endswith("substeps where it took 100 at rest")
    seconds = float(line.split("about ")[1].split(" minutes")[0]) * 60.0
    assert 200.0 <= seconds <= 380.0  # 10 of 100 substeps and 90 of 400, each of .01 s: 370 s
    assert made.take_remarks() == ()


def test_a_bake_that_may_end_at_rest_takes_at_most_that_long() -> None:
    clock = Clock()
    made = Forecast({**cost(100.0), "ends_early": True}, 100, 1.0, clock=clock)
    follow(made, clock, [100] * 10 + [400] * 40, 0.01)
    (line,) = made.take_remarks()
    assert line.startswith("the bake will take at most ")


@pytest.mark.parametrize(("after", "reported"), [(20, False), (90, True)])
def test_a_complete_bake_reports_its_time_and_not_the_estimate(after: int, reported: bool) -> None:
    """A table came to rest after 64 s, and its last lines predicted 6 minutes."""
    clock = Clock()
    made = Forecast({**cost(100.0), "ends_early": True}, 100, 1.0, clock=clock)
    follow(made, clock, [100] * 10 + [400] * after, 0.01)
    expected = (
        "the bake took 6.17 minutes, not at most 100 s: strained, clay took 400 substeps where it"
        " took 100 at rest",
    )
    assert made.take_outcome() == (expected if reported else ())
    assert made.take_remarks() == ()


def test_a_complete_bake_as_long_as_estimated_reports_nothing() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 1.0, clock=clock)
    follow(made, clock, [100] * 100, 0.01)
    clock.now += 200.0  # of writing
    assert made.take_outcome() == ()


def test_the_estimate_is_reported_again_when_it_doubles_again() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 100.0, clock=clock)
    follow(made, clock, [100] * 10 + [400] * 30 + [3000] * 60, 0.01)
    assert len(made.take_remarks()) == 2  # about 4 and 20 times as long, each once it lasts


def test_a_peak_at_the_impact_is_no_surprise() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 1.0, clock=clock)
    follow(made, clock, [100] * 10 + [900] + [100] * 89, 0.01)
    assert made.take_remarks() == ()


def test_an_impact_of_ten_frames_is_no_surprise() -> None:
    """Substeps of a jelly penguin from frame 16 on: 45 minutes were announced, it took three."""
    clock = Clock()
    landing = [31, 32, 129, 503, 1267, 1289, 1346, 2505, 1667, 6292, 2937, 656, 462, 374, 192, 126]
    made = Forecast(
        {"per_material": [{"name": "jelly", "seconds": 288.0, "substeps_per_sample": 31.0}],
         "estimated_seconds": 288.0},
        745, 1.0, clock=clock,
    )  # fmt: skip
    follow(made, clock, landing + [100] * 60, 0.0036, first=16)
    assert made.take_remarks() == ()


def test_contact_that_divides_substeps_counts_from_the_third_sample_on() -> None:
    """A pot with its lid took 514 substeps where its strain required 240: forecasts were of 240."""
    clock = Clock()
    made = Forecast(cost(100.0), 100, 1.0, clock=clock)
    forecasts = []
    for k in range(50):
        clock.now += 2.14
        made.record_sample(0, k, 214, 100)
        forecasts.append(clock.now + made.left)
    # the first sample also builds the solver, and that after it is of unknown strain
    assert forecasts[3:] == pytest.approx([214.0] * 47, rel=1e-9)


def test_a_foreseen_stretch_is_in_the_forecast_before_it_comes() -> None:
    """Substeps of a lamp on a cable of rubber grow from its fifth of the frames on."""
    clock = Clock()
    profile = [1.0, 1.0, 2.0, 4.0, 6.0, 8.0, 8.0, 6.0, 4.0, 2.0]
    whole = cost(420.0)
    whole["per_material"][0]["strain_profile"] = profile
    made, known = Forecast(whole, 100, 1.0, clock=clock), []
    for k in range(100):
        many = round(100 * profile[max(0, k - 1) * 10 // 100])
        clock.now += 0.01 * many
        made.record_sample(0, k, many, round(100 * profile[min(98, k) * 10 // 100]))
        known.append(clock.now + made.left)
    # within the tolerance of what is announced, throughout; without the profile a quarter of it
    assert min(known[4:]) > 420.0 / forecasts.ANNOUNCED
    assert max(known[4:]) < 420.0 * forecasts.ANNOUNCED
    assert made.take_remarks() == ()


def test_a_slow_machine_is_distinguished_from_a_short_step() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 1.0, clock=clock)
    follow(made, clock, [100] * 100, 0.05)
    (line,) = made.take_remarks()
    assert "other programs may be using this machine" in line


def test_short_bakes_and_frames_without_substeps_say_nothing() -> None:
    clock = Clock()
    short = Forecast(cost(5.0), 100, 1.0, clock=clock)
    follow(short, clock, [100] * 100, 0.005)  # ten times as long: 50 s
    assert short.take_remarks() == ()
    asleep = Forecast(cost(100.0), 100, 1.0, clock=clock)
    follow(asleep, clock, [0] * 100, 1.0)
    assert asleep.take_remarks() == ()


def test_the_materials_that_follow_count_as_estimated() -> None:
    clock = Clock()
    made = Forecast(cost(100.0, "clay", "dented"), 100, 1.0, clock=clock)
    follow(made, clock, [100] * 100, 0.01 * 2.5)
    assert made.take_remarks() == ()  # 250 s and 100 s, of 200 s
    follow(made, clock, [100] * 100, 0.01 * 2.5, material=1)
    (line,) = made.take_remarks()
    assert "not 3.33 minutes" in line


def test_it_ends_at_twice_the_hours_that_it_may_take() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 0.1, resume_hint="go on", clock=clock)
    with pytest.raises(OutOfResources) as caught:
        follow(made, clock, [100] * 100, 0.09)  # 900 s of 720 s
    assert caught.value.frame == 81, "the first that could not be had"
    assert "the bake has taken 12.2 minutes, and --max-hours 0.1 allows at most 12" in str(
        caught.value.message
    )
    assert "19 of 100 frames are left" in caught.value.message
    assert "go on" in caught.value.hint
    (line,) = made.take_remarks()
    assert line.endswith("; it ends after 12 minutes, twice --max-hours")


def test_it_ends_within_a_frame_that_takes_too_long() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 0.1, clock=clock)
    made.begin(0, 19)
    follow(made, clock, [100] * 5, 0.01, first=20)
    clock.now = 719.0
    made.require()
    clock.now = 721.0
    with pytest.raises(OutOfResources, match="75 of 100 frames are left") as caught:
        made.require()
    assert caught.value.frame == 25


@pytest.mark.slow
def test_a_frame_that_is_cut_leaves_what_can_be_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each reading of the clock takes a second, and each substep is a launch with a reading."""
    seconds = iter(range(100_000))
    options: dict[str, Any] = {
        "material": "rubber", "output": f"{tmp_path}/", "particles": 100, "frames": 5,
        "drop": "0.05r", "clip_frames": 1,
    }  # fmt: skip
    with monkeypatch.context() as patched:
        patched.setattr(launch, "LAUNCH_SECONDS", 1e-9)
        patched.setattr(runs, "Forecast", partial(Forecast, clock=lambda: float(next(seconds))))
        with pytest.raises(SolverError, match=r"max_hours=0\.003 allows at most 22 s") as caught:
            gf_usd.bake(str(SPHERE), **options, max_hours=0.003)
    assert next(seconds) in (22, 23), "at once: a frame has eight substeps and more"
    ended = caught.value.__cause__
    assert ended is not None
    assert "launch.py" in {Path(at.filename).name for at in extract_tb(ended.__traceback__)}
    assert 0 < caught.value.frame < 4
    assert list(tmp_path.glob("*.checkpoint.npz"))
    result = gf_usd.bake(str(SPHERE), **options, resume=True)
    assert len(result.bakes[0].per_frame) == 5
    assert any("continues after frame" in note for note in result.notes)


def test_the_last_frame_is_never_too_late() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 0.1, clock=clock)
    follow(made, clock, [100] * 99, 0.0)
    clock.now = 1e6
    made.record_sample(0, 99, 100, 100)


def test_a_bake_that_is_too_long_leaves_its_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forecasts, "OVERRUN", 0.0)
    with pytest.raises(SolverError, match="max_hours=1 allows at most"):
        gf_usd.bake(str(SPHERE), material="clay", output=f"{tmp_path}/", particles=100, frames=6)
    assert list(tmp_path.glob("*.cache.partial.usdc"))
    assert list(tmp_path.glob("*.report.json"))


def test_the_time_left_follows_the_frames_so_far() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 1.0, clock=clock)
    assert made.left == 100.0
    follow(made, clock, [100] * 20, 0.03)  # 3 s a sample
    assert made.left == pytest.approx(80 * 3.0)
    follow(made, clock, [100] * 80, 0.03, first=20)
    assert made.left == 0.0


def test_frames_in_flight_say_nothing_of_those_after_the_landing() -> None:
    clock, forecast = Clock(), cost(100.0)
    forecast["per_material"][0] |= {
        "flying_samples": 50, "sample_seconds": 0.01, "moving_seconds": 1.0, "end_seconds": 2.0,
    }  # fmt: skip
    made = Forecast(forecast, 100, 1.0, clock=clock)
    for index in range(21):
        clock.now += 0.01
        made.record_sample(0, index, 0, 100)
    assert made.left == pytest.approx(30 * 0.01 + 49 * 1.0 + 2.0)


def test_compiling_is_no_pace() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 1.0, clock=clock)
    follow(made, clock, [100] * 5, 0.01)
    made.compile(True)
    clock.now += 60.0
    made.compile(False)
    follow(made, clock, [100] * 5, 0.01, first=5)
    assert made.left == pytest.approx(90.0)
    assert made.take_remarks() == ()


def test_long_frames_are_judged_sooner() -> None:
    clock = Clock()
    made = Forecast(cost(100.0), 100, 100.0, clock=clock)
    follow(made, clock, [100] * 8, 1.0)  # 100 s a sample, where 1 s was estimated
    assert len(made.take_remarks()) == 1
