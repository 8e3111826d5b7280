"""The kernels that do eight cells at once, against the plain sums they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from strained_ball import corotated, force, made, shear_modulus

from gf_usd.physics.total_lagrangian.layout import batch_particles


@pytest.mark.slow
def test_forces_are_the_plain_sum_over_particles():
    solver = made(np.float64)
    X = solver.body.stencil.node_X
    u = 0.05 * np.stack([np.sin(2.0 * X[:, 1]), X[:, 0] * X[:, 2], np.cos(X[:, 0])], -1)
    free = solver.body.stencil.free_count
    u[free:] = solver.body.stencil.follow @ u[:free]
    solver.state.arrays["u"].from_numpy(u.ravel())
    G = [G @ solver.body.rows.spread for G in solver.body.rows.G]
    F = np.eye(3) + np.stack([g @ u[:free] for g in G], -1)
    mu, lam = solver.body.per["mu"][0], solver.body.per["lam"][0]
    assert mu == shear_modulus()
    T = solver.particles.V0[:, None, None] * corotated(F, mu, lam)
    expected = -sum(G[a].T @ T[:, :, a] for a in range(3))
    # the frame is so short that u moves by 1e-9 of itself; force reads m v / dt off it
    np.testing.assert_allclose(force(solver), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_every_particle_has_one_lane_of_its_own():
    solver = made()
    batches = batch_particles(solver.body.stencil)
    filled = batches.filled > 0.0
    assert sorted(batches.source[filled]) == list(range(len(solver.particles)))
    cell = np.repeat(np.arange(len(batches.cells)), np.diff(batches.batch))
    owner = np.empty(len(solver.particles), int)
    owner[solver.body.stencil.order] = np.repeat(
        np.arange(len(solver.body.stencil.cell_nodes)), np.diff(solver.body.stencil.cell_start)
    )
    # a lane belongs to one cell, whose nodes its batches use
    assert np.array_equal(owner[batches.source][filled], batches.cells[cell][filled])
