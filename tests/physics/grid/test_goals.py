"""Springs to a pose: frequency, damping, sag, work and the cap, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import AttachedPoints, Goals
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_springs_hold_a_body_up_where_it_sags_by_g_over_w_squared() -> None:
    s = replace(settings("cpu", frames=121, fps=48.0), gravity=(0.0, -9.81, 0.0))
    *_, last = TotalLagrangian(BODY, SOFT, s, goals=goals(damping=1.0)).frames()
    sag = (BODY.X - last.particles.x)[:, 1]
    # e^(-w t) of the way is left: 1e-13
    np.testing.assert_allclose(sag, 9.81 / W**2, rtol=1e-4)


@pytest.mark.slow
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


FAST = [elastic(E=1e7, nu=0.3, density=1000.0)]
CORNERS = np.array([BODY.X.min(0), BODY.X.max(0)])
ENDS = np.array([[CORNERS[i, 0], CORNERS[j, 1], CORNERS[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])


def attached(path: Floats, k: float, c: float = 0.0) -> Goals:
    """Springs of k [N/m] and c [N s/m] at each of ENDS."""
    points = AttachedPoints(
        X=ENDS, path=path, stiffness=np.full(8, k), damping=np.full(8, c), body=np.zeros(8, int)
    )
    return replace(goals(0.0), attached=points)


@pytest.mark.slow
@pytest.mark.parametrize("up", [0.0, 0.3])
def test_springs_of_points_hold_a_body_up_by_what_they_are_stiff(up: float) -> None:
    """Sum k (place - x) = m g, whatever the grid makes of the points; critically damped."""
    m = 1000.0 * float(BODY.V0.sum())
    k = m * W**2 / 8.0
    s = replace(settings("cpu", frames=97, fps=48.0), gravity=(0.0, -9.81, 0.0))
    springs = attached((ENDS + [0.0, up, 0.0])[None], k, 2.0 * m * W / 8.0)
    *_, last = TotalLagrangian(BODY, FAST, s, goals=springs).frames()
    sag = (BODY.X - last.particles.x)[:, 1]
    # e^(-w t) of the way is left, 1e-11, and what the body itself sags between its corners
    own = 1000.0 * 9.81 * 1.0**2 / 1e7  # [m] rho g L^2 / E
    np.testing.assert_allclose(sag, 9.81 / W**2 - up, atol=own)
    np.testing.assert_allclose(sag.mean(), 9.81 / W**2 - up, atol=0.5 * own)


def test_points_that_move_take_the_body_along() -> None:
    m = 1000.0 * float(BODY.V0.sum())
    path = ENDS + np.linspace(0.0, 0.5, 49)[:, None, None] * np.array([1.0, 0.0, 0.0])
    still = np.repeat(path[-1:], 72, axis=0)
    springs = attached(np.concatenate([path, still]), m * W**2 / 8.0, 2.0 * m * W / 8.0)
    *_, last = TotalLagrangian(
        BODY, FAST, settings("cpu", frames=121, fps=48.0), goals=springs
    ).frames()
    away = last.particles.x - BODY.X - [0.5, 0.0, 0.0]
    # (1 + w t) e^(-w t) of the speed over w is left after t = 1.5 s
    # and 1e-6 m of rounding: some 20 times that of 0.5 m in single precision
    assert np.abs(away).max() < 0.5 / W * (1.0 + 1.5 * W) * np.exp(-1.5 * W) + 2e-6
