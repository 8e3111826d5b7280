"""The mass matrix of the nodes: its springs, its inverse, the momenta and inertia it gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from solids import ball

from gf_usd.core.stage import Pin
from gf_usd.physics.grid import mass as grid_mass
from gf_usd.physics.grid.mass import (
    cell_springs,
    consistent_mass,
    links,
    lumped_mass,
    particle_springs,
)
from gf_usd.physics.grid.pins import PinConstraint
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.grid.reference.stencil import OFFSETS, Stencil, weights
from gf_usd.physics.grid.spectrum import ACCURACY

# Conjugate gradients end at 1e-13 of the right side; the matrix has a condition of about five.
SOLVED = 1e-11


def of_ball(count: int = 800, even: bool = True, **options):
    """Positions [m] and masses [kg] of a ball's particles, their stencil and its mass."""
    particles, _ = ball(count)
    m = particles.V0 if even else np.random.default_rng(1).uniform(0.5, 1.5, len(particles))
    made = build_stencil(particles.X, m, 2.0 * particles.lattice, particles.corner, **options)
    return particles.X, m, made, consistent_mass(made, m)


def consistent(made: Stencil, X, m) -> np.ndarray:
    """MC_ij = sum_p m_p w_ip w_jp of the free nodes, dense."""
    W = made.rows(X).W[:, : made.free_count]
    return (W.T @ sparse.diags_array(m) @ W).toarray()


def test_the_springs_of_a_particle_push_as_its_weights_spread():
    # sum_i w_i (X_i - X_p) on each node, which is what lumping adds to the momentum of X.
    rng = np.random.default_rng(0)
    fx, m = rng.uniform(0.5, 1.5, (50, 3)), rng.uniform(0.5, 2.0, 50)
    k = particle_springs(fx, m)
    assert k.min() >= 0.0
    low, high = links()
    w, _ = weights(fx, 1.0)
    wanted = (m[:, None] * w)[..., None] * (OFFSETS - fx[:, None, :])
    found = np.zeros_like(wanted)
    pull = k[..., None] * (OFFSETS[high] - OFFSETS[low])
    for e, (i, j) in enumerate(zip(low, high)):
        found[:, j] += pull[:, e]
        found[:, i] -= pull[:, e]
    np.testing.assert_allclose(found, wanted, atol=1e-14)


