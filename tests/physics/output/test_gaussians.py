"""Deformed Gaussians: Sigma = F Sigma0 F^T, and axes that do not jump in time."""

import numpy as np
import pytest
from random_turns import random_turns
from scipy.spatial.transform import Rotation

from gf_usd.core.frames.frame import GaussianPose, Pose
from gf_usd.core.matrices import matrix_from_quaternion
from gf_usd.physics.output.gaussian_kernels import (
    LANES,
    Lanes,
    diagonalize,
    from_lanes,
    keep,
    numbers,
    quaternion,
    to_lanes,
)
from gf_usd.physics.output.gaussians import GaussianTrack
from gf_usd.physics.per_particle import nearest_rotation
from gf_usd.system.taichi_runtime import ensure_running, import_taichi

ti = import_taichi()

DISC = np.array([0.15, 0.6, 0.6])  # (sigma_r, sigma_t, sigma_t), the rest shape of the sampler


@ti.kernel
def each_quaternion(R: Lanes, q: Lanes, groups: ti.i32):
    for g in range(groups):
        keep(q, g, groups, quaternion(numbers(R, g, groups, 9)))


@ti.kernel
def each_diagonal(S: Lanes, Q: Lanes, groups: ti.i32):
    for g in range(groups):
        diagonal = numbers(S, g, groups, 9)
        keep(Q, g, groups, diagonalize(diagonal))
        keep(S, g, groups, diagonal)


