"""Rolling resistance, and the damping of motion too small to be seen."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import gf_usd
from gf_usd.core.materials.dimensionless import G0, time_scale
from gf_usd.physics.total_lagrangian.settling import (
    AMPLITUDE,
    CALM,
    PATIENCE,
    RestTimer,
    Settling,
    resistance,
)

UP = np.array([0.0, 1.0, 0.0])
R = 0.3


def _ball(seed: int = 1, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Masses and places of nodes around (1, R, 2)."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 3))
    q *= (R * rng.random(n) ** (1 / 3) / np.linalg.norm(q, axis=1))[:, None]
    m = rng.random(n)
    q -= m @ q / m.sum()
    return m, q + [1.0, R, 2.0]


def _kinetic(m: np.ndarray, v: np.ndarray) -> float:
    return float(0.5 * m @ (v**2).sum(1))


def test_the_moment_of_a_rolling_body_falls_by_the_impulse() -> None:
    m, x = _ball()
    w = np.array([2.0, 0.0, -1.0])
    P = np.array([[1.0, 0.0, 2.0]])
    v = np.cross(w, x - P)
    body = np.zeros(len(m), int)
    spin = (m[:, None] * np.cross(x - P, v)).sum(0)[[0, 2]]
    most = 0.2 * np.linalg.norm(spin)
    change = resistance(m, x, v, body, P, UP, np.array([most]))
    after = (m[:, None] * np.cross(x - P, v + change)).sum(0)[[0, 2]]
    # along the rotation, so that w falls by a fifth; I couples its axes
    np.testing.assert_allclose(after, 0.8 * spin, rtol=1e-12)
    np.testing.assert_allclose(change, -0.2 * v, atol=1e-12)
    assert _kinetic(m, v + change) == pytest.approx(0.64 * _kinetic(m, v))


def test_it_stops_a_body_and_does_not_turn_it_back() -> None:
    m, x = _ball()
    P = np.array([[1.0, 0.0, 2.0]])
    v = np.cross([0.1, 0.0, 0.2], x - P)
    change = resistance(m, x, v, np.zeros(len(m), int), P, UP, np.array([1e9]))
    np.testing.assert_allclose(v + change, 0.0, atol=1e-14)


def test_it_takes_energy_from_what_turns_and_gives_none_to_any_motion() -> None:
    rng = np.random.default_rng(2)
    m, x = _ball()
    P = np.array([[1.0, 0.0, 2.0]])
    body = np.zeros(len(m), int)
    for most in (1e-4, 1e-2, 1.0, 100.0):
        for _ in range(8):
            v = rng.normal(size=x.shape) + rng.normal(size=3)
            change = resistance(m, x, v, body, P, UP, np.array([most]))
            assert _kinetic(m, v + change) <= _kinetic(m, v)
        v += np.cross([20.0, 0.0, 10.0], x - P)
        change = resistance(m, x, v, body, P, UP, np.array([most]))
        assert _kinetic(m, v + change) < _kinetic(m, v)


def test_what_slides_without_turning_is_left_to_friction() -> None:
    m, x = _ball()
    P = np.array([[1.0, 0.0, 2.0]])
    v = np.tile([3.0, 0.0, -1.0], (len(m), 1))
    change = resistance(m, x, v, np.zeros(len(m), int), P, UP, np.array([1e9]))
    np.testing.assert_allclose(change, 0.0, atol=1e-13)


def test_a_body_that_slides_and_turns_loses_no_more_than_its_turning() -> None:
    m, x = _ball()
    P = np.array([[1.0, 0.0, 2.0]])
    body, w = np.zeros(len(m), int), np.array([0.0, 0.0, -0.5])
    rolls = np.cross(w, x - P)
    v = rolls + [3.0, 0.0, 0.0]  # forwards, as it slips while it begins to roll
    change = resistance(m, x, v, body, P, UP, np.array([1e9]))
    lost = _kinetic(m, v) - _kinetic(m, v + change)
    # dw = -(w . w_c / |w|^2) w, at most |w_c|: the center slows by at most |w_c| R
    assert lost > 0.0
    assert np.linalg.norm(m @ change / m.sum()) <= np.linalg.norm(w) * R * (1.0 + 1e-12)
    # with backspin the moment would push the body on
    v = [3.0, 0.0, 0.0] - rolls
    np.testing.assert_array_equal(resistance(m, x, v, body, P, UP, np.array([1e9])), 0.0)


def test_spin_about_the_normal_and_what_does_not_turn_are_left() -> None:
    m, x = _ball()
    P = np.array([[1.0, 0.0, 2.0]])
    body = np.zeros(len(m), int)
    # the third moments about P couple the axes of a body that is not symmetric: one that is
    x = np.concatenate([x, 2.0 * P * [1, 0, 1] + x * [-1, 1, -1]])
    m, body = np.concatenate([m, m]), np.zeros(2 * len(body), int)
    for v in (np.cross([0.0, 3.0, 0.0], x - P), np.tile([0.0, -2.0, 0.0], (len(x), 1))):
        change = resistance(m, x, v, body, P, UP, np.array([1e-2]))
        np.testing.assert_allclose(change, 0.0, atol=1e-15)


@pytest.mark.slow
def test_the_support_of_a_body_that_moves_is_below_it() -> None:
    """Not where it will be a frame later: the displacement of a frame goes to the offset."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=R)
    ball.apply_translation((0.0, R, 0.0))
    slab = trimesh.creation.box(extents=(6.0, 0.5, 2.0))
    slab.apply_translation((1.0, -0.25, 0.0))
    scene = gf_usd.Scene()
    scene.add_body(ball, material="rubber", velocity=(3.0, 0.0, 0.0))
    scene.add_obstacle(slab)
    simulation = gf_usd.simulate(scene, frames=7, particles=300)
    found = []
    for frame in simulation:
        solver = simulation._solver
        center = frame.positions.mean(0)
        found += [s.point - center for s in solver.settling._supports(solver.state).values()]
    assert len(found) >= 3
    assert np.abs(np.array(found)[:, 0]).max() < 0.1 * R, "a frame moves it by 0.4 R"
    assert np.array(found)[:, 1].max() < -0.75 * R, "of a ball that is pressed flat"


