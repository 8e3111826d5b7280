"""Linear blend skinning against rotations in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from gf_usd.core.stage import Bone, Skeleton
from gf_usd.geometry.flesh.linear_blend import bone_transforms, skinned

CORNERS = np.array([[0.1, 0.2, 0.3], [1.1, 0.2, 0.3], [0.1, 1.2, 0.3], [0.1, 0.2, 1.3]])
TURNS = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.3, -0.2, 0.5]])
SHIFT = np.array([0.4, -0.1, 0.2])
X = np.random.default_rng(0).normal(size=(20, 3))
# Sums of a few products of numbers near 1: some roundings.
ROUNDING = 1e-14


def skeleton() -> Skeleton:
    """A bone that rests, and one that turns about the origin and then moves by SHIFT."""
    rests = np.stack([CORNERS, CORNERS])
    turns = np.stack([CORNERS, TURNS[1].apply(CORNERS) + SHIFT])
    return Skeleton(
        bones=tuple(
            Bone(name="b", segments=np.zeros((0, 2, 3)), free=(), anchors=CORNERS, path=path)
            for path in (rests, turns)
        )
    )


def posed(weights: NDArray[np.float64], frame: int) -> NDArray[np.float64]:
    linear, offset = bone_transforms(skeleton())
    return skinned(sparse.csr_matrix(weights), linear[frame], offset[frame], X)


def test_a_point_of_one_bone_moves_with_it() -> None:
    alone = np.tile([0.0, 1.0], (len(X), 1))
    assert np.allclose(posed(alone, 0), X, atol=ROUNDING, rtol=0.0)
    assert np.allclose(posed(alone, 1), TURNS[1].apply(X) + SHIFT, atol=ROUNDING, rtol=0.0)


def test_points_of_two_bones_are_the_weighted_means_of_their_places() -> None:
    share = np.linspace(0.0, 1.0, len(X))[:, None]
    exact = (1.0 - share) * X + share * (TURNS[1].apply(X) + SHIFT)
    found = posed(np.column_stack([1.0 - share, share]), 1)
    assert np.allclose(found, exact, atol=ROUNDING, rtol=0.0)


def test_the_coordinate_along_a_direction_is_that_of_the_posed_point() -> None:
    up = np.array([0.6, 0.0, 0.8])
    weights = np.tile([0.25, 0.75], (len(X), 1))
    linear, offset = bone_transforms(skeleton())
    slope, height = (up @ linear[1])[:, None], (offset[1] @ up)[:, None]
    found = skinned(sparse.csr_matrix(weights), slope, height, X)
    assert found.shape == (len(X), 1)
    assert np.allclose(found[:, 0], posed(weights, 1) @ up, atol=ROUNDING, rtol=0.0)
