"""Segments toward the flesh of a joint: directions and lengths of point sets with known axes."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.readers.usd.skeleton.segments import (
    FleshPoints,
    connected_parts,
    direction,
    into_flesh,
    near_flesh,
    point_areas,
)


def test_a_bone_points_to_the_far_flesh_of_its_joint_not_to_what_is_around_it() -> None:
    """The bone of a cow's head left its snout, below the line from the joint to the mean."""
    around = np.array([(0.0, y, z) for y in (-0.2, 0.2) for z in (-0.2, 0.2)] * 3)
    snout = np.array([(x, -0.5 * x, 0.0) for x in (0.4, 0.6, 0.8, 1.0)] * 3)
    at = np.concatenate([around + (0.0, 0.1, 0.0), snout])
    way = direction(FleshPoints(at=at, area=np.ones(len(at))), np.zeros(3))
    np.testing.assert_allclose(way, np.array([1.0, -0.5, 0.0]) / 1.25**0.5, atol=1e-12)


def test_flesh_at_one_distance_does_not_turn_a_bone_to_one_side() -> None:
    """The head of RiggedFigure, of which only the corners of its top belong to the last joint, hung
    to the side to which their mean was off by rounding.
    """
    top = np.array([(x, 1.0, z) for x in (-0.5, 0.5) for z in (-0.5, 0.5)])
    way = direction(FleshPoints(at=top, area=np.ones(4)), np.array([1e-3, 0.0, 0.0]))
    np.testing.assert_allclose(way, [-1e-3, 1.0, 0.0], atol=1e-6)


def test_means_and_medians_are_those_of_the_area() -> None:
    at = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (3.0, 0.0, 0.0)])
    flesh = FleshPoints(at=at, area=np.array([1.0, 1.0, 1.0, 7.0]))
    np.testing.assert_allclose(flesh.mean(), [2.4, 0.0, 0.0])
    assert flesh.median(at[:, 0]) == 3.0
    assert flesh.subset(at[:, 0] < 2.5).median(at[:, 0][:3]) == 1.0


def test_points_of_no_face_count_only_where_there_are_no_others() -> None:
    at = np.array([(1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 11.0, 0.0)])
    flesh = FleshPoints(at=at, area=np.array([1.0, 1.0, 0.0, 0.0]))
    np.testing.assert_allclose(into_flesh(flesh, np.zeros(3)), [3.0, 0.0, 0.0])
    np.testing.assert_allclose(flesh.subset(at[:, 1] > 0.0).mean(), [0.0, 10.0, 0.0])


def test_areas_of_points_are_thirds_of_their_triangles() -> None:
    at = np.array([(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 2.0, 0.0), (3.0, 2.0, 0.0)])
    np.testing.assert_allclose(point_areas(at, np.array([[0, 1, 2], [1, 3, 2]])), [1, 2, 2, 1])
    # without triangles: of a box of 3 x 2 x 0
    assert point_areas(at, np.zeros((0, 3), int)) == pytest.approx([3.0] * 4)


def test_parts_are_connected_by_faces_whose_corners_may_be_repeated() -> None:
    at = np.array([(x, y, 0.0) for x in (0.0, 1.0, 1.0, 2.0, 5.0, 6.0) for y in (0.0, 1.0)])
    quads = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7], [8, 9, 10], [10, 9, 11]])
    part = connected_parts(at, quads)
    assert (len(set(part[:8])), len(set(part[8:]))) == (1, 1)
    assert part[0] != part[8]
    assert not connected_parts(at, np.zeros((0, 3), int)).any()


@pytest.mark.parametrize(
    ("gap", "far"), [(0.0, True), (0.2, True), (0.3, False)], ids=["at it", "near", "apart"]
)
def test_flesh_reaches_over_gaps_of_a_quarter_of_its_size(gap: float, far: bool) -> None:
    """The joint is at 0 and the flesh ends at 1: what follows a part that is near is judged by the
    size of both, so that the gap before the third may be larger.
    """
    starts = np.array([0.0, 1.0 + gap, 2.4 + gap])
    at = np.array([(x + more, 0.0, 0.0) for x in starts for more in (0.0, 1.0)])
    part, joined = np.repeat([4, 9, 7], 2), np.arange(6) < 2
    found = near_flesh(at, part, joined, np.zeros(3))
    assert found.tolist() == [True, True, far, far, far, far]


def test_all_is_flesh_where_no_part_has_points_of_other_joints() -> None:
    at = np.array([(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)])
    assert near_flesh(at, np.arange(2), np.zeros(2, bool), np.zeros(3)).all()