def test_cells_sum_the_springs_of_their_particles(monkeypatch):
    _, m, made, _ = of_ball()
    whole = cell_springs(made, m)
    assert whole.sum() == pytest.approx(0.75 * m.sum(), rel=1e-12)  # h^2/4 along each of three axes
    monkeypatch.setattr("gf_usd.physics.grid.mass.CHUNK", 37)
    np.testing.assert_allclose(cell_springs(made, m), whole, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("even", [True, False])
def test_it_is_symmetric_positive_definite_and_keeps_the_masses_of_the_nodes(even):
    _, _, made, mass = of_ball(even=even)
    n = made.free_count
    A = mass.acceleration(np.eye(n))
    np.testing.assert_allclose(A, A.T, atol=1e-13 * np.abs(A).max())
    scaled = np.sqrt(made.mass)[:, None] * A * np.sqrt(made.mass)
    values = np.linalg.eigvalsh(scaled)
    assert values.min() > 0.999  # no motion is heavier than lumped, but for the springs left out
    # Where the largest ones lie close together Lanczos' value is one of them.
    assert values.max() == pytest.approx(mass.lightest, rel=2.0 * ACCURACY)
    ones = np.ones((n, 1))
    np.testing.assert_allclose(mass.acceleration(made.mass[:, None] * ones), ones, atol=1e-12)


def test_momentum_is_the_inverse_of_acceleration():
    _, _, made, mass = of_ball()
    v = np.random.default_rng(2).normal(size=(made.free_count, 3))
    p = mass.momentum(v)
    np.testing.assert_allclose(mass.acceleration(p), v, atol=SOLVED)
    np.testing.assert_allclose(p.sum(0), made.mass @ v, atol=SOLVED * made.mass.sum())
    assert (v * p).sum() < made.mass @ (v**2).sum(1)
    still = mass.momentum(np.zeros_like(v))
    np.testing.assert_array_equal(still, 0.0)


def test_many_nodes_have_the_same_momentum_to_the_bit(monkeypatch):
    _, _, made, mass = of_ball()
    v = np.random.default_rng(3).normal(size=(made.free_count, 3))
    monkeypatch.setattr(grid_mass, "MANY", len(v) + 1)
    few = mass.momentum(v)
    monkeypatch.setattr(grid_mass, "MANY", 1)
    np.testing.assert_array_equal(mass.momentum(v), few)


@pytest.mark.parametrize("even", [True, False])
def test_the_inertia_is_that_of_the_particles(even):
    X, m, made, mass = of_ball(even=even)
    own = (m[:, None] * X).T @ X
    of_nodes = made.free_X.T @ mass.momentum(made.free_X)
    lumped = (made.mass[:, None] * made.free_X).T @ made.free_X
    size = np.trace(own) / 3.0
    assert np.abs(lumped - own).max() > 0.1 * size
    np.testing.assert_allclose(of_nodes, own, atol=1e-3 * size)


def test_smooth_velocities_have_the_momentum_of_the_consistent_mass():
    X, m, made, mass = of_ball(3000)
    C = consistent(made, X, m)
    x = made.free_X
    v = np.stack([np.sin(2.0 * x[:, 1]), np.cos(2.0 * x[:, 2]), np.sin(2.0 * x[:, 0])], -1)
    energy = [float((v * p).sum()) for p in (C @ v, mass.momentum(v), made.mass[:, None] * v)]
    # Lumping adds (k h)^2 / 4 = 5 %; what is left is of the next order, (k h)^4 / 16 = .3 %.
    kh = 2.0 * made.h
    assert abs(energy[2] / energy[0] - 1.0) > 0.5 * kh**2 / 4.0
    assert abs(energy[1] / energy[0] - 1.0) < kh**4 / 16.0


def test_bodies_have_their_own_inertia():
    X, m, _, _ = of_ball(300)
    both = np.concatenate([X, X + [3.0, 0.0, 0.0]])
    side = np.repeat([0, 1], len(X))
    h = 0.4
    made = build_stencil(both, np.tile(m, 2), h, np.zeros(3), body=side)
    p = consistent_mass(made, np.tile(m, 2)).momentum(made.free_X)
    body = made.node_body[: made.free_count]
    for k in (0, 1):
        # About its own middle, since the shift of the middle is carried by the masses.
        center = both[side == k].T @ m / m.sum()
        rel = made.free_X[body == k] - center
        shifted = p[body == k] - made.mass[body == k, None] * center
        own = (m[:, None] * (both[side == k] - center) ** 2).sum()
        assert (rel * shifted).sum() == pytest.approx(own, rel=2e-3)


def test_next_to_a_pin_masses_are_tied_to_the_ground():
    particles, _ = ball(800)

    def inside(X):
        return X[:, 0] < -0.5

    def nearest(X):
        return np.stack([np.full(len(X), -0.5), X[:, 1], X[:, 2]], 1)

    anchors = np.vstack([np.zeros(3), np.eye(3)])
    pin = Pin(name="clamp", inside=inside, nearest=nearest, anchors=anchors, path=anchors[None])
    m = np.where(inside(particles.X), 0.0, particles.V0)
    made = build_stencil(
        particles.X, m, 2.0 * particles.lattice, particles.corner,
        pin_constraint=PinConstraint([pin], particles.X),
    )  # fmt: skip
    mass = consistent_mass(made, m)
    tied = mass.ground > 0.0
    assert tied.any()
    assert np.abs(mass.ground).max() < 4.0 * made.mass.max()
    # Only nodes whose splines reach over the pin's boundary.
    assert made.free_X[tied, 0].max() < -0.5 + 5.0 * made.h
    values = np.linalg.eigvalsh(
        np.sqrt(made.mass)[:, None] * mass.acceleration(np.eye(made.free_count))
        * np.sqrt(made.mass)
    )  # fmt: skip
    assert values.min() > 0.5


def test_lumped_is_the_sum_of_the_rows():
    _, _, made, mass = of_ball()
    plain = lumped_mass(made)
    assert plain.is_lumped
    assert not mass.is_lumped
    assert plain.lightest == 1.0
    v = np.random.default_rng(3).normal(size=(made.free_count, 3))
    np.testing.assert_array_equal(plain.momentum(v), made.mass[:, None] * v)
    np.testing.assert_allclose(plain.acceleration(v), v / made.mass[:, None], rtol=1e-15)
