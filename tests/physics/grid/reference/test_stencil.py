"""The constant operators of the reference grid: what they reproduce, and where the mass goes."""

from __future__ import annotations

import numpy as np
import pytest
from solids import ball

from gf_usd.physics.grid.dependent_nodes import FREE_MASS, affine_fit, split_nodes
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.grid.reference.stencil import OFFSETS, Stencil, base_node, weights

# Sums of 27 terms of order one in f64: 27 times 1.1e-16, with room for positions of order one.
ROUNDING = 1e-14
# Fits go through a pseudo-inverse of normal equations, whose condition is that of the fit squared.
FIT_ROUNDING = 1e-11

SLOPE = np.array([[0.3, -0.7, 0.2], [1.1, 0.4, -0.5], [-0.2, 0.6, 0.9]])
SHIFT = np.array([0.3, -2.0, 1.0])


@pytest.fixture(scope="module")
def offsets_in_a_cell() -> np.ndarray:
    """(200, 3) distances from the base node, the ends of their range among them."""
    rng = np.random.default_rng(0)
    return np.concatenate([rng.uniform(0.5, 1.5, (198, 3)), np.full((2, 3), [[0.5], [1.0]])])


@pytest.fixture(scope="module")
def filled() -> tuple[np.ndarray, np.ndarray, Stencil]:
    """Positions [m] and masses [kg] of a ball's particles, uneven, and their stencil."""
    particles, _ = ball(800)
    m = np.random.default_rng(1).uniform(0.5, 1.5, len(particles))
    made = build_stencil(particles.X, m, 2.0 * particles.lattice, particles.corner)
    return particles.X, m, made


@pytest.mark.parametrize("h", [0.01, 1.0, 30.0])
def test_weights_reproduce_affine_fields_and_their_gradients(offsets_in_a_cell, h):
    fx = offsets_in_a_cell
    w, g = weights(fx, h)
    dX = h * (OFFSETS - fx[:, None, :])
    assert w.min() >= 0.0
    np.testing.assert_allclose(w.sum(1), 1.0, atol=ROUNDING)
    np.testing.assert_allclose(np.einsum("ni,nia->na", w, dX), 0.0, atol=h * ROUNDING)
    np.testing.assert_allclose(g.sum(1), 0.0, atol=ROUNDING / h)
    np.testing.assert_allclose(
        np.einsum("nia,nib->nab", dX, g), np.broadcast_to(np.eye(3), (200, 3, 3)), atol=ROUNDING
    )


@pytest.mark.parametrize("h", [0.01, 1.0, 30.0])
def test_the_second_moment_is_a_quarter_of_h_squared_wherever_the_point_lies(offsets_in_a_cell, h):
    w, _ = weights(offsets_in_a_cell, h)
    dX = h * (OFFSETS - offsets_in_a_cell[:, None, :])
    moment = np.einsum("ni,nia,nib->nab", w, dX, dX)
    np.testing.assert_allclose(4.0 / h**2 * moment, np.eye(3) + 0.0 * moment, atol=ROUNDING)


def test_gradients_are_the_slopes_of_the_weights(offsets_in_a_cell):
    h, step = 0.5, 1e-5
    fx = np.clip(offsets_in_a_cell, 0.5 + step, 1.5 - step)
    _, g = weights(fx, h)
    for axis in range(3):
        bump = step * np.eye(3)[axis]
        # A point that moves by +step * h is step farther from its base node.
        slope = (weights(fx + bump, h)[0] - weights(fx - bump, h)[0]) / (2.0 * step * h)
        # Quadratic along an axis: central differences are exact, up to 1e-16 / step.
        np.testing.assert_allclose(slope, g[..., axis], atol=1e-10)


def test_a_point_on_the_edge_of_a_cell_belongs_to_one_cell():
    base, fx = base_node(np.array([[0.5, 1.0, 1.4999999], [-0.5, -0.75, 2.5]]))
    np.testing.assert_array_equal(base, [[0, 0, 0], [-1, -2, 2]])
    assert fx.min() >= 0.5
    assert fx.max() < 1.5


def test_every_particle_is_in_one_cell_and_that_cell_reaches_it(filled):
    X, _, made = filled
    assert sorted(made.order) == list(range(len(X)))
    base, _ = made.base(X[made.order])
    cell = np.repeat(np.arange(len(made.cell_nodes)), np.diff(made.cell_start))
    nodes = made.node_ijk[made.cell_nodes[cell]]
    np.testing.assert_array_equal(nodes, base[:, None, :] + OFFSETS)


def test_nodes_carry_the_mass_of_the_body_and_its_first_moment(filled):
    X, m, made = filled
    assert made.mass.sum() == pytest.approx(m.sum(), rel=1e-13)  # sums of 800 and 300 terms
    np.testing.assert_allclose(made.mass @ made.free_X / m.sum(), m @ X / m.sum(), atol=1e-13)


