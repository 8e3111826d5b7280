"""Fields: what they are at a point, against their formulas, and the motion and energy of a body in
them, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gf_usd.core.frames.settings import Field, Settings
from gf_usd.physics.grid.fields import Fields
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, settings

X = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [-1.0, 0.5, 0.0]])
WIND = Field(kind="wind", vector=(3.0, 0.0, -1.0))


def with_fields(*fields: Field, **more: object) -> Settings:
    return replace(settings("cpu", frames=25, fps=24.0), fields=fields, **more)


def test_wind_is_the_same_everywhere_and_falls_off_around_its_center() -> None:
    np.testing.assert_allclose(Fields(with_fields(WIND)).at(X, 1), np.tile(WIND.vector, (3, 1)))
    near = replace(WIND, center=(0.0, 0.0, 0.0), radius=2.0)
    left = np.exp(-(X**2).sum(1) / 4.0)[:, None]
    np.testing.assert_allclose(Fields(with_fields(near)).at(X, 1), left * WIND.vector)


def test_a_radial_field_points_away_from_its_center_and_is_nothing_there() -> None:
    field = Field(kind="radial", strength=-5.0, center=(0.0, 0.0, 0.0))
    expected = [-5.0 * X[0] / np.sqrt(14.0), np.zeros(3), -5.0 * X[2] / np.sqrt(1.25)]
    np.testing.assert_allclose(Fields(with_fields(field)).at(X, 1), expected, atol=1e-15)


def test_keys_of_gravity_are_straight_between_and_add_to_that_of_the_settings() -> None:
    """Frame k is at time code 1 + k; a frame has the value in its middle."""
    keys = Field(
        kind="gravity", times=(1.0, 5.0, 9.0), values=((0, -10, 0), (0, -2, 0), (8, -2, 0))
    )
    s = with_fields(keys, gravity=(0.0, -10.0, 0.0), start=1.0, time_codes_per_second=24.0)
    fields = Fields(s)
    for index, expected in ((1, -10.0 + 8.0 * 0.5 / 4.0), (4, -10.0 + 8.0 * 3.5 / 4.0)):
        np.testing.assert_allclose(
            fields.at(X[:1], index) + s.gravity, [[0.0, expected, 0.0]], atol=1e-12
        )
    np.testing.assert_allclose(fields.at(X[:1], 20) + s.gravity, [[8.0, -2.0, 0.0]], atol=1e-12)


def test_noise_has_its_strength_is_free_of_divergence_and_hangs_on_the_seed() -> None:
    field = Field(kind="noise", strength=4.0, length=0.5, rate=2.0)
    dice = np.random.default_rng(0)
    x = dice.uniform(-20.0, 20.0, (40_000, 3))
    made = Fields(with_fields(field))
    b = made.at(x, 3)
    # products of two of 32 waves average out over 40 lengths: 1 / sqrt(40,000) and some
    assert np.sqrt((b**2).sum(1).mean()) == pytest.approx(4.0, rel=0.02)
    step = 1e-5
    few, divergence, slope = x[:50], np.zeros(50), np.zeros(50)
    for a in range(3):
        d = step * np.eye(3)[a]
        change = (made.at(few + d, 3) - made.at(few - d, 3)) / (2.0 * step)
        divergence += change[:, a]
        slope = np.maximum(slope, np.abs(change).max(1))
    assert np.abs(divergence).max() < 1e-6 * slope.max()  # of differences: rounding over the step
    np.testing.assert_array_equal(b, Fields(with_fields(field)).at(x, 3))
    assert np.abs(b - Fields(with_fields(field, seed=1)).at(x, 3)).max() > 1.0
    assert np.abs(b - made.at(x, 9)).max() > 1.0  # a quarter of a second later, half a turn


BODY = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
SOFT = [elastic(E=1e5, nu=0.3, density=1000.0)]


@pytest.mark.slow
def test_a_free_body_falls_as_keys_of_gravity_say_and_no_energy_is_made_up() -> None:
    """Gravity turns over within a second: v(t) = g0 (t - t^2), held constant over each frame."""
    g0, n = -9.81, 24
    keys = Field(kind="gravity", times=(0.0, 24.0), values=((0, g0, 0), (0, -g0, 0)))
    s = with_fields(keys, gravity=(0.0, g0, 0.0), start=0.0, time_codes_per_second=24.0)
    seen = list(TotalLagrangian(BODY, SOFT, s).frames())
    t = np.arange(n + 1) / n
    v = np.array([f.health.momentum[1] for f in seen]) / seen[0].health.mass
    # the mean over a frame of what is straight in time is its middle: exact at frames
    np.testing.assert_allclose(v, g0 * (t - t**2), atol=1e-5 * abs(g0))
    energy = np.array([f.health.kinetic + f.health.elastic + f.health.potential for f in seen])
    work = np.cumsum([f.health.work for f in seen])
    scale = seen[0].health.mass * g0**2
    # energy at whole steps: f . v dt misses (v' - v) f dt / 2 at the ends, with 10 steps a frame
    np.testing.assert_allclose(energy - energy[0], work, atol=2e-3 * scale)
    assert sum(f.health.rollbacks for f in seen) == 0


@pytest.mark.slow
def test_a_uniform_wind_is_as_much_gravity() -> None:
    """To rounding: the same body under gravity, and without it in a wind."""
    fall = (0.5, -9.81, 0.0)
    *_, there = TotalLagrangian(BODY, SOFT, with_fields(gravity=fall)).frames()
    wind = Field(kind="wind", vector=fall)
    *_, blown = TotalLagrangian(BODY, SOFT, with_fields(wind, gravity=(0.0, 0.0, 0.0))).frames()
    np.testing.assert_allclose(blown.particles.x, there.particles.x, atol=1e-4)
