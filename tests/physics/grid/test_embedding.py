"""Embedded points: exact for affine maps, inside and out."""

from __future__ import annotations

import numpy as np
import pytest
from embedded import pose
from random_turns import random_turns
from scipy import sparse
from solids import ball

from gf_usd.core.matrices import cofactors, entries
from gf_usd.physics.grid import embedding
from gf_usd.physics.grid.embedding import (
    deform_normals,
    embedded_rows,
    gathered,
    particle_rows,
    stretches,
)
from gf_usd.physics.grid.reference.build import build_stencil

# Rows are sums of some hundred f64 terms whose affine fits carry 1e-11 at most (test_stencil.py).
ROUNDING = 1e-10

MAPS = {
    "rest": np.eye(3),
    "quarter turn": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "half turn": np.diag([-1.0, -1.0, 1.0]),
    "squash": np.diag([1.3, 0.5, 1.3]),
    "shear": np.array([[1.0, 0.8, 0.0], [0.0, 1.0, 0.0], [0.0, -0.3, 1.0]]),
    "mirror": np.diag([1.0, -0.7, 1.0]),
    "collapse": np.diag([1.0, 0.0, 1.0]),
}
every_map = pytest.mark.parametrize("A", MAPS.values(), ids=MAPS.keys())


@pytest.fixture(scope="module")
def body():
    """A stencil of a unit ball, and points inside it, on its skin and off it."""
    particles, _ = ball(500)
    m = np.full(len(particles), 0.1)
    made = build_stencil(particles.X, m, 2.0 * particles.lattice, particles.corner)
    d = np.random.default_rng(0).normal(size=(60, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return made, np.concatenate([0.5 * d, d, 1.05 * d, 1.6 * d])


@every_map
def test_points_follow_an_affine_map_exactly(body, A):
    made, X = body
    shift, spin, offset = np.array([0.2, 3.0, -1.0]), 0.7 * A + 0.1, np.array([0.0, 5.0, 0.0])
    u = made.free_X @ (A - np.eye(3)).T + shift
    v = made.free_X @ spin.T + shift
    out = pose(made.rows(X), u, v, offset)
    np.testing.assert_allclose(out.x, X @ A.T + shift + offset, atol=ROUNDING)
    np.testing.assert_allclose(out.v, X @ spin.T + shift, atol=ROUNDING)
    np.testing.assert_allclose(out.F, A + 0.0 * out.F, atol=ROUNDING / made.h)


def test_curvature_is_reproduced_to_second_order(body):
    # u = X_x^2 e_y: quadratic splines over samples at nodes smooth x^2 by exactly h^2 / 4.
    made, X = body
    X = X[:60]  # inside, where no node is extrapolated
    near = build_stencil(X, np.ones(len(X)), made.h, made.origin + 0.5 * made.h, free_mass=0.0)
    u = np.zeros((near.free_count, 3))
    u[:, 1] = near.free_X[:, 0] ** 2
    out = pose(near.rows(X), u, 0.0 * u, np.zeros(3))
    np.testing.assert_allclose(out.x[:, 1], X[:, 1] + X[:, 0] ** 2 + made.h**2 / 4.0, atol=1e-13)
    np.testing.assert_allclose(out.F[:, 1, 0], 2.0 * X[:, 0], atol=1e-12)


@pytest.mark.parametrize(("kink", "cells"), [(0.0, 1.0), (0.5, 2.0)])
def test_a_crease_is_as_wide_as_a_cell_or_two(kink, cells):
    # u = |x - x0| at the nodes: the slope of quadratic splines runs linearly between differences,
    # which are +-1 but for that across a kink halfway between two nodes.
    h = 0.25
    x = np.linspace(-0.99, 0.99, 991)
    X = np.stack([x, 0.0 * x, 0.0 * x], 1)
    made = build_stencil(X, np.ones(len(X)), h, np.zeros(3), free_mass=0.0)
    x0 = made.free_X[np.argmin(np.abs(made.free_X[:, 0])), 0] + kink * h
    u = np.zeros((made.free_count, 3))
    u[:, 1] = np.abs(made.free_X[:, 0] - x0)
    slope = pose(made.rows(X), u, 0.0 * u, np.zeros(3)).F[:, 1, 0]
    bent = np.abs(slope) < 1.0 - 1e-9
    assert np.ptp(x[bent]) == pytest.approx(cells * h, abs=2.0 * (x[1] - x[0]))
    np.testing.assert_allclose(slope[~bent], np.sign(x - x0)[~bent], atol=1e-9)


def cofactor(F):
    return cofactors(entries(F)).T.reshape(-1, 3, 3)


@every_map
def test_the_cofactor_is_j_times_the_inverse_transpose(A):
    near = A + 1e-3 * np.array([[0.0, 1.0, 2.0], [-1.0, 3.0, 1.0], [2.0, 0.0, 1.0]])
    wanted = np.linalg.det(near) * np.linalg.inv(near).T
    # Inverting loses the digits of the condition number, below 1e4 here.
    np.testing.assert_allclose(cofactor(near)[0], wanted, atol=1e-12)


def test_the_cofactor_is_defined_where_the_inverse_is_not():
    np.testing.assert_array_equal(cofactor(MAPS["collapse"])[0], np.diag([0.0, 1.0, 0.0]))
    np.testing.assert_array_equal(cofactor(np.zeros((2, 3, 3))), np.zeros((2, 3, 3)))


@pytest.mark.parametrize("name", ["rest", "quarter turn", "squash", "shear"])
def test_normals_stay_across_the_surface_and_outside(name):
    F = MAPS[name][None]
    rng = np.random.default_rng(3)
    n = rng.normal(size=(50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t = np.cross(n, rng.normal(size=(50, 3)))
    out = deform_normals(n, np.zeros(50, int), F)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(((t @ F[0].T) * out).sum(1), 0.0, atol=1e-14)
    assert ((n @ F[0].T * out).sum(1) > 0.0).all()


def test_each_normal_turns_with_its_own_point():
    F = np.stack([MAPS["rest"], MAPS["quarter turn"]])
    n = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    out = deform_normals(n, np.array([0, 1, 1]), F)
    np.testing.assert_allclose(out, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], atol=1e-15)


def test_a_normal_with_nothing_left_of_its_surface_stays_as_it_was():
    n = np.array([[0.6, 0.0, 0.8]])
    np.testing.assert_array_equal(deform_normals(n, np.zeros(1, int), np.zeros((1, 3, 3))), n)


def test_a_rigid_turn_of_the_body_turns_every_normal(body):
    made, X = body
    R = random_turns(1, 4)[0]
    u = made.free_X @ (R - np.eye(3)).T
    out = pose(made.rows(X), u, 0.0 * u, np.zeros(3))
    n = X / np.linalg.norm(X, axis=1, keepdims=True)
    turned = deform_normals(n, np.arange(len(X)), out.F)
    np.testing.assert_allclose(turned, n @ R.T, atol=2.0 * ROUNDING / made.h)


@pytest.fixture(scope="module")
def spline_rows(body):
    """Rows of points in and near the ball, some of whose nodes no particle reaches."""
    made, X = body
    return embedded_rows(made, X, np.zeros(len(X), int))


@pytest.fixture
def nodal(spline_rows):
    """u and v of what the rows stack."""
    return np.random.default_rng(5).normal(size=(2, spline_rows.spread.shape[1], 3))


def test_many_points_are_embedded_in_one_pass(spline_rows, nodal, monkeypatch):
    """The kernel and SciPy's products: sums of 27 terms below 1 / h in another order."""
    offset = np.array([0.1, -2.0, 3.0])
    plain = pose(spline_rows, *nodal, offset)
    assert not spline_rows.uses_kernels
    monkeypatch.setattr(embedding, "FEW", 1)
    assert spline_rows.uses_kernels
    once = pose(spline_rows, *nodal, offset)
    most = np.abs(spline_rows.nodes(nodal[0])).max()
    for name in ("x", "v", "F"):
        off = np.abs(getattr(plain, name) - getattr(once, name)).max()
        assert off < 27 * 1e-15 * max(most, 3.0) / spline_rows.h, name
    D = stretches(spline_rows, spline_rows.nodes(nodal[0]))
    np.testing.assert_allclose(D, once.F - np.eye(3), atol=1e-14 * most / spline_rows.h)


@pytest.mark.parametrize("few", [1, 10_000], ids=["kernel", "products"])
def test_what_is_gathered_is_the_transpose_of_what_stretches(spline_rows, nodal, few, monkeypatch):
    monkeypatch.setattr(embedding, "FEW", few)
    U = spline_rows.nodes(nodal[0])
    P = np.random.default_rng(6).normal(size=(len(spline_rows.X), 3, 3))
    D, f = stretches(spline_rows, U), gathered(spline_rows, P)
    assert (P * D).sum() == pytest.approx((f * U).sum(), rel=1e-12, abs=1e-10)


def test_particles_have_the_rows_of_any_points_where_they_are():
    particles, _ = ball(300)
    m = np.full(len(particles), 0.1)
    made = build_stencil(particles.X, m, 2.0 * particles.lattice, particles.corner)
    ours, any_points = particle_rows(made, particles.X), made.rows(particles.X)
    assert abs(ours.combined - any_points.W).max() < 1e-12
    u = np.random.default_rng(7).normal(size=(made.free_count, 3))
    np.testing.assert_allclose(
        stretches(ours, ours.nodes(u)), np.stack([G @ u for G in any_points.G], -1),
        atol=1e-11 / made.h,
    )  # fmt: skip


def test_products_are_the_same_bits_by_the_kernel():
    """The method depends on the size and the device, the result must not."""
    rng = np.random.default_rng(5)
    M = sparse.random_array((301, 120), density=0.2, format="csr", rng=rng)
    M.indptr, M.indices = M.indptr.astype(np.int32), M.indices.astype(np.int32)
    M.data[7] = 1e200  # some cancel, some differ by many orders
    M.data[0] = -abs(M.data[0])
    M.data[M.indptr[5] : M.indptr[6]] = 0.0  # a sum of zeros has a sign, too
    u = rng.normal(size=(120, 3)) * 10.0 ** rng.uniform(-9.0, 9.0, (120, 1))
    assert np.diff(M.indptr).min() < np.diff(M.indptr).max()
    assert embedding.uses_kernel(M, u) is False
    plain = embedding.product(M, u)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(embedding, "MANY", 1)
        assert embedding.uses_kernel(M, u)
        assert embedding.product(M, u).tobytes() == plain.tobytes()
