"""The guard that does not believe energy from nowhere, alone and in the solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solids import ball, look, settings

from gf_usd.errors import BakeError
from gf_usd.model import Health
from gf_usd.physics.guard import CALM_FRAMES, GAIN, RETRIES, Guard, energy
from gf_usd.physics.solver import TotalLagrangian

MOVING = Health(kinetic=50.0, elastic=30.0, potential=15.0, contact=5.0)


def test_energy_is_the_sum_of_its_four_parts():
    assert energy(MOVING) == 100.0


def test_a_frame_may_lose_energy_and_gain_rounding():
    guard = Guard(1.0)
    assert guard.judge(MOVING, replace(MOVING, kinetic=10.0)) == ""
    # The scale is what moves: 80 J kinetic and elastic.
    assert guard.judge(MOVING, replace(MOVING, kinetic=50.0 + 0.99 * GAIN * 80.0)) == ""
    said = guard.judge(MOVING, replace(MOVING, kinetic=50.0 + 1.01 * GAIN * 80.0))
    assert said == (
        "energy rose from 100 J to 101.6 J within the frame"
        " (at most 1.6 J is rounding and integration error)"
    )


def test_a_body_at_rest_is_measured_by_its_own_scale():
    rest = Health(potential=10.0)
    assert Guard(100.0).judge(rest, replace(rest, kinetic=1.9)) == ""
    assert "at most 2 J" in Guard(100.0).judge(rest, replace(rest, kinetic=2.1))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_energy_that_is_no_number_is_a_fault(bad):
    assert "energy rose" in Guard(1.0).judge(MOVING, replace(MOVING, elastic=bad))


def test_halvings_are_taken_back_after_calm_frames():
    guard = Guard(1.0)
    guard.refine()
    guard.refine()
    for _ in range(CALM_FRAMES - 1):
        guard.passed()
    assert guard.halvings == 2
    guard.passed()
    assert guard.halvings == 1
    guard.refine()  # trouble again: the calm frames count anew
    for _ in range(CALM_FRAMES):
        guard.passed()
    assert guard.halvings == 1


def vibrating(frames: int, factor: float) -> TotalLagrangian:
    """A rubber ball stretched at the start, with steps `factor` times the stable limit."""
    body, _ = ball(300)
    made = look("rubber", body, damping_time=0.0)

    def solver(**changes) -> TotalLagrangian:
        s = settings(frames=frames, fps=10.0, **changes)
        return TotalLagrangian(body, [made], s, velocity=lambda X: X * [2.0, -4.0, 2.0])

    limit = solver(safety=1.0)
    return solver(substeps=max(1, int(limit.frame_time / (factor * limit.step.dt))))


def test_a_step_beyond_the_limit_is_halved_until_the_frame_is_sound():
    solver = vibrating(12, 3.0)
    log = [f.health for f in solver.frames()]
    assert sum(h.rollbacks for h in log) >= 1
    assert max(h.substeps for h in log) >= 2 * solver.coarse
    assert max(energy(h) for h in log) <= energy(log[0]) * (1.0 + 12 * GAIN)
    # A rolled back frame leaves no trace: time and momentum are those of twelve frames.
    assert solver.time == pytest.approx(1.1)
    np.testing.assert_allclose(log[-1].momentum, 0.0, atol=1e-5 * log[0].mass)


def test_a_frame_beyond_help_ends_the_bake_in_words(monkeypatch):
    solver = vibrating(4, 0.5)
    monkeypatch.setattr(solver.guard, "judge", lambda last, now: "energy rose")
    frames = solver.frames()
    next(frames)
    with pytest.raises(BakeError) as caught:
        next(frames)
    assert caught.value.message.startswith(f"frame 1: energy rose, with {solver.coarse} substeps")
    assert f"after {RETRIES} halvings of the step" in caught.value.message
    assert "frames up to 0 are in the partial cache" in caught.value.hint


def test_a_state_that_is_no_number_is_located():
    solver = vibrating(3, 0.5)
    frames = solver.frames()
    next(frames)
    v = solver.arrays["v"].to_numpy()
    v[:3] = np.nan
    solver.arrays["v"].from_numpy(v)
    with pytest.raises(BakeError) as caught:
        next(frames)
    assert "grid nodes are no longer finite, first near particle" in caught.value.message
