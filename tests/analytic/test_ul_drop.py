"""The drop of the dimensionless presets with both solvers: Updated and Total Lagrangian."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from solids import fill, preset_material, settings, solid, sphere

from gf_usd.core.materials.dimensionless import G0, time_scale
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian


@cache
def drop(kind: type, name: str, frames: int = 75, radius: float = 1.0):
    """Heights over the height at rest, and the health, of a ball of 1000 dropped three radii."""
    shape = sphere(radius)
    body, samples = fill(solid(shape), 1000)
    T = time_scale(body.radius)
    s = settings(
        frames=frames, fps=19.1 / T, gravity=(0.0, -G0, 0.0), floor=0.0, filter_rate=np.inf,
        lift=(0.0, 4.0 * radius, 0.0),
    )  # fmt: skip
    solver = kind(
        body, [preset_material(name, body)], s, samples=samples, embedded={"skin": shape.points}
    )
    seen = list(solver.frames())
    heights = [float(np.ptp(f.embedded["skin"].x[:, 1])) / (2.0 * radius) for f in seen]
    return heights, [f.health for f in seen], body.spacing


# Both with APIC in every substep, which alone is most of the difference to production settings:
# metal and rubber then agree within 1 % and jelly, crushed to a third, within 5 %.  What is left:
# one grid is fixed in the world and the other in the body, so that cells hold more particles where
# UL is crushed, and light nodes follow the others in TL only.
@pytest.mark.slow
@pytest.mark.parametrize(("name", "apart"), [("rubber", 0.02), ("metal", 0.02), ("jelly", 0.05)])
def test_peak_squash_is_that_of_the_total_lagrangian_solver(name, apart):
    ul, tl = (min(drop(kind, name)[0]) for kind in (UpdatedLagrangian, TotalLagrangian))
    assert ul == pytest.approx(tl, abs=apart)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rubber", "metal", "jelly"])
def test_no_energy_comes_from_nowhere_and_the_floor_holds(name):
    _, health, spacing = drop(UpdatedLagrangian, name)
    energies = [h.energy for h in health]
    # f32 rounding of the fall, and position Verlet's own swing while the floor is touched.
    for before, after in pairwise(energies):
        assert after <= before + 1e-3 * energies[0]
    deepest = max(h.penetration for h in health)
    assert 0.0 < deepest <= spacing, "the product's bound on impact"
    assert not any(h.rollbacks or h.inverted for h in health)


@pytest.mark.slow
def test_a_small_ball_lands_as_a_large_one():
    # The presets are the same at any size: the same frames but for rounding of f32 in contact.
    small, large = (drop(UpdatedLagrangian, "rubber", radius=r)[0] for r in (0.025, 1.0))
    np.testing.assert_allclose(small, large, atol=2e-3)


@pytest.mark.slow
def test_a_sliding_ball_is_slowed_by_friction_and_stays_on_the_floor():
    # Friction may not do more than mu m g; a ball that rolls and slides loses some of its speed.
    shape = sphere(1.0)
    body, samples = fill(solid(shape), 300)
    made = preset_material("metal", body, friction=0.2)
    s = settings(frames=30, fps=60.0, gravity=(0.0, -G0, 0.0), floor=-1.0)
    solver = UpdatedLagrangian(body, [made], s, samples=samples, velocity=(2.0, 0.0, 0.0))
    health = [f.health for f in solver.frames()]
    speed = [h.momentum[0] / h.mass for h in health]
    slowed = speed[0] - speed[-1]
    # Steady weight; a landing bounces, so a tenth more is allowed for.
    assert 0.3 * 0.2 * G0 * 29 / 60 < slowed < 1.1 * 0.2 * G0 * 29 / 60
    assert max(h.penetration for h in health[5:]) < 0.3 * body.spacing