def quaternion_from_matrix(R: np.ndarray) -> np.ndarray:
    ensure_running()
    lanes, q = to_lanes(R), to_lanes(np.empty((len(R), 4)))
    each_quaternion(lanes, q, len(q) // 4)
    return from_lanes(q, len(R), 4)


def jacobi(S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    ensure_running()
    D, Q = to_lanes(S), to_lanes(S)
    each_diagonal(D, Q, len(D) // 9)
    upper = np.triu(from_lanes(D, len(S), 3, 3))
    return upper + np.triu(upper, 1).swapaxes(1, 2), from_lanes(Q, len(S), 3, 3)


def quaternions(n: int, seed: int) -> np.ndarray:
    """(n, 4) random unit quaternions (w, x, y, z)."""
    q = np.random.default_rng(seed).normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def at(F: np.ndarray) -> Pose:
    n = len(F)
    return Pose(x=np.arange(3.0 * n).reshape(n, 3), v=np.ones((n, 3)), F=F)


def covariance(out: GaussianPose) -> np.ndarray:
    """Q diag(s^2) Q^T as USD rebuilds it."""
    A = matrix_from_quaternion(out.orientations) * np.asarray(out.scales)[:, None, :]
    return A @ A.swapaxes(1, 2)


def rest(q: np.ndarray, scale: np.ndarray) -> np.ndarray:
    A = matrix_from_quaternion(q) * scale[:, None, :]
    return A @ A.swapaxes(1, 2)


def test_quaternions_and_matrices_agree_with_scipy_and_each_other():
    q = np.concatenate([quaternions(50, 0), np.eye(4)])
    R = matrix_from_quaternion(q)
    np.testing.assert_allclose(R, Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix(), atol=1e-15)
    back = quaternion_from_matrix(R)
    np.testing.assert_allclose(np.abs((back * q).sum(1)), 1.0, atol=1e-15)


def test_the_covariance_is_that_of_the_map_whatever_the_map():
    n = 200
    q, scale = quaternions(n, 1), np.random.default_rng(2).uniform(0.1, 1.0, (n, 3))
    F = np.random.default_rng(3).normal(size=(n, 3, 3))  # half of them inverted
    assert (np.linalg.det(F) < 0.0).sum() > 50
    out = GaussianTrack(q, scale).advance(at(F))
    Sigma = F @ rest(q, scale) @ F.swapaxes(1, 2)
    # Jacobi sweeps leave 1e-14 of the trace (about 10 here) off the diagonal.
    np.testing.assert_allclose(covariance(out), Sigma, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(out.orientations, axis=1), 1.0, atol=1e-15)
    assert (np.linalg.det(matrix_from_quaternion(out.orientations)) > 0.0).all()
    np.testing.assert_array_equal(out.positions, at(F).x)


def test_at_rest_nothing_changes():
    q = quaternions(20, 4)
    out = GaussianTrack(q, np.tile(DISC, (20, 1))).advance(at(np.tile(np.eye(3), (20, 1, 1))))
    np.testing.assert_allclose(out.orientations, q, atol=1e-15)
    np.testing.assert_allclose(out.scales, np.tile(DISC, (20, 1)), rtol=1e-15)


def test_a_flattened_particle_has_a_scale_of_nothing_and_stays_finite():
    F = np.stack([np.diag([1.0, 0.0, 1.0]), np.zeros((3, 3)), np.diag([1.0, 0.0, 0.0])])
    out = GaussianTrack(quaternions(3, 5), np.tile(DISC, (3, 1))).advance(at(F))
    np.testing.assert_allclose(np.asarray(out.scales).min(1), 0.0, atol=1e-8)  # root of 1e-16
    assert np.isfinite(out.orientations).all()
    np.testing.assert_allclose(out.scales[1], 0.0, atol=1e-15)


def track_through(gradients: list[np.ndarray], q: np.ndarray, scale: np.ndarray):
    """Largest turn [rad] and largest change of a scale between frames, and the last pose."""
    track = GaussianTrack(q, scale)
    turn, change, last = 0.0, 0.0, None
    for F in gradients:
        out = track.advance(at(F))
        Sigma = F @ rest(q, scale) @ F.swapaxes(1, 2)
        np.testing.assert_allclose(covariance(out), Sigma, atol=1e-12)
        if last is not None:
            dot = (np.asarray(out.orientations) * last.orientations).sum(1)
            assert (dot > 0.0).all()  # a client blends q with q, never with -q
            turn = max(turn, float(2.0 * np.arccos(np.minimum(dot, 1.0)).max()))
            change = max(change, float(np.abs(np.asarray(out.scales) - last.scales).max()))
        last = out
    return turn, change, last


@pytest.mark.parametrize("axis", [[0.0, 1.0, 0.0], [1.0, 2.0, -0.5]])
@pytest.mark.parametrize("degrees", [10.0, 60.0, 120.0])
def test_a_full_spin_is_followed_step_by_step(axis, degrees):
    # Each Gaussian turns with the squashed body, beyond 45 degrees a frame too, where the nearest
    # axes are others than its own.
    n, step = 40, np.radians(degrees)
    axis = np.array(axis) / np.linalg.norm(axis)
    squash = np.diag([1.2, 0.7, 1.0])
    spin = [
        np.tile(Rotation.from_rotvec(k * step * axis).as_matrix() @ squash, (n, 1, 1))
        for k in range(round(360.0 / degrees) + 1)
    ]
    q = quaternions(n, 6)
    turn, change, last = track_through(spin, q, np.tile(DISC, (n, 1)))
    assert turn == pytest.approx(step, abs=1e-7)  # arccos near 1 halves the digits
    assert change < 1e-12
    # Once round, the axes are back where they were: a track that slips would not close.
    first = GaussianTrack(q, np.tile(DISC, (n, 1))).advance(at(spin[0]))
    np.testing.assert_allclose(
        np.abs((np.asarray(last.orientations) * first.orientations).sum(1)), 1.0, atol=1e-12
    )


def test_scales_that_pass_each_other_do_not_swap_axes():
    # The tangential scales .6 and .6 a part and cross at frame 25, off the coordinate axes.
    n = 30
    q = quaternions(n, 7)
    Q = matrix_from_quaternion(q)
    path = []
    for s in np.linspace(0.8, 1.25, 51):
        path.append((Q * np.array([1.0, s, 1.0 / s])) @ Q.swapaxes(1, 2))
    turn, change, last = track_through(path, q, np.tile(DISC, (n, 1)))
    # Along its own axes nothing turns at all; a sorted eigenbasis would turn by 90 degrees once.
    # Near the crossing rounding 1e-16 is divided by the gap, which has .01 at its least.
    assert turn < 1e-6
    assert change < 0.6 * 0.02  # d(1/s) at s = .8 is 1/s^2 .009 = .014
    np.testing.assert_allclose(last.scales, np.tile([0.15, 0.75, 0.48], (n, 1)), rtol=1e-12)


def test_a_crossing_that_is_avoided_turns_smoothly():
    # A shear of 1e-2 keeps the scales apart, so the axes must turn by 90 degrees over the passage:
    # tan(2 angle) = 2 shear / gap, at most gap' / (2 shear) = .45 rad in a frame.
    q = np.array([[1.0, 0.0, 0.0, 0.0]])
    shear = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    path = [(np.diag([1.0, s, 1.0 / s]) + 1e-2 * shear)[None] for s in np.linspace(0.8, 1.25, 51)]
    turn, _, last = track_through(path, q, DISC[None])
    assert 0.1 < turn < 0.5
    # At the end the axes lie within 2 shear / gap = .05 of where a quarter turn has put them.
    R = matrix_from_quaternion(np.asarray(last.orientations))[0]
    assert abs(R[1, 2]) == pytest.approx(1.0, abs=0.01)


def test_an_inversion_is_passed_through_without_a_jump_of_the_shape():
    # J goes through 0: the body's rotation may jump there, the Gaussian's covariance does not.
    q = quaternions(10, 8)
    path = [np.tile(np.diag([1.0, s, 1.0]), (10, 1, 1)) for s in np.linspace(0.3, -0.3, 31)]
    _, change, _ = track_through(path, q, np.tile(DISC, (10, 1)))
    assert change < 0.6 * 0.02 + 1e-9  # a step of .02 in a stretch moves a scale by .6 of it


def test_jacobi_diagonalizes_with_a_rotation_near_the_identity():
    Q = random_turns(100, 9)
    d = np.random.default_rng(10).uniform(0.0, 2.0, (100, 3))
    S = (Q * d[:, None, :]) @ Q.swapaxes(1, 2)
    D, J = jacobi(S)
    off = np.stack([D[:, 0, 1], D[:, 0, 2], D[:, 1, 2]])
    np.testing.assert_allclose(off, 0.0, atol=1e-13)
    np.testing.assert_allclose(J @ D @ J.swapaxes(1, 2), S, atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(J), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.sort(np.einsum("naa->na", D)), np.sort(d), atol=1e-13)
    nearly = np.diag([1.0, 2.0, 3.0]) + 1e-6 * (1.0 - np.eye(3))
    _, J = jacobi(nearly[None])
    np.testing.assert_allclose(J[0], np.eye(3), atol=2e-6)  # 1e-6 over gaps of 1


@pytest.mark.parametrize("size", [1e-3, 0.2, 1.0])
def test_the_nearest_rotation_is_that_of_the_signed_svd(size):
    # Upright and inverted, some of them nearly flat.
    F = np.eye(3) + size * np.random.default_rng(3).normal(size=(5000, 3, 3))
    U, s, Vt = np.linalg.svd(F)
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    U[:, :, 2] *= sign[:, None]
    # Rounding of some dozen operations, over how well the rotation is known: s2 + s3, s3 signed.
    known = s[:, 1] + s[:, 2] * sign
    off = np.abs(nearest_rotation(F) - U @ Vt).max((1, 2))
    assert (off * np.minimum(known, 1.0) < 1e-13).all()


def test_the_nearest_rotation_is_proper_even_for_inverted_maps():
    F = np.random.default_rng(11).normal(size=(100, 3, 3))
    R = nearest_rotation(F)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)
    # No other rotation is nearer: perturbed ones are all farther.
    near = np.linalg.norm(F - R, axis=(1, 2))
    for seed in range(20):
        w = np.random.default_rng(seed).normal(scale=0.1, size=3)
        other = Rotation.from_rotvec(w).as_matrix() @ R
        assert (np.linalg.norm(F - other, axis=(1, 2)) >= near).all()


def test_lanes_hold_what_they_are_given_and_begin_where_vectors_do():
    for count in (1, LANES, 2 * LANES - 1):
        given = np.random.default_rng(count).normal(size=(count, 3, 3))
        lanes = to_lanes(given)
        assert lanes.shape == (9 * -(-count // LANES), LANES)
        assert lanes.ctypes.data % (8 * LANES) == 0
        np.testing.assert_array_equal(from_lanes(lanes, count, 3, 3), given)


def test_a_particle_does_not_depend_on_others_in_its_vector():
    # Some take other sweeps and steps than others, and those inverted or flat take the SVD.
    n = 61
    q, scale = quaternions(n, 11), np.random.default_rng(12).uniform(0.1, 1.0, (n, 3))
    F = (
        np.eye(3)
        + np.random.default_rng(13).normal(size=(n, 3, 3)) * np.linspace(0, 1, n)[:, None, None]
    )
    F[7] = np.diag([1.0, 1e-9, 1.0])
    assert (np.linalg.det(F) < 0.0).sum() > 5
    track = GaussianTrack(q, scale)
    together = [track.advance(at(F)), track.advance(at(F @ F))][-1]
    for p in range(n):
        alone = GaussianTrack(q[p : p + 1], scale[p : p + 1])
        alone.advance(at(F[p : p + 1]))
        out = alone.advance(at(F[p : p + 1] @ F[p : p + 1]))
        np.testing.assert_array_equal(out.orientations[0], together.orientations[p])
        np.testing.assert_array_equal(out.scales[0], together.scales[p])


def test_no_gaussians_at_all():
    track = GaussianTrack(np.zeros((0, 4)), np.zeros((0, 3)))
    pose = track.advance(Pose(x=np.zeros((0, 3)), v=np.zeros((0, 3)), F=np.zeros((0, 3, 3))))
    assert (pose.orientations.shape, pose.scales.shape) == ((0, 4), (0, 3))
