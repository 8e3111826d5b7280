"""The APIC filter by itself, on a body without stiffness: what it keeps and what it takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from solids import cube, fill, preset_material, settings, solid, sphere

from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

BODIES = {"ball": lambda: solid(sphere()), "plate": lambda: solid(cube(edge=(2.0, 0.2, 2.0)))}
on_every_body = pytest.mark.parametrize("body", BODIES)
followed = pytest.mark.parametrize("followers", [True, False], ids=["dependent nodes", "all free"])

SPIN = np.array([0.45, 1.5, 0.75])  # [rad/s]
STRETCH = np.array([0.6, -1.2, 0.6])  # [1/s]


def noise(X: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).normal(size=X.shape)


def affine(X: np.ndarray) -> np.ndarray:
    return np.cross(SPIN, X) + X * STRETCH + [0.3, 0.2, -0.1]


def filtered(body: str, velocity: Any, *, substeps: int, followers: bool):
    """Positions [m] of the free nodes, their mass, and their velocities before and after."""
    particles, _ = fill(BODIES[body](), 600)
    slack = preset_material("rubber", particles, damping_time=0.0, youngs_modulus=1e-9)
    # A frame of a microsecond: nodes do not move, so nothing but the filter acts.
    s = settings(frames=2, fps=1e6, filter_rate=np.inf, substeps=substeps, followers=followers)
    solver = TotalLagrangian(particles, [slack], s, velocity=velocity, real=np.float64)
    before = solver.state.view().v
    list(solver.frames())
    return solver.body.stencil.free_X, solver.body.mass, before, solver.state.view().v


@pytest.mark.slow
@on_every_body
@followed
def test_momentum_and_its_moment_are_kept_to_rounding(body, followers):
    X, m, before, after = filtered(body, noise, substeps=40, followers=followers)
    assert np.abs(after - before).max() > 0.5
    # 40 filters of sums of some hundred terms, 1e-16 each, of speeds of one meter a second.
    size = m.lumped.sum()
    p = [m.momentum(v) for v in (before, after)]
    np.testing.assert_allclose(p[1].sum(0), p[0].sum(0), atol=1e-12 * size)
    moments = [np.cross(X, one).sum(0) for one in p]
    np.testing.assert_allclose(moments[1], moments[0], atol=1e-12 * size)


@pytest.mark.slow
@on_every_body
@followed
def test_rigid_and_affine_motion_pass_unchanged(body, followers):
    _, _, before, after = filtered(body, affine, substeps=40, followers=followers)
    # C reproduces affine fields because 4/h^2 sum w dX dX = I; dependent nodes extend them exactly.
    np.testing.assert_allclose(after, before, atol=1e-11)


@pytest.mark.slow
@on_every_body
@followed
def test_noise_loses_energy_and_never_gains(body, followers):
    energy = []
    for substeps in (1, 2, 4, 100):
        _, m, before, after = filtered(body, noise, substeps=substeps, followers=followers)
        energy.append((after * m.momentum(after)).sum() / (before * m.momentum(before)).sum())
    assert energy[0] < 0.9  # a cell's 27 nodes depend on its eight particles only
    assert (np.diff(energy) < 0.0).all()
