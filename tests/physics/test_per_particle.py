"""What the kernels find of every particle, against NumPy's singular value decomposition."""

from __future__ import annotations

import numpy as np

from gf_usd.core.frames.frame import Pose
from gf_usd.core.matrices import matrix_from_quaternion
from gf_usd.physics.output.gaussians import GaussianTrack
from gf_usd.physics.per_particle import nearest_rotation, strains

N = 400


def matrices(seed: int = 0) -> np.ndarray:
    """Stretched and turned, some turned inside out, some flat, some with equal stretches."""
    rng = np.random.default_rng(seed)
    F = np.eye(3) + 0.5 * rng.standard_normal((N, 3, 3))
    F[:20] = 0.3 * np.eye(3)
    F[20:40] = np.diag([2.0, 2.0, 0.5])
    F[40:60, :, 2] = 0.0
    F[60:70] = 0.0
    return F


def test_rotations_are_those_of_the_signed_svd() -> None:
    F = matrices()
    U, s, Vt = np.linalg.svd(F)
    sign = np.sign(np.linalg.det(U @ Vt))
    # Where the smallest two stretches cancel, or there is one only, there are many.
    one = s[:, 1] + sign * s[:, 2] > 1e-3
    assert (sign < 0).any()
    assert one.sum() > N / 2
    U[:, :, 2] *= sign[:, None]
    # Newton's last change was below 1e-9, and the error is its square.
    np.testing.assert_allclose(nearest_rotation(F)[one], (U @ Vt)[one], atol=1e-12)


def test_stretches_and_determinants_are_those_of_numpy() -> None:
    F = matrices()
    s, J = strains(F)
    largest = np.linalg.norm(F, axis=(1, 2)).max()
    # The closed form loses half the digits where stretches meet or vanish.
    np.testing.assert_allclose(s, np.linalg.svd(F)[1][:, ::-1], atol=1e-7 * largest)
    np.testing.assert_allclose(J, np.linalg.det(F), atol=1e-14 * largest**3)


def test_one_particle_and_many_give_the_same_bits() -> None:
    F = matrices()
    s, J = strains(F)
    R = nearest_rotation(F)
    for p in (0, 45, 65, 200, N - 1):
        alone, J_alone = strains(F[p : p + 1])
        assert np.array_equal(alone[0], s[p])
        assert J_alone[0] == J[p]
        assert np.array_equal(nearest_rotation(F[p : p + 1])[0], R[p])


def test_no_particles_have_no_strains() -> None:
    none = np.zeros((0, 3, 3))
    assert [a.shape for a in strains(none)] == [(0, 3), (0,)]
    assert nearest_rotation(none).shape == (0, 3, 3)


def test_what_is_no_number_stays_none() -> None:
    F = matrices()
    F[7, 1, 2] = np.nan
    s, J = strains(F)
    assert np.isnan([*s[7], J[7]]).all()
    assert np.isfinite(np.delete(s, 7, 0)).all()


def test_gaussians_keep_their_covariance_through_frames() -> None:
    rng = np.random.default_rng(1)
    q0 = rng.standard_normal((N, 4))
    q0 /= np.linalg.norm(q0, axis=1, keepdims=True)
    s0 = rng.uniform(0.01, 0.05, (N, 3))
    track = GaussianTrack(q0, s0)
    rate = rng.standard_normal((N, 3, 3))
    still = np.zeros((N, 3))
    for frame in range(1, 6):
        F = np.eye(3) + 0.08 * frame * rate
        pose = track.advance(Pose(x=still, v=still, F=F))
        Q = matrix_from_quaternion(pose.orientations)
        sigma = np.einsum("nab,nb,ncb->nac", Q, pose.scales**2, Q)
        A = F @ (matrix_from_quaternion(q0) * s0[:, None, :])
        np.testing.assert_allclose(sigma, A @ A.swapaxes(1, 2), atol=1e-12)
