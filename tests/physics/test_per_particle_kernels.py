"""Kernels for many particles against NumPy for few: the same numbers, to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.frames import Pose
from gf_usd.core.matrices import matrix_from_quaternion
from gf_usd.physics import gaussians, per_particle

N = 400


@pytest.fixture
def by_kernel(monkeypatch: pytest.MonkeyPatch):
    """A function that says which way is taken from then on."""
    return lambda on: monkeypatch.setattr(per_particle, "MANY", 1 if on else 10**9)


def matrices(seed: int = 0) -> np.ndarray:
    """Stretched and turned, some turned inside out, some flat, some with equal stretches."""
    rng = np.random.default_rng(seed)
    F = np.eye(3) + 0.5 * rng.standard_normal((N, 3, 3))
    F[:20] = 0.3 * np.eye(3)
    F[20:40] = np.diag([2.0, 2.0, 0.5])
    F[40:60, :, 2] = 0.0
    F[60:70] = 0.0
    return F


def test_rotations_are_those_of_the_signed_svd(by_kernel) -> None:
    F = matrices()
    U, s, Vt = np.linalg.svd(F)
    sign = np.sign(np.linalg.det(U @ Vt))
    # Where the smallest two stretches cancel, or there is one only, there are many.
    one = s[:, 1] + sign * s[:, 2] > 1e-3
    assert (sign < 0).any()
    assert one.sum() > N / 2
    U[:, :, 2] *= sign[:, None]
    for on in (False, True):
        by_kernel(on)
        # Newton's last change was below 1e-9, and the error is its square.
        np.testing.assert_allclose(per_particle.nearest_rotation(F)[one], (U @ Vt)[one], atol=1e-12)


def test_stretches_and_determinants_are_the_same_either_way(by_kernel) -> None:
    F = matrices()
    by_kernel(False)
    s, J = per_particle.strains_by_numpy(F)
    by_kernel(True)
    s_kernel, J_kernel = per_particle.strains_by_numpy(F)
    largest = np.linalg.norm(F, axis=(1, 2)).max()
    # The closed form loses half the digits where stretches meet or vanish.
    np.testing.assert_allclose(s_kernel, s, atol=1e-7 * largest)
    np.testing.assert_allclose(J_kernel, J, atol=1e-14 * largest**3)
    np.testing.assert_allclose(s_kernel, np.linalg.svd(F)[1][:, ::-1], atol=1e-7 * largest)


def test_what_is_no_number_stays_none(by_kernel) -> None:
    F = matrices()
    F[7, 1, 2] = np.nan
    by_kernel(True)
    s, J = per_particle.strains_by_numpy(F)
    assert np.isnan([*s[7], J[7]]).all()
    assert np.isfinite(np.delete(s, 7, 0)).all()


def test_gaussians_go_through_frames_the_same_either_way(by_kernel) -> None:
    rng = np.random.default_rng(1)
    q0 = rng.standard_normal((N, 4))
    q0 /= np.linalg.norm(q0, axis=1, keepdims=True)
    s0 = rng.uniform(0.01, 0.05, (N, 3))
    tracks = []
    for _ in range(2):
        tracks.append(gaussians.GaussianTrack(q0, s0))
    rate = rng.standard_normal((N, 3, 3))
    still = np.zeros((N, 3))
    for frame in range(1, 6):
        F = np.eye(3) + 0.08 * frame * rate
        poses = []
        for on, track in enumerate(tracks):
            by_kernel(on)
            poses.append(track.advance(Pose(x=still, v=still, F=F)))
        # An axis is found to rounding over the gap of two scales, here above 1e-4 of the larger.
        np.testing.assert_allclose(poses[1].orientations, poses[0].orientations, atol=1e-9)
        np.testing.assert_allclose(poses[1].scales, poses[0].scales, rtol=1e-6, atol=1e-12)
    Q = matrix_from_quaternion(poses[1].orientations)
    sigma = np.einsum("nab,nb,ncb->nac", Q, poses[1].scales ** 2, Q)
    A = F @ (matrix_from_quaternion(q0) * s0[:, None, :])
    np.testing.assert_allclose(sigma, A @ A.swapaxes(1, 2), atol=1e-12)