def test_no_free_node_is_light(filled):
    X, m, made = filled
    w = made.rows(X).W
    assert (m @ w - made.mass) == pytest.approx(0.0, abs=1e-12)
    everyone = build_stencil(X, m, made.h, made.origin + 0.5 * made.h, free_mass=0.0)
    least = FREE_MASS * np.median(everyone.mass)
    assert everyone.mass.min() < 0.01 * least  # what would be free without dependent nodes
    assert made.mass.min() >= 0.5 * least
    assert made.free_count < made.node_count == everyone.free_count


def test_followers_move_exactly_with_an_affine_field(filled):
    _, _, made = filled
    assert made.follow.shape[0] > 100
    u = made.free_X @ SLOPE.T + SHIFT
    wanted = made.node_X[made.free_count :] @ SLOPE.T + SHIFT
    np.testing.assert_allclose(made.follow @ u, wanted, atol=FIT_ROUNDING)


def test_followers_hand_on_force_and_torque(filled):
    _, _, made = filled
    f = np.random.default_rng(2).normal(size=(made.follow.shape[0], 3))
    handed = made.follow.T @ f
    x, X = made.free_X, made.node_X[made.free_count :]
    # The adjoint of a fit that is exact for affine fields, rigid ones among them.
    np.testing.assert_allclose(handed.sum(0), f.sum(0), atol=len(f) * FIT_ROUNDING)
    torque = np.cross(x, handed).sum(0) - np.cross(X, f).sum(0)
    np.testing.assert_allclose(torque, 0.0, atol=len(f) * FIT_ROUNDING)


@pytest.mark.parametrize(
    "points",
    [
        pytest.param(lambda X: X, id="particles"),
        pytest.param(lambda X: 1.02 * X / np.linalg.norm(X, axis=1, keepdims=True), id="skin"),
        pytest.param(lambda X: 1.5 * X / np.linalg.norm(X, axis=1, keepdims=True), id="outside"),
        pytest.param(lambda X: X[:20] + [4.0, -3.0, 5.0], id="far away"),
    ],
)
def test_rows_anywhere_are_exact_for_affine_fields(filled, points):
    X, _, made = filled
    P = points(X)
    rows = made.rows(P)
    u = made.free_X @ SLOPE.T + SHIFT
    # A point six radii out is read through weights that grow with the distance in cells.
    reach = 1.0 + np.abs(P).max() / made.h
    np.testing.assert_allclose(rows.W @ u, P @ SLOPE.T + SHIFT, atol=reach * FIT_ROUNDING)
    gradient = np.stack([G @ u for G in rows.G], -1)
    np.testing.assert_allclose(gradient, SLOPE + 0.0 * gradient, atol=reach * FIT_ROUNDING / made.h)


@pytest.mark.parametrize("cells", [1.5, 3.0, 5.0, 40.0])
def test_points_off_a_flat_face_follow_every_affine_field(cells):
    # The 24 nodes nearest to a point some cells off a face all lie in that face.
    X = (np.stack(np.meshgrid(*[np.arange(16)] * 3, indexing="ij"), -1).reshape(-1, 3) + 0.5) / 16.0
    made = build_stencil(X, np.ones(len(X)), 0.125, np.zeros(3))
    P = np.array([[0.5, 1.0 + 0.125 * cells, 0.5], [-0.125 * cells, 0.3, 0.6]])
    rows = made.rows(P)
    u = made.free_X @ SLOPE.T + SHIFT
    np.testing.assert_allclose(rows.W @ u, P @ SLOPE.T + SHIFT, atol=(1 + cells) * FIT_ROUNDING)
    gradient = np.stack([G @ u for G in rows.G], -1)
    np.testing.assert_allclose(gradient, SLOPE + 0.0 * gradient, atol=(1 + cells) * FIT_ROUNDING)


def test_gather_and_scatter_of_momentum_agree(filled):
    # W^T m v of particles that move rigidly is the nodes' mass times the same motion of the nodes.
    X, m, made = filled
    w = np.array([0.3, -0.2, 0.5])
    rows = made.rows(X)
    p = rows.W.T @ (m[:, None] * np.cross(w, X))
    np.testing.assert_allclose(p.sum(0), (m[:, None] * np.cross(w, X)).sum(0), atol=1e-10)


def test_locate_knows_its_nodes_and_no_others(filled):
    _, _, made = filled
    np.testing.assert_array_equal(made.locate(made.node_ijk), np.arange(made.node_count))
    low, high = made.node_ijk.min(0), made.node_ijk.max(0)
    outside = np.stack([low - 1, high + 1, low + [0, 0, 10**6]])
    np.testing.assert_array_equal(made.locate(outside), -1)


