"""The parts of skins: weights, the gradient at rest and the polar stretch."""

from __future__ import annotations

import numpy as np
import solids
from scipy.linalg import polar

from gf_usd.core.matrices import stretch
from gf_usd.core.neighbors import slopes
from gf_usd.geometry.skinning import (
    CHUNK_BYTES,
    NEIGHBORS,
    CloudWeights,
    inverse_distance,
    nearest_weights,
    rest_gradient,
)
from gf_usd.physics.per_particle import nearest_rotation

ROUNDING = 1e-12  # numbers near 1 in float64, sums of hundreds of terms
BALL, _ = solids.ball(500)
VERTICES = solids.sphere(subdivisions=2).points
AFFINE = np.array([[1.3, 0.4, -0.2], [-0.5, 0.8, 0.1], [0.3, 0.2, 1.1]])
SHIFT = np.array([3.0, -2.0, 0.5])


def test_weights_sum_to_one() -> None:
    nearest = nearest_weights(VERTICES, BALL.X, NEIGHBORS, 4.0)
    np.testing.assert_allclose(nearest.sum(1), 1.0, atol=ROUNDING)
    assert nearest.data.min() > 0.0
    assert (np.diff(nearest.indptr) == NEIGHBORS).all()
    cloud = CloudWeights(VERTICES, BALL.X, 2.0, CHUNK_BYTES)
    np.testing.assert_allclose(cloud @ np.ones((len(BALL), 1)), 1.0, atol=ROUNDING)


def test_weights_follow_the_power_whatever_the_unit() -> None:
    # d = 1, 2, 4: d^-4 = 1, 1/16, 1/256; in units in which d^4 leaves the range of float64 too.
    expected = np.array([256.0, 16.0, 1.0]) / 273.0
    for unit in (1.0, 1e-120, 1e120):
        w = inverse_distance((unit * np.array([1.0, 2.0, 4.0])) ** 2, 4.0)
        np.testing.assert_allclose(w, expected, rtol=ROUNDING)


def test_few_particles_all_carry() -> None:
    few = BALL.X[:20]
    W = nearest_weights(VERTICES, few, NEIGHBORS, 2.0)
    full = CloudWeights(VERTICES, few, 2.0, CHUNK_BYTES) @ np.eye(20)
    np.testing.assert_allclose(W.toarray(), full, atol=ROUNDING)


def test_vertex_on_two_particles_follows_their_mean() -> None:
    twice = np.concatenate([BALL.X, BALL.X[7:8]])
    W = nearest_weights(BALL.X[7:8], twice, NEIGHBORS, 4.0).toarray()[0]
    assert W[[7, len(BALL)]].tolist() == [0.5, 0.5]
    assert W.sum() == 1.0


def test_stretch_is_the_polar_factor_and_its_rate() -> None:
    rng = np.random.default_rng(3)
    F, rate = rng.normal(size=(50, 3, 3)), rng.normal(size=(50, 3, 3))
    assert (np.linalg.det(F) < 0.0).any()  # inverted particles have a stretch too
    U, dU = stretch(F, rate)
    # The smallest singular value of fifty is near .01; the square of F loses that much.
    np.testing.assert_allclose(U, [polar(f)[1] for f in F], atol=1e-10)
    e = 1e-6
    difference = (stretch(F + e * rate, rate)[0] - stretch(F - e * rate, rate)[0]) / (2.0 * e)
    np.testing.assert_allclose(dU, difference, atol=1e-5)


def test_stretch_with_a_known_rotation_is_the_same() -> None:
    rng = np.random.default_rng(4)
    F, rate = rng.normal(size=(60, 3, 3)), rng.normal(size=(60, 3, 3))
    F[0] = np.diag([2.0, 0.0, 0.0])  # a line
    F[1] = np.diag([2.0, 1e-4, 1e-5])
    F[2] = np.eye(3)
    F[3] *= -np.sign(np.linalg.det(F[3]))  # inverted
    R = nearest_rotation(F)
    for found, known in zip(stretch(F, rate, R), stretch(F, rate)):
        np.testing.assert_allclose(found, known, atol=1e-6)
    kept = np.linalg.det(F) > 0.01
    assert 10 < kept.sum() < 50
    for found, known in zip(stretch(F, rate, R), stretch(F, rate)):
        np.testing.assert_allclose(found[kept], known[kept], atol=1e-11)


def test_stretch_of_a_particle_squashed_to_a_line() -> None:
    F = np.diag([2.0, 0.0, 0.0])[None]
    U, dU = stretch(F, np.eye(3)[None])
    np.testing.assert_allclose(U, F, atol=1e-8)
    np.testing.assert_allclose(dU, [np.diag([1.0, 0.0, 0.0])], atol=1e-8)


def test_gradient_is_exact_for_affine_fields() -> None:
    D = rest_gradient(BALL.X)
    found = slopes(D, BALL.X @ AFFINE.T + SHIFT)
    np.testing.assert_allclose(
        found, np.broadcast_to(AFFINE, found.shape), atol=100 * ROUNDING
    )  # 1 / spacing and the condition of M


def test_gradient_of_a_single_layer_has_nothing_across() -> None:
    layer = BALL.X * np.array([1.0, 0.0, 1.0])
    layer = np.concatenate([layer, layer[:1]])  # and one particle twice
    found = slopes(rest_gradient(layer), layer @ AFFINE.T)
    expected = AFFINE * np.array([1.0, 0.0, 1.0])
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-9)
