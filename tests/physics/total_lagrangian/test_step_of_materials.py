"""The stable step of bodies of different materials: each counts with its own damping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, settings

H = 0.1  # [m]
SOFT = elastic(E=1e4, nu=0.3, density=1000.0, damping_time=0.02)
STIFF = elastic(E=1e8, nu=0.3, density=1000.0)
MATERIALS = [SOFT, STIFF]


def pair(gap: int):
    """A soft block and, `gap` cells beside it, a stiff one: two bodies, or one where they touch."""
    soft, stiff = block((0.0, 0.0, 0.0), (2, 2, 2), H), block((2.0 + gap, 0, 0), (2, 2, 2), 1.0)
    X = np.concatenate([soft.X, H * stiff.X])
    which = np.repeat([0, 1], len(soft))
    return replace(
        soft, X=X, V0=np.tile(soft.V0, 2), volume=2.0 * soft.volume, material=which,
        body=which if gap else None,
    )  # fmt: skip


def swinging(particles, materials, **changes) -> TotalLagrangian:
    rng = np.random.default_rng(0)
    return TotalLagrangian(
        particles, materials, settings("cpu", **changes),
        velocity=lambda X: 0.01 * rng.normal(size=X.shape), real=np.float64,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0, 4])
def test_damping_of_a_soft_body_does_not_shorten_the_step_of_a_stiff_one(gap):
    alone = [swinging(block((0, 0, 0), (2, 2, 2), H), [one]).body.step.dt for one in MATERIALS]
    both = swinging(pair(gap), MATERIALS).body.step
    # The damping time of the soft one at the frequency of the stiff one: 1/100 of this step.
    assert 0.8 * min(alone) < both.dt < 1.25 * min(alone)
    assert both.damping_ratio < 0.5


@pytest.mark.parametrize("materials", [MATERIALS, [SOFT, replace(STIFF, density=1e4)]])
@pytest.mark.parametrize("gap", [0, 4])
def test_the_step_of_two_materials_is_stable(gap, materials):
    solver = swinging(pair(gap), materials, frames=4, fps=2000.0)
    frames = list(solver.frames())
    energies = [f.health.kinetic + f.health.elastic for f in frames]
    assert solver.guard.halvings == 0
    # Symplectic Euler keeps the energy of a nearby system, and lets this one swing by 0.2 %.
    assert np.diff(energies).max() < 0.01 * energies[0]
    assert energies[-1] < 0.999 * energies[0]


def test_a_soft_body_with_strong_damping_still_limits_the_step():
    thick = replace(SOFT, damping_time=100.0)
    alone = swinging(block((0, 0, 0), (2, 2, 2), H), [thick]).body.step
    both = swinging(pair(4), [thick, STIFF]).body.step
    assert alone.damping_ratio > 3.0
    # The rate of a body alone is bounded by its frequency, that of both is found: 1.31 here.
    assert both.dt < 1.4 * alone.dt


LAYOUTS = {
    "layer": lambda X: X[:, 0] > 0.05,  # half a cell of the soft one on the stiff one
    "halves": lambda X: X[:, 0] > 0.2,
    "mixed": lambda X: np.random.default_rng(2).integers(0, 2, len(X)),
}


@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_the_step_that_damping_limits_is_stable_where_the_damped_part_is_stretched(layout):
    """Cells hold both: the mean of a cell says too little about the part that is damped."""
    particles = pair(0)
    which = LAYOUTS[layout](particles.X).astype(int)
    thick, stiff = replace(SOFT, damping_time=5.0), elastic(E=1e6, nu=0.3, density=1000.0)
    solver = TotalLagrangian(
        replace(particles, material=which), [thick, stiff], settings("cpu", frames=4, fps=2000.0),
        real=np.float64,
    )  # fmt: skip
    assert solver.body.step.damping_ratio > 3.0
    at_rest = solver.substeps
    X = solver.body.stencil.node_X
    stretched = np.zeros_like(X)
    stretched[:, 0] = -20.0 * np.maximum(0.1 - X[:, 0], 0.0) ** 2  # up to 4 times
    solver.state.put("u", stretched)
    health = [frame.health for frame in solver.frames()]
    assert max(h.max_stretch for h in health) > 2.0
    assert sum(h.rollbacks for h in health) == solver.guard.halvings == 0
    assert max(h.substeps for h in health) > 2 * at_rest