def test_a_fit_to_nodes_in_a_plane_keeps_what_it_can():
    # A flat sheet of free nodes says nothing of the slope across it: least norm, finite, sum 1.
    plane = np.array([[x, y, 0] for x in range(5) for y in range(5)])
    e = affine_fit(np.array([[2, 2, 3], [6, 2, 0]]), plane)
    np.testing.assert_allclose(e.sum(1), 1.0, atol=FIT_ROUNDING)
    field = plane @ np.array([1.0, 2.0, 5.0])
    np.testing.assert_allclose(e @ field, [6.0, 10.0], atol=1e-9)


def test_a_fit_does_not_know_the_order_of_the_axes():
    """Many nodes of a lattice are equally near; to those far out even the nearest are."""
    free = np.stack(np.meshgrid(*[np.arange(7)] * 3, indexing="ij"), -1).reshape(-1, 3)
    free = free[free.sum(1) < 12]
    others = np.array([[7, 3, 2], [7, 7, 3], [-1, -2, 3], [6, 6, 4], [12, 12, 3], [3, -6, 3]])
    e = affine_fit(others, free).toarray()
    np.testing.assert_allclose(e @ free, others, atol=FIT_ROUNDING * 12)
    for order in ([0, 2, 1], [1, 2, 0], [2, 1, 0]):
        turned = free[:, order] * [1, -1, 1]
        same = affine_fit(others[:, order] * [1, -1, 1], turned).toarray()
        np.testing.assert_allclose(same, e, atol=FIT_ROUNDING)


def test_a_node_that_its_followers_would_pull_under_the_bound_follows_too():
    # Four light nodes at the end of a line hang on the next ones: extrapolation gives those that
    # are just heavy enough to be free shares below 0, in sum -.55 kg on the sixth.
    mass = np.array([0.099] * 4 + [1.0] + [0.1] * 5 + [1.0] * 14)
    line = np.arange(len(mass))[:, None] * [1, 0, 0]
    least = FREE_MASS * np.median(mass)
    heavy = mass >= least
    naive = mass[heavy] + affine_fit(line[~heavy], line[heavy]).T @ mass[~heavy]
    assert naive.min() < 0.0
    free, follow, lumped = split_nodes(line, mass)
    assert (~free).sum() > (~heavy).sum()
    assert not free[~heavy].any()
    assert (lumped >= 0.5 * least).all()
    # A lonely node's slope hangs on neighbors of weight 1e-6: 1e-16 / 1e-6, times a few cells.
    assert lumped.sum() == pytest.approx(mass.sum(), rel=1e-9)
    assert follow.shape == ((~free).sum(), free.sum())


def test_bodies_share_no_node_however_near_they_are() -> None:
    """Two halves of a ball as bodies of their own: each is what it is alone."""
    X, h = ball(600)[0].X, 0.3
    m = np.ones(len(X))
    side = (X[:, 0] > 0.1).astype(int)
    both = build_stencil(X, m, h, np.zeros(3), body=side)
    for k in (0, 1):
        mine = side == k
        alone = build_stencil(X[mine], m[mine], h, np.zeros(3))
        nodes = np.flatnonzero(both.node_body[: both.free_count] == k)
        assert len(nodes) == alone.free_count
        here = {tuple(np.round(x / h, 6)) for x in both.free_X[nodes]}
        assert here == {tuple(np.round(x / h, 6)) for x in alone.free_X}
        A, B = both.rows(X[mine], side[mine]).W, alone.rows(X[mine]).W
        others = np.setdiff1d(np.arange(both.free_count), nodes)
        assert abs(A[:, others]).sum() == 0.0
        # the same linear field is read the same
        u = both.free_X @ SLOPE.T
        np.testing.assert_allclose(A @ u, B @ (alone.free_X @ SLOPE.T), atol=1e-12)
    assert both.mass.sum() == pytest.approx(len(X))


def test_a_fit_far_from_a_thin_part_hardly_magnifies_errors() -> None:
    """Of leaves at a stem and of the shade of a lamp, which lie far from what is simulated."""
    stem = np.stack(np.meshgrid(np.arange(3), np.arange(20), np.arange(3), indexing="ij"), -1)
    stem = stem.reshape(-1, 3)
    e = affine_fit(np.array([[12, 10, 1], [1, 30, 1]]), stem).toarray()
    np.testing.assert_allclose(e @ stem, [[12, 10, 1], [1, 30, 1]], atol=FIT_ROUNDING * 30)
    # 5.5 and 5.9 with the 24 nodes nearest to the stem
    assert (np.linalg.norm(e, axis=1) < [1.8, 1.0]).all()
