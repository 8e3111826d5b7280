"""Goals: the skinned pose of points inside, and how strongly they are drawn to it."""

from __future__ import annotations

import numpy as np
import pytest
from moved_bone import moved_bone
from scipy import sparse
from solids import cube, fill, solid

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Goals, Skeleton
from gf_usd.geometry.flesh.goals import flesh_goals

BAR = solid(cube((0.0, -0.2, -0.2), (2.0, 0.4, 0.4)))
SAMPLES = fill(BAR, 400)[1]
SPACING = 0.1
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
SHIFT = np.array([0.3, 0.0, 0.1])


def goals(weights: Floats, painted: dict[str, Floats] | None = None) -> Goals:
    (surface,) = BAR.surfaces
    skeleton = Skeleton(
        bones=(moved_bone(TURN, SHIFT), moved_bone(np.eye(3), np.zeros(3))),
        weights={surface.path: sparse.csr_matrix(weights)},
    )
    return flesh_goals(
        BAR, SAMPLES, skeleton, painted or {}, frequency=2.0, damping=0.3, spacing=SPACING
    )


def along() -> Floats:
    """Weights (V, 2) that pass linearly from one bone to the other along x."""
    x = BAR.surfaces[0].points[:, 0] / 2.0
    return np.stack([1.0 - x, x], 1)


def test_one_bone_carries_points_inside_exactly() -> None:
    made = goals(np.tile([1.0, 0.0], (len(BAR.surfaces[0].points), 1)))
    X = np.array([[0.3, 0.0, 0.0], [1.7, 0.1, -0.1]])
    pose = made.pose(X)
    np.testing.assert_allclose(pose(0.0), X, atol=1e-12)
    np.testing.assert_allclose(pose(1.0), X @ TURN.T + SHIFT, atol=1e-12)
    assert made.moving


def test_weights_blend_inside_as_on_the_skin() -> None:
    X = np.array([[0.5, 0.0, 0.0], [1.0, 0.05, 0.0], [1.5, 0.0, 0.1]])
    w = 1.0 - X[:, :1] / 2.0
    expected = w * (X @ TURN.T + SHIFT) + (1.0 - w) * X
    # samples lie about a spacing apart: their mean place is off by less than half of one
    slope = np.abs(X @ TURN.T + SHIFT - X).max() / 2.0
    np.testing.assert_allclose(goals(along()).pose(X)(1.0), expected, atol=0.5 * SPACING * slope)


@pytest.mark.parametrize(("goal", "factor"), [(0.0, 0.0), (0.2, 0.5), (0.5, 1.0), (1.0, np.inf)])
def test_a_painted_goal_sets_the_frequency(goal: float, factor: float) -> None:
    (surface,) = BAR.surfaces
    painted = {surface.path: np.full(len(surface.face_indices), goal)}
    rate = goals(along(), painted).rate(np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(rate, 2.0 * np.pi * 2.0 * factor, rtol=1e-9)


def test_nothing_painted_is_the_frequency_itself_and_no_weight_is_free() -> None:
    X = np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(goals(along()).rate(X), 4.0 * np.pi, rtol=1e-12)
    free = goals(np.zeros((len(BAR.surfaces[0].points), 2)))
    assert free.rate(X) == 0.0
    np.testing.assert_array_equal(free.pose(X)(1.0), X)
