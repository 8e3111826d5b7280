"""Figures of motions whose answers are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gf_usd.pipeline.measures.figures import (
    Recorder,
    figures,
    first_contact,
    highest_rebound,
    minimum,
)

UP, G = np.array([0.0, 1.0, 0.0]), np.array([0.0, -9.81, 0.0])
DT = 1.0 / 24.0
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FLIGHT, PUSH = 0.3, 0.1  # [s] of the fall, and of the contact


def bounce(times, floor=0.0, squash=0.2, spin=0.0):
    """A cube that falls for 0.3 s, is squashed as sin^2 for 0.1 s, and leaves half as fast.

    Yields (time, points, velocities, center, velocity, touching).
    """
    speed = 9.81 * FLIGHT
    for t in times:
        turn = Rotation.from_rotvec([0.0, 0.0, spin * t])
        start = 0.5 + 0.5 * 9.81 * FLIGHT**2
        if t < FLIGHT:
            y, v, s, rate = start - 0.5 * 9.81 * t * t, -9.81 * t, 0.0, 0.0
        elif t < FLIGHT + PUSH:
            phase = np.pi * (t - FLIGHT) / PUSH
            s, rate = squash * np.sin(phase) ** 2, squash * np.sin(2.0 * phase) * np.pi / PUSH
            y, v = 0.5 - 0.5 * s, -0.5 * rate
        else:
            u = t - FLIGHT - PUSH
            v = 0.5 * speed - 9.81 * u
            y, s, rate = 0.5 + 0.5 * speed * u - 0.5 * 9.81 * u * u, 0.0, 0.0
        center, velocity = y * UP + floor * UP, v * UP
        r = turn.apply(CUBE * [1.0, 1.0 - s, 1.0])
        moving = np.cross([0.0, 0.0, spin], r) - np.outer(CUBE[:, 1] * rate, UP)
        yield t, center + r, velocity + moving, center, velocity, FLIGHT < t < FLIGHT + PUSH + DT


def record(rows, floor=0.0):
    recorder = Recorder(UP, floor, G)
    for t, x, v, c, w, touching in rows:
        recorder.add(t, x, v, center=c, velocity=w, touching=touching)
    return recorder.series()


@pytest.mark.parametrize("floor", [0.0, -2.0])
def test_a_bounce_is_read_between_the_frames(floor):
    fine = DT / 4.0
    found = figures(record(bounce(np.arange(0.0, 0.7, fine), floor=floor), floor))
    # free flight and the top of a parabola are exact in a cubic
    assert found["first_contact_time"] == pytest.approx(FLIGHT, abs=1e-9)
    assert found["first_contact_place"] == pytest.approx([0.0, floor, 0.0], abs=1e-9)
    assert found["rebound"] == pytest.approx((0.5 * 9.81 * FLIGHT) ** 2 / 2.0 / 9.81, abs=1e-9)
    # s sin^2 has fourth derivatives up to s / 2 (2 pi / T)^4; dt^4 / 384 of them
    error = fine**4 / 384.0 * 0.5 * 0.2 * (2.0 * np.pi / PUSH) ** 4
    assert found["least_height"] == pytest.approx(0.8, abs=error)
    assert found["squash"] == pytest.approx(0.2, abs=error)
    assert found["sag"] is None
    assert found["settled_height"] is None


def test_a_body_that_turns_upright_is_not_said_to_be_squashed():
    """A plate that lands flat and stands on its edge for the rest of the contact."""
    flat = CUBE * [1.0, 0.2, 1.0]
    rows = []
    for t in np.arange(0.0, 0.5, DT):
        landed = t >= FLIGHT
        y = 0.1 + (0.0 if landed else 0.5 * 9.81 * (FLIGHT**2 - t * t))
        v = np.zeros(3) if landed else -9.81 * t * UP
        r = flat[:, [1, 0, 2]] + 0.4 * UP if landed else flat
        rows.append((t, y * UP + r, np.broadcast_to(v, r.shape), y * UP, v, landed))
    found = figures(record(rows))
    assert found["least_height"] is not None
    assert found["least_height"][0] > np.ptp(flat[:, 1])
    assert found["squash"] is None


def test_a_body_that_spins_lands_on_the_corner_that_comes_first():
    spin = 2.0
    rows = list(bounce(np.arange(0.0, FLIGHT, DT), spin=spin))
    late = list(bounce([FLIGHT + 0.01], spin=spin))
    late = [(t, x - 0.3 * UP, v, c, w, True) for t, x, v, c, w, _ in late]
    found = figures(record([*rows, *late]))
    # the time at which the lowest corner is at 0, by bisection
    low, high = 0.0, FLIGHT
    for _ in range(60):
        t = 0.5 * (low + high)
        ((_, x, *_),) = bounce([t], spin=spin)
        low, high = (t, high) if x[:, 1].min() > 0.0 else (low, t)
    assert found["first_contact_time"] == pytest.approx(low, abs=1e-9)
    ((_, x, *_),) = bounce([low], spin=spin)
    lowest = x[x[:, 1] <= x[:, 1].min() + 1e-9].mean(0)
    assert found["first_contact_place"] == pytest.approx(lowest, abs=1e-8)


def test_what_is_touched_in_the_air_is_no_landing():
    rows = list(bounce(np.arange(0.0, 0.2, DT)))
    rows[-1] = (*rows[-1][:5], True)
    series = record([*rows, *bounce(np.arange(0.3, 0.6, DT))])
    assert series.landing is None
    assert first_contact(series)[0] == len(rows) - 1
    assert figures(series)["first_contact_time"] is None
    assert figures(series)["rebound"] is None


def test_a_body_that_starts_below_the_floor_does_not_land():
    found = figures(record(bounce(np.arange(FLIGHT + 0.01, 0.7, DT))))
    assert found["first_contact_time"] is None


def test_a_top_after_the_last_frame_is_that_of_free_flight():
    found = figures(record(bounce(np.arange(0.0, FLIGHT + PUSH + 3.0 * DT, DT))))
    assert found["rebound"] == pytest.approx((0.5 * 9.81 * FLIGHT) ** 2 / 2.0 / 9.81, abs=1e-9)


def test_no_rebound_is_higher_than_the_energy():
    recorder = Recorder(UP, 0.0, G)
    recorder.weight = 2.0 * 9.81
    for t, x, v, c, w, touching in bounce(np.arange(0.0, 0.7, DT)):
        recorder.add(t, x, v, center=c, velocity=w, touching=touching, kinetic=2.0 * 0.5 * w @ w)
    fall = 0.5 * 9.81 * FLIGHT**2
    assert highest_rebound(recorder.series()) == pytest.approx(fall, abs=1e-9)
    recorder.weight = None
    assert highest_rebound(recorder.series()) is None


def test_a_held_body_sags():
    recorder = Recorder(UP, None, G)
    for t in np.arange(0.0, 2.0, DT):
        x, v = CUBE.copy(), np.zeros_like(CUBE)
        x[0, 1] -= 0.1 * (1.0 - np.cos(np.pi * t))
        v[0, 1] = -0.1 * np.pi * np.sin(np.pi * t)
        recorder.add(t, x, v, center=x.mean(0), velocity=v.mean(0), strain=0.1 * t, volume=1 - t)
    found = figures(recorder.series(), held=True, at_rest=True)
    assert found["sag"] == pytest.approx(0.2, abs=DT**4 / 384.0 * 0.1 * np.pi**4)
    assert found["settled_sag"] == pytest.approx(0.1 * (1.0 - np.cos(np.pi * (2.0 - DT))))
    assert found["peak_strain"] == pytest.approx(0.1 * (2.0 - DT))
    assert found["volume_change"] == pytest.approx(-(2.0 - DT))
    assert found["rebound"] is None


def test_the_least_of_a_cubic_is_exact():
    t = np.array([0.0, 1.0, 3.0])
    y, m = t**3 - 6.0 * t, 3.0 * t**2 - 6.0
    assert minimum(t, y, m) == pytest.approx((np.sqrt(2.0), -4.0 * np.sqrt(2.0)))
