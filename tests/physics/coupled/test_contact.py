"""What comes back to a solid body, and the map of a span."""

from __future__ import annotations

import numpy as np
import pytest
from mixed_scenes import mixed_solver
from solids import cube, sphere

from gf_usd.physics.contact.planes.continuity import POWER
from gf_usd.physics.coupled.contact import STEP, distributed_impulses

RNG = np.random.default_rng(7)


def test_three_samples_share_an_impulse_and_its_moment() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    x = corners + RNG.uniform(-0.2, 0.2, (50, 3, 3)) + [3.0, -2.0, 5.0]
    weights = RNG.dirichlet(np.ones(3), 50)
    J, L = RNG.normal(size=(2, 50, 3))
    p = distributed_impulses(J, L, x, weights)
    # places of 6 m, moments of some 10 N m s and couples of edges from .2 m: 300 eps for each of
    # some ten terms
    rounding = 1e4 * np.finfo(float).eps
    assert p.sum(1) == pytest.approx(J, abs=rounding)
    assert np.cross(x, p).sum(1) == pytest.approx(L, abs=rounding)


def test_three_samples_in_line_share_by_their_weights() -> None:
    x = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    weights, J = np.array([[0.5, 0.25, 0.25]]), np.array([[0.0, 4.0, 0.0]])
    p = distributed_impulses(J, np.zeros((1, 3)), x, weights)
    assert p[0, :, 1].tolist() == [2.0, 1.0, 1.0]


@pytest.mark.parametrize("step", [0.1, STEP, 1.9])
def test_half_a_kick_before_and_half_after_neither_damps_nor_feeds(step: float) -> None:
    """A mass on a spring whose force is that of where it is predicted to be at half the span."""

    def after(x: float, v: float) -> tuple[float, float]:
        kick = -step * (x + 0.5 * step * v)
        v += 0.5 * kick
        x += step * v
        return x, v + 0.5 * kick

    columns = np.array([after(1.0, 0.0), after(0.0, 1.0)]).T
    assert np.linalg.det(columns) == pytest.approx(1.0, abs=1e-12)
    assert np.trace(columns) == pytest.approx(2.0 - step**2, abs=1e-12)


def test_planes_between_a_flow_and_a_light_body_have_the_power_of_the_body() -> None:
    """They had that of the flow, here 211 times as much."""
    radius, gravity = 0.03, 9.81
    run = mixed_solver(
        sphere(radius, (0.0, 0.3, 0.0), path="/Pebble"), cube(low=(-0.1, 0.0, -0.1), edge=0.2),
        materials=("rubber", "dry-sand"), particles=600, frames=2, gravity=(0.0, -gravity, 0.0),
    )  # fmt: skip
    assert run.flow.planes is not None
    (given,) = run.flow.planes._budget.spend(np.array([1e9]), 1.0)
    solid = run.solid.body
    mass = float(solid.per["density"] @ solid.particles.V0)
    power = POWER * mass * gravity * np.sqrt(radius * 9.81)  # m g r / T with T = sqrt(r / g0)
    assert given == pytest.approx(power, rel=0.02)  # an icosphere lacks 1 % of the volume
