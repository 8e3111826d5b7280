"""Rows over 27 nodes against rows over free nodes: the same poses."""

from __future__ import annotations

import numpy as np
import pytest
from embedded import pose
from solids import ball, preset_material, settings

from gf_usd.core.stage import Pin
from gf_usd.physics.grid import embedding
from gf_usd.physics.grid.embedding import embedded_rows
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


def points(radius: float, count: int = 500) -> np.ndarray:
    """On the surface, and as far as two cells outside: there nodes are that no particle reaches."""
    rng = np.random.default_rng(0)
    way = rng.standard_normal((count, 3))
    return radius * rng.uniform(0.7, 1.8, (count, 1)) * way / np.linalg.norm(way, axis=1)[:, None]


@pytest.mark.parametrize("pinned", [False, True])
@pytest.mark.parametrize("chunk", [64, 10**6])
def test_poses_are_those_of_the_rows_over_free_nodes(monkeypatch, pinned: bool, chunk: int) -> None:
    body, _ = ball(400, radius=1.0)
    top = Pin(
        name="top",
        inside=lambda X: X[:, 1] > 0.5,
        nearest=lambda X: np.column_stack([X[:, 0], np.full(len(X), 0.5), X[:, 2]]),
        anchors=body.X[:4],
        path=body.X[None, :4],
    )
    solver = TotalLagrangian(
        body, [preset_material("rubber", body)], settings(), pins=[top] if pinned else []
    )
    X = points(1.0)
    on = np.zeros(len(X), int)
    plain = solver.body.stencil.rows(X, on)
    monkeypatch.setattr(embedding, "CHUNK", chunk)
    lean = embedded_rows(solver.body.stencil, X, on)
    assert lean.spread is not None
    assert lean.W.nnz == 27 * len(X)
    assert lean.W.nnz < plain.W.nnz
    assert lean.spread.shape[0] > solver.body.stencil.node_count, (
        "some lie beyond what particles reach"
    )
    rng = np.random.default_rng(1)
    u, v = (rng.standard_normal((plain.W.shape[1], 3)) for _ in range(2))
    offset = np.array([0.1, 2.0, -3.0])
    expected, found = pose(plain, u, v, offset), pose(lean, u, v, offset)
    # Sums of some hundred numbers of order one in another order; slopes are per h, a fifth of 1 m.
    np.testing.assert_allclose(found.x, expected.x, atol=1e-13)
    np.testing.assert_allclose(found.v, expected.v, atol=1e-13)
    np.testing.assert_allclose(found.F, expected.F, atol=1e-12)


def test_no_points_have_no_rows() -> None:
    body, _ = ball(400, radius=1.0)
    solver = TotalLagrangian(body, [preset_material("rubber", body)], settings())
    lean = embedded_rows(solver.body.stencil, np.zeros((0, 3)), np.zeros(0, int))
    u = np.ones((lean.spread.shape[1], 3))
    assert pose(lean, u, u, np.zeros(3)).x.shape == (0, 3)
