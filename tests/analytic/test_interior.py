"""The patch test's other half: a uniform stress pushes nothing inside the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from law_references import ENERGIES
from slow_parameters import longest_but
from solids import cube, fill, preset_material, settings, solid

from gf_usd.core.frames.particles import Particles
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

MAPS = {
    "shear": np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.1], [0.0, 0.0, 1.0]]),
    "squash": np.diag([1.15, 0.7, 1.15]),
    "turn and stretch": np.array([[0.0, -0.9, 0.0], [1.2, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}
DT = 1e-3  # [s]
# In single precision a law's stress is compared in test_patch.py.
KEPT = [(np.float32, token) for token in ("corotated", "neoHookean")]
KEPT += [(np.float64, token) for token in ("corotated", "vonMises", "crushable")]


def even_cube() -> Particles:
    """A unit cube whose 1728 particles lie in the middle of their strata."""
    particles, _ = fill(solid(cube()), 1728)
    i = np.arange(12)
    X = (np.stack(np.meshgrid(i, i, i, indexing="ij"), -1).reshape(-1, 3) + 0.5) / 12.0
    assert len(particles) == 1728
    np.testing.assert_allclose(particles.corner, 0.0, atol=1e-12)
    return replace(particles, X=X)


@pytest.mark.slow
@pytest.mark.parametrize("A", MAPS.values(), ids=MAPS.keys())
@pytest.mark.parametrize(
    ("real", "token"),
    longest_but([(real, t) for real in (np.float32, np.float64) for t in ENERGIES], *KEPT),
)
def test_nodes_inside_feel_nothing_and_nodes_at_the_skin_feel_the_traction(A, token, real):
    particles = even_cube()
    made = preset_material("rubber", particles, law=token, damping_time=0.0)
    # Without dependent nodes: those hand the traction of the skin on to nodes two cells deep.
    s = settings(frames=2, substeps=1, fps=1.0 / DT, followers=False)
    solver = TotalLagrangian(particles, [made], s, real=real)
    u = solver.body.stencil.node_X @ (A - np.eye(3)).T
    solver.state.arrays["u"].from_numpy(u.astype(real).ravel())
    solver.advance(1, 1)  # from rest, the kick of one step is the force of the patch
    force = solver.state.view().momentum / DT
    X, h = solver.body.stencil.free_X, solver.body.h
    inside = (np.abs(X - 0.5) < 0.5 - 1.4 * h).all(1)  # a spline reaches 1.5 h, nodes are h apart
    assert inside.sum() == 64
    # Two particles an axis in every cell integrate the spline's slope exactly, so forces of order
    # P h^2 cancel to the rounding of P: eps / h of u, over strains of a tenth, is some 10 eps, on
    # each of the 216 particles that push.
    size = np.abs(force[~inside]).max()
    assert size > 0.01 * made.mu * h**2
    eps = np.finfo(real).eps
    assert np.abs(force[inside]).max() < 216 * 10 * eps * made.mu * h**2
    # And all of them together push nowhere.
    np.testing.assert_allclose(force.sum(0), 0.0, atol=len(X) * 10 * eps * made.mu * h**2)
