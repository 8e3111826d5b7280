"""Springs to a pose: frequency, damping, sag, work and the cap, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Goals
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, settings

W = 2.0 * np.pi * 2.0  # [rad/s]
BODY = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
SOFT = [elastic(E=1e5, nu=0.3, density=1000.0)]
SPEED, FPS = 0.3, 240.0


def still(X: Floats) -> Callable[[float], Floats]:
    return lambda _: X


def goals(w: float = W, damping: float = 0.0) -> Goals:
    return Goals(pose=still, rate=lambda X: np.full(len(X), w), damping=damping, moving=False)


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_body_swings_as_its_springs_say(damping: float) -> None:
    """y = v / w_d e^(-zeta w t) sin(w_d t); the midpoint rule is slow by (w dt)^2 / 12."""
    s = settings("cpu", frames=121, fps=FPS)
    solver = TotalLagrangian(BODY, SOFT, s, velocity=(SPEED, 0.0, 0.0), goals=goals(W, damping))
    seen = list(solver.frames())
    t = np.arange(121) / FPS
    wd = W * np.sqrt(1.0 - damping**2)
    exact = SPEED / wd * np.exp(-damping * W * t) * np.sin(wd * t)
    y = np.array([(f.particles.x - BODY.X)[:, 0].mean() for f in seen])
    late = (W / FPS) ** 2 / 12.0 * W * t[-1]  # of the phase
    np.testing.assert_allclose(y, exact, atol=2.0 * late * SPEED / W)
    energy = [f.health.kinetic + f.health.elastic for f in seen]
    work = np.cumsum([f.health.work for f in seen])
    # float32: 1e-7 of the energy for each of a few hundred substeps
    np.testing.assert_allclose(np.array(energy) - energy[0], work, atol=1e-4 * energy[0])


def test_springs_hold_a_body_up_where_it_sags_by_g_over_w_squared() -> None:
    s = replace(settings("cpu", frames=121, fps=48.0), gravity=(0.0, -9.81, 0.0))
    *_, last = TotalLagrangian(BODY, SOFT, s, goals=goals(damping=1.0)).frames()
    sag = (BODY.X - last.particles.x)[:, 1]
    # e^(-w t) of the way is left: 1e-13
    np.testing.assert_allclose(sag, 9.81 / W**2, rtol=1e-4)


def test_a_goal_that_is_as_good_as_keyframed_follows_a_motion() -> None:
    def moving(X: Floats) -> Callable[[float], Floats]:
        return lambda frame: X + [0.01 * frame, 0.0, 0.0]

    hard = Goals(pose=moving, rate=lambda X: np.full(len(X), np.inf), damping=1.0)
    s = replace(settings("cpu", frames=13, fps=24.0), gravity=(0.0, -9.81, 0.0))
    solver = TotalLagrangian(BODY, SOFT, s, goals=hard)
    free = TotalLagrangian(BODY, SOFT, s)
    assert solver.coarse == free.coarse  # the springs take no part in the step
    *_, last = solver.frames()
    away = last.particles.x - BODY.X - [0.12, 0.0, 0.0]
    # g dt^2 of sag, with w = 1 / dt
    assert np.abs(away).max() < 2.0 * 9.81 * solver.body.step.dt**2
