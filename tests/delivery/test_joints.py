"""The decomposition into joints: what it recovers exactly, its bounds, and its order."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gf_usd.delivery import joints
from gf_usd.delivery.joints import (
    INFLUENCES,
    STEPS,
    decompositions,
    kabsch,
    left_alone,
    quantized,
    simplex_weights,
)

ROUNDING = 1e-9


def turns(count: int, seed: int) -> np.ndarray:
    """(count, 3, 3) rotations of up to a radian."""
    rng = np.random.default_rng(seed)
    return Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (count, 3))).as_matrix()


def test_kabsch_finds_the_rotation_of_each_frame() -> None:
    rng = np.random.default_rng(1)
    p, R, d = rng.normal(size=(20, 3)), turns(4, 2), rng.normal(size=(4, 3))
    x = p @ R.transpose(0, 2, 1) + d[:, None]
    found_R, found_d = kabsch(p, x, rng.uniform(0.1, 1.0, 20))
    assert np.abs(found_R - R).max() < ROUNDING
    assert np.abs(found_d - d).max() < ROUNDING


def test_kabsch_never_mirrors() -> None:
    p = np.random.default_rng(3).normal(size=(20, 3))
    R, _ = kabsch(p, (p * (-1.0, 1.0, 1.0))[None], np.ones(20))
    assert np.linalg.det(R[0]) == pytest.approx(1.0)


def test_weights_are_those_of_least_squares_on_the_simplex() -> None:
    # a point that three of six residuals reach exactly: 0.5 a + 0.3 b + 0.2 c = 0
    rng = np.random.default_rng(4)
    residuals = rng.normal(size=(1, 6, 9))
    residuals[0, 2] = -(0.5 * residuals[0, 0] + 0.3 * residuals[0, 1]) / 0.2
    w = simplex_weights(residuals @ residuals.transpose(0, 2, 1))
    assert np.allclose(w, [[0.5, 0.3, 0.2, 0.0, 0.0, 0.0]], atol=1e-6)  # the ridge is 1e-9


def test_weights_keep_their_bounds() -> None:
    residuals = np.random.default_rng(5).normal(size=(200, 10, 12))
    w = simplex_weights(residuals @ residuals.transpose(0, 2, 1))
    assert (w >= 0.0).all()
    assert np.abs(w.sum(axis=1) - 1.0).max() < ROUNDING
    assert ((w > 0.0).sum(axis=1) <= INFLUENCES).all()
    whole = quantized(w)
    assert (whole.sum(axis=1) == STEPS).all()
    assert np.abs(whole / STEPS - w).max() <= 1.0 / STEPS


def test_what_a_joint_alone_leaves_is_its_weighted_squared_error() -> None:
    random = np.random.default_rng(3)
    p, x = random.normal(size=(40, 3)), random.normal(size=(40, 7, 3))
    u, d = random.uniform(size=(40, 7)), random.normal(size=(5, 7, 3))
    R = turns(35, 2).reshape(5, 7, 3, 3)
    moved = np.einsum("jtab,nb->njta", R, p) + d
    expected = (u[:, None] * ((moved - x[:, None]) ** 2).sum(3)).sum(2)
    assert left_alone(p, x, u, R, d) == pytest.approx(expected, rel=1e-12)


def bent(points: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """A bar whose halves turn about its middle, weights going over from one to the other."""
    rng = np.random.default_rng(6)
    p = rng.uniform((-1.0, -0.2, -0.2), (1.0, 0.2, 0.2), (points, 3))
    share = np.rint(np.clip(2.5 * p[:, 0] + 0.5, 0.0, 1.0) * STEPS)[:, None] / STEPS
    angles = np.linspace(0.0, 1.0, 7)
    left = Rotation.from_euler("z", angles[:, None]).as_matrix()
    right = Rotation.from_euler("z", -angles[:, None]).as_matrix()
    x = (1 - share) * (p @ left.transpose(0, 2, 1)) + share * (p @ right.transpose(0, 2, 1))
    return p, x


def test_a_bent_bar_takes_few_joints() -> None:
    p, x = bent()
    *_, (found, error) = decompositions(p, x, 0.01, 40)
    assert error <= 0.01
    assert len(found) <= 16  # two would do; the search begins with eight
    off = np.linalg.norm(found.pose(p) - x, axis=2).max()
    assert off == pytest.approx(error)
    assert (found.weights.sum(axis=1) == STEPS).all()


def test_more_joints_until_the_error_is_met_or_the_limit_reached() -> None:
    rng = np.random.default_rng(8)
    p = rng.uniform(-1.0, 1.0, (200, 3))
    t = np.linspace(0.0, 1.0, 5)[:, None, None]
    x = p + 0.3 * t * np.sin(4.0 * p[None, :, [1, 2, 0]])
    found = list(decompositions(p, x, 1e-6, 30))
    counts = [len(one) for one, _ in found]
    assert counts == sorted(set(counts))
    assert counts[-1] == 30
    assert found[-1][1] < 0.5 * found[0][1]


def test_points_in_one_place_move_as_one() -> None:
    p, x = bent(60)
    twice = decompositions(np.concatenate([p, p]), np.concatenate([x, x], axis=1), 0.02, 20)
    *_, (found, _) = twice
    assert np.array_equal(found.joints[:60], found.joints[60:])
    assert np.array_equal(found.weights[:60], found.weights[60:])


def test_it_is_deterministic() -> None:
    p, x = bent(100)
    *_, (one, _) = decompositions(p, x, 0.02, 20)
    *_, (two, _) = decompositions(p, x, 0.02, 20)
    assert np.array_equal(one.rotations, two.rotations)
    assert np.array_equal(one.weights, two.weights)


@pytest.mark.slow
@pytest.mark.acceptance
def test_many_points_are_fitted_by_some_and_bound_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error that is stated is that of all points, and within the tolerance at the end."""
    rng = np.random.default_rng(4)
    rest = rng.uniform(-1.0, 1.0, (3000, 3))
    t = np.linspace(0.0, 1.0, 6)[:, None, None]
    frames = rest * (1.0 + 0.2 * t) + 0.1 * t * np.sin(2.0 * rest[:, [1, 2, 0]])
    monkeypatch.setattr(joints, "FITTED", 300)
    tolerance = 0.05
    every = list(joints.decompositions(rest, frames, tolerance, 200))
    for skinning, error in every:
        off = np.linalg.norm(skinning.pose(rest) - frames, axis=2).max()
        assert error == pytest.approx(off, rel=1e-9)
        assert (skinning.weights.sum(axis=1) == joints.STEPS).all()
    assert every[-1][1] <= tolerance < every[0][1]
    monkeypatch.setattr(joints, "FITTED", 3000)
    *_, (fewest, _) = joints.decompositions(rest, frames, tolerance, 200)
    # a tenth of the points is enough to place nearly as few joints
    assert len(every[-1][0]) <= 1.6 * len(fewest)
