"""Points embedded in particles: exact for affine maps, continuous, transposed for forces."""

from __future__ import annotations

import numpy as np
import pytest
from solids import ball

from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.updated_lagrangian.embedded_points import SUPPORT, embed

A = np.array([[1.10, 0.06, -0.03], [0.02, 0.62, 0.05], [-0.04, 0.33, 1.05]])
RATE = np.array([[0.3, -0.6, 0.1], [0.2, 0.2, 0.5], [-0.1, 0.3, -0.2]])  # [1/s]


@pytest.mark.parametrize("count", [1, 3, 9, 500])
def test_an_affine_map_is_exact_in_and_out_of_the_body(count):
    body = ball(500)[0].X[:count]
    points = np.random.default_rng(0).uniform(-1.3, 1.3, (200, 3))
    shift = np.array([0.3, -0.2, 5.0])
    n = len(body)
    F, L = (np.broadcast_to(M, (n, 3, 3)) for M in (A, RATE))
    x = body @ A.T + shift
    pose = embed(points, body).pose(x, x @ RATE.T, F, L)
    at = points @ A.T + shift
    np.testing.assert_allclose(pose.x, at, atol=1e-12)
    np.testing.assert_allclose(pose.v, at @ RATE.T, atol=1e-12)
    np.testing.assert_allclose(pose.F, np.broadcast_to(A, pose.F.shape), atol=1e-12)


def test_weights_sum_to_one_and_fade_before_a_carrier_changes():
    # Along a line the weight of whoever enters or leaves the eight is small: the place that they
    # move the point to does not jump where they disagree.
    body = ball(500)[0].X
    line = np.linspace([-1.0, 0.1, 0.05], [1.0, 0.2, -0.1], 20_001)
    embedding = embed(line, body)
    np.testing.assert_allclose(embedding.weight.sum(1), 1.0, rtol=1e-14)
    assert embedding.weight.min() >= 0.0
    rng = np.random.default_rng(0)
    x = body + 0.05 * rng.normal(size=body.shape)
    F = np.eye(3) + 0.1 * rng.normal(size=(len(body), 3, 3))
    at = embedding.pose(x, x, F, F).x
    step = np.linalg.norm(np.diff(at, axis=0), axis=1)
    changed = (np.diff(np.sort(embedding.particle, axis=1), axis=0) != 0).any(1)
    assert changed.sum() > 20
    # 1e-4 a step, and the particles' places and strains are off by a few of their own distances.
    assert step.max() < 20 * 1e-4


def test_velocity_is_the_time_derivative_of_the_place():
    body = ball(300)[0].X
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (50, 3))
    rng = np.random.default_rng(2)
    n = len(body)
    v = rng.normal(size=(n, 3))
    F = np.eye(3) + 0.2 * rng.normal(size=(n, 3, 3))
    L = rng.normal(size=(n, 3, 3))
    embedding, dt = embed(points, body), 1e-6
    before = embedding.pose(body, v, F, L)
    after = embedding.pose(body + dt * v, v, F + dt * L @ F, L)
    np.testing.assert_allclose((after.x - before.x) / dt, before.v, atol=1e-8)


def test_rows_are_the_motion_of_the_points_by_the_nodes():
    body, samples = ball(300)
    m = 1000.0 * body.V0
    grid = build_stencil(body.X, m, 2.0 * body.lattice, body.corner, free_mass=0.0)
    rows = grid.rows(body.X)
    embedding = embed(samples.X, body.X)
    nodes = np.random.default_rng(0).normal(size=(grid.node_count, 3))
    v = rows.W @ nodes
    L = np.stack([G @ nodes for G in rows.G], -1)
    F = np.broadcast_to(np.eye(3), L.shape)
    np.testing.assert_allclose(
        embedding.rows(rows) @ nodes, embedding.pose(body.X, v, F, L).v, atol=1e-12
    )


def test_few_particles_are_listed_again_with_no_weight():
    embedding = embed(np.zeros((4, 3)), np.eye(3))
    assert embedding.particle.shape == (4, SUPPORT)
    assert (embedding.weight[:, 3:] == 0.0).all()
