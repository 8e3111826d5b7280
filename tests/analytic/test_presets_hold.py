"""Presets on a body with limbs: nothing turns inside out, and no frame has to be recomputed."""

from __future__ import annotations

import pytest
from limbed import octopus
from solids import fill, preset_material, settings, solid, surface

from gf_usd.core.materials.dimensionless import FILTER_RATE, G0, time_scale
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


def drop(name: str, **changes) -> tuple[int, int, float]:
    """Most inverted particles, recomputed frames and least J of an octopus dropped by 3 radii."""
    body, samples = fill(solid(*(surface(*mesh) for mesh in octopus())), 1500)
    T = time_scale(body.radius)
    s = settings(
        frames=30, fps=7.7 / T, gravity=(0.0, -G0, 0.0), floor=0.0, filter_rate=FILTER_RATE / T,
        lift=(0.0, 3.0 * body.radius, 0.0),
    )  # fmt: skip
    solver = TotalLagrangian(body, [preset_material(name, body, **changes)], s, samples=samples)
    health = [frame.health for frame in solver.frames()]
    return (
        max(h.inverted for h in health),
        sum(h.rollbacks for h in health),
        min(h.min_J for h in health),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rubber", "metal", "jelly"])
def test_nothing_turns_inside_out(name) -> None:
    inverted, redone, least = drop(name)
    assert (inverted, redone) == (0, 0)
    assert least > 0.0


@pytest.mark.slow
def test_the_law_of_the_paper_would_turn_some_inside_out() -> None:
    inverted, redone, least = drop("jelly", law="corotated")
    assert inverted > 0
    assert redone > 0
    assert least < 0.0