def test_each_body_feels_its_own() -> None:
    (m1, x1), (m2, x2) = _ball(1), _ball(2)
    x2 = x2 + [5.0, 0.0, 0.0]
    m, x = np.concatenate([m1, m2]), np.concatenate([x1, x2])
    body = np.repeat([0, 1], [len(m1), len(m2)])
    P = np.array([[1.0, 0.0, 2.0], [6.0, 0.0, 2.0]])
    v = np.cross([1.0, 0.0, 0.0], x - P[body])
    both = resistance(m, x, v, body, P, UP, np.array([0.0, 1e9]))
    np.testing.assert_allclose(both[body == 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(both[body == 1], -v[body == 1], atol=1e-14)


class _Calm(Settling):
    """Without a solver: what `_nearly_at_rest` needs."""

    def __init__(self, frame_time: float) -> None:
        from types import SimpleNamespace

        self._body = SimpleNamespace(settings=SimpleNamespace(frame_time=frame_time))
        self._radius, self._scale = np.array([R]), np.array([time_scale(R)])
        self._energy = np.array([2.0 * G0 * R])
        self.calm = RestTimer(1)

    def after(self, kinetic: float, at: float) -> bool:
        return bool(self._nearly_at_rest(np.array([kinetic]), np.array([[0.0, at, 0.0]]))[0])


def test_calm_is_little_energy_in_one_place_for_a_time_T() -> None:
    T = time_scale(R)
    little, much = 0.99 * CALM * 2.0 * G0 * R, 1.01 * CALM * 2.0 * G0 * R
    calm = _Calm(0.25 * T)
    assert [calm.after(little, 0.0) for _ in range(5)] == [False] * 4 + [True]
    assert not calm.after(much, 0.0)
    assert [calm.after(little, 0.0) for _ in range(4)] == [False] * 3 + [True]
    # one that slides leaves the place
    calm = _Calm(0.25 * T)
    assert not any(calm.after(little, 0.6 * AMPLITUDE * R * i) for i in range(12))


def test_nothing_in_free_fall_is_calm() -> None:
    """From the top of its flight a body has too much energy before T."""
    T = time_scale(R)
    calm, dt = _Calm(T / 50), T / 50
    seen = []
    for i in range(-100, 101):
        t = i * dt
        seen.append(calm.after(0.5 * 2.0 * (G0 * t) ** 2, -0.5 * G0 * t * t))
    assert not any(seen)


class _Low(Settling):
    """Without a solver: what `_bounces` needs."""

    def __init__(self, frame_time: float) -> None:
        from types import SimpleNamespace

        self._body = SimpleNamespace(settings=SimpleNamespace(frame_time=frame_time))
        self._radius, self._scale = np.array([R]), np.array([time_scale(R)])
        self._energy, self._touchable = np.array([2.0 * G0 * R]), True
        self.low, self.touching, self.bounced = RestTimer(1), np.zeros(1, bool), np.zeros(1, bool)
        self.touches = False

    def _touching(self, state: object) -> np.ndarray:
        return np.array([self.touches])

    def after(self, kinetic: float, at: float, touches: bool) -> bool:
        self.touches = touches
        where = np.array([[0.0, at, 0.0]])
        return bool(self._bounces(None, np.array([kinetic]), where)[0])  # pyright: ignore[reportArgumentType]


def _hop(share: float, frames: int) -> list[tuple[float, float, bool]]:
    """(kinetic energy, height, contact) of bounces of a share of R, with contact at their ends."""
    v0 = np.sqrt(2.0 * G0 * share * R)
    flight = 2.0 * v0 / G0
    out = []
    for i in range(frames):
        t = (i * time_scale(R) / 20) % flight
        v, y = v0 - G0 * t, v0 * t - 0.5 * G0 * t * t
        out.append((0.5 * 2.0 * v * v, y, y < 0.02 * share * R))
    return out


def test_bounces_of_less_than_half_a_radius_are_low_after_three_T() -> None:
    seen = [_Low(time_scale(R) / 20).after(*one) for one in _hop(0.4, 1)]
    low = _Low(time_scale(R) / 20)
    seen = [low.after(*one) for one in _hop(0.4, 80)]
    assert seen.index(True) == 20 * PATIENCE  # the first frame is not yet still
    assert all(seen[int(20 * PATIENCE) :])
    high = _Low(time_scale(R) / 20)
    assert not any(high.after(*one) for one in _hop(0.6, 200))


def test_what_stays_in_contact_or_in_the_air_does_not_bounce() -> None:
    for touches in (True, False):
        low = _Low(time_scale(R) / 20)
        low.touching = np.array([touches])
        assert not any(low.after(kinetic, y, touches) for kinetic, y, _ in _hop(0.3, 200))


def test_a_bounce_of_half_a_radius_loses_what_the_restitution_says() -> None:
    """E' = -2 rate v^2 / 2 over the flight, to first order in 1 - e^2."""
    e, T = 0.98, time_scale(R)
    rate = 0.75 * (1.0 - e**2) / T
    v0 = np.sqrt(G0 * R)
    t = np.linspace(0.0, 2.0 * v0 / G0, 2001)
    lost = np.trapezoid(2.0 * rate * 0.5 * (v0 - G0 * t) ** 2, t) / (0.5 * v0**2)
    assert lost == pytest.approx(1.0 - e**2, rel=1e-6)
