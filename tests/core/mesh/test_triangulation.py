"""Triangulation of polygons."""

import numpy as np
import pytest
from unit_cube import CUBE, area_vectors

from gf_usd.core.mesh.triangulation import triangulate


def polygon(*plane):
    return np.array([[x, y, 0.0] for x, y in plane])


def test_corners_and_faces_lead_back_to_the_authored_arrays():
    counts = np.array([3, 2, 5, 4])
    points = np.concatenate([CUBE, polygon((0, 0), (2, 0), (3, 1), (1.5, 2), (0, 1))])
    indices = np.array([0, 4, 5, 1, 2, 8, 9, 10, 11, 12, 4, 6, 7, 5])
    triangles, corners, faces = triangulate(points, counts, indices)
    np.testing.assert_array_equal(indices[corners], triangles)
    np.testing.assert_array_equal(faces, [0, 2, 2, 2, 3, 3])
    starts = np.cumsum(counts) - counts
    assert np.all(corners >= starts[faces][:, None])
    assert np.all(corners < (starts + counts)[faces][:, None])


CONCAVE = {
    "quad, notch at 0": polygon((1, 0.2), (3, 1), (0, 3), (0.5, 1)),
    "quad, notch at 1": polygon((0, 3), (1, 0.6), (3, 0), (0, 0)),
    "L": polygon((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)),
    "comb": polygon((0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (0, 1)),
    "in line": polygon((0, 0), (1, 0), (2, 0), (2, 2), (1, 2), (0, 2)),
    "star": polygon(
        *((r * np.cos(t), r * np.sin(t)) for r, t in zip([2, 0.7] * 7, np.arange(14) * np.pi / 7))
    ),
    "ring with a bridge": polygon(
        (0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)
    ),
}


@pytest.mark.parametrize("name", CONCAVE)
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [1, -1])
def test_concave_polygons_are_covered_once(name, axis, side):
    points = np.roll(CONCAVE[name], axis, axis=1)[::side]
    n = len(points)
    triangles, _, _ = triangulate(points, np.array([n]), np.arange(n))
    assert len(triangles) == n - 2
    whole = 0.5 * np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    parts = area_vectors(points, triangles)
    upright = parts @ whole / np.linalg.norm(whole)
    # Every part upright and the sum exact: no part outside, none twice (rounding only).
    assert np.all(upright > 1e-9)
    assert upright.sum() == pytest.approx(np.linalg.norm(whole), rel=1e-12)


def test_quads_are_cut_along_the_shorter_diagonal():
    kite = polygon((0, 0), (4, -1), (8, 0), (4, 1))
    triangles, _, _ = triangulate(kite, np.array([4]), np.arange(4))
    assert [{1, 3} <= set(t) for t in triangles.tolist()] == [True, True]
    square = polygon((0, 0), (1, 0), (1, 1), (0, 1))
    np.testing.assert_array_equal(
        triangulate(square, np.array([4]), np.arange(4))[0], [[0, 1, 2], [0, 2, 3]]
    )


def test_a_polygon_that_crosses_itself_or_has_no_area_still_gives_n_minus_two():
    for points in (polygon((0, 0), (2, 2), (2, 0), (0, 2), (1, 5), (-3, -1)), np.zeros((6, 3))):
        assert triangulate(points, np.array([6]), np.arange(6))[0].shape == (4, 3)
