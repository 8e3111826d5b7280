"""Limits of squish and stretch: where they hold a load, how they turn a motion back, what they
work, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import FleshLimits, Goals
from gf_usd.physics.grid.goals import PULL
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, settings

pytestmark = pytest.mark.slow  # kernels of their own

W = 2.0 * np.pi  # [rad/s]
BODY = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
SOFT = [elastic(E=1e8, nu=0.3, density=1000.0)]
G, WAY = 9.81, 0.1  # [m/s^2], [m] of the limit
UP = np.array([0.0, 1.0, 0.0])


def limited(toward: float, away: float, rate: Floats, damping: float, w: float = W) -> Goals:
    """Limits on a body whose pose and bone move at `rate` (3,) [m/frame], and springs of w."""

    def pose(X: Floats) -> Callable[[float], Floats]:
        return lambda frame: X + frame * rate

    def carried(X: Floats) -> Callable[[float], tuple[Floats, Floats]]:
        return lambda frame: (X + frame * rate, np.tile(UP, (len(X), 1)))

    limits = FleshLimits(
        carried=carried,
        toward=lambda X: np.full(len(X), toward),
        away=lambda X: np.full(len(X), away),
    )
    return Goals(pose=pose, rate=lambda X: np.full(len(X), w), damping=damping, limits=limits)


def pull(d: float) -> float:
    """[m/s^2] below s*."""
    s = max(0.0, 2.0 * d / WAY - 1.0)
    return PULL * s * s / (1.0 - s)


def potential(d: float) -> float:
    """[m^2/s^2] the integral of `pull`."""
    s = max(0.0, 2.0 * d / WAY - 1.0)
    return 0.5 * WAY * PULL * (-np.log1p(-s) - s - 0.5 * s * s)


@pytest.mark.parametrize(("toward", "away"), [(WAY, np.inf), (np.inf, WAY)])
@pytest.mark.parametrize("loads", [1.0, 20.0])
def test_a_load_rests_where_springs_and_the_limit_carry_it(
    toward: float, away: float, loads: float
) -> None:
    """w^2 d + A s^2 / (1 - s) = g: at twenty times gravity, short of the limit itself."""
    s = replace(settings("cpu", frames=61, fps=12.0), gravity=(0.0, -loads * G, 0.0))
    goals = limited(toward, away, 0.0 * UP, 1.0)
    *_, last = TotalLagrangian(BODY, SOFT, s, goals=goals).frames()
    sag = (BODY.X - last.particles.x)[:, 1]
    expected = brentq(lambda d: W**2 * d + pull(d) - loads * G, 0.0, WAY * (1.0 - 1e-9))
    assert 0.5 * WAY < expected < WAY
    # the limit pulls all nodes alike, so nothing is strained: what is left of the swing
    np.testing.assert_allclose(sag, expected, rtol=1e-3)


def test_a_blow_is_turned_back_at_the_height_of_its_energy() -> None:
    """v^2 / 2 = U(d) at the turning point, and the way back has the same speed."""
    speed = 2.0
    goals = limited(WAY, np.inf, 0.0 * UP, 0.0, w=0.0)
    s = settings("cpu", frames=121, fps=960.0)
    solver = TotalLagrangian(BODY, SOFT, s, velocity=(0.0, -speed, 0.0), goals=goals)
    seen = list(solver.frames())
    sag = np.array([(BODY.X - f.particles.x)[:, 1].mean() for f in seen])
    expected = brentq(lambda d: potential(d) - 0.5 * speed**2, 0.0, WAY * (1.0 - 1e-12))
    assert expected < WAY
    # between two frames it is nearer by at most a (t / 2)^2 / 2
    missed = 0.5 * pull(expected) * (0.5 / 960.0) ** 2
    assert abs(sag.max() - expected) < missed + 1e-3 * WAY
    assert sag[-1] < 0.5 * WAY  # outside again
    energy = np.array([f.health.kinetic + f.health.elastic for f in seen])
    assert energy[-1] == pytest.approx(energy[0], rel=1e-3)
    work = np.cumsum([f.health.work for f in seen])
    np.testing.assert_allclose(energy - energy[0], work, atol=1e-4 * energy[0])


def test_a_blow_far_too_hard_stays_bounded_and_makes_no_energy() -> None:
    """Beyond s* the limit is a spring as stiff as the step takes: 30 m/s goes in by v / sqrt(K)."""
    speed = 30.0
    goals = limited(WAY, np.inf, 0.0 * UP, 0.0, w=0.0)
    s = settings("cpu", frames=41, fps=960.0)
    solver = TotalLagrangian(BODY, SOFT, s, velocity=(0.0, -speed, 0.0), goals=goals)
    seen = list(solver.frames())
    sag = np.array([(BODY.X - f.particles.x)[:, 1].max() for f in seen])
    beyond = speed * solver.body.step.dt * np.sqrt(2.0 * solver.body.mass.lightest)
    assert WAY < sag.max() < WAY + beyond
    assert sum(f.health.rollbacks for f in seen) == 0
    total = np.array([f.health.kinetic + f.health.elastic for f in seen])
    assert total.max() < total[0] * (1.0 + 1e-2)  # the rule of the step: (w dt)^2 / 4 of a part


def test_what_moves_with_its_bone_feels_no_limit() -> None:
    rate = np.array([0.01, 0.02, 0.0])
    s = settings("cpu", frames=13, fps=24.0)
    goals = limited(WAY, WAY, rate, 1.0)
    velocity = tuple(24.0 * rate)
    *_, last = TotalLagrangian(BODY, SOFT, s, velocity=velocity, goals=goals).frames()
    # float32 of a place 0.3 m away
    np.testing.assert_allclose(last.particles.x, BODY.X + 12 * rate, atol=1e-5)
