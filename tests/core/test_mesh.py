"""Triangulation, welding, edges, shells and volume of polygon meshes."""

import numpy as np
import pytest
from solids import CUBE_POINTS, CUBE_TRIANGLES

from gf_usd.core.mesh import (
    Edges,
    Welded,
    areas,
    boundary_edges,
    divided,
    first_equal,
    numbered,
    proper,
    shells,
    signed_volume,
    triangulate,
    weld,
    with_short_edges,
)

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
CUBE_FACES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)


def cube_triangles():
    return triangulate(CUBE, np.full(6, 4), CUBE_FACES.ravel())[0]


def area(points, triangles):
    a, b, c = np.moveaxis(np.asarray(points)[triangles], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def polygon(*plane):
    return np.array([[x, y, 0.0] for x, y in plane])


def test_cube_has_volume_one_and_is_closed():
    triangles = cube_triangles()
    assert len(triangles) == 12
    assert signed_volume(CUBE, triangles) == pytest.approx(1.0, abs=1e-15)
    assert signed_volume(CUBE, triangles[:, ::-1]) == pytest.approx(-1.0, abs=1e-15)
    assert len(boundary_edges(triangles)) == 0


def test_volume_far_from_the_origin_keeps_its_digits():
    # Float64 holds 1e6 + 1 to 1e-10; a sum about the origin would lose twelve digits more.
    assert signed_volume(CUBE + 1e6, cube_triangles()) == pytest.approx(1.0, rel=1e-9)


def test_boundary_of_an_open_cube_is_its_rim_in_the_order_of_the_triangles():
    triangles = triangulate(CUBE, np.full(5, 4), CUBE_FACES[1:].ravel())[0]
    rim = boundary_edges(triangles)
    assert {tuple(sorted(e)) for e in rim.tolist()} == {(0, 1), (1, 3), (2, 3), (0, 2)}
    directed = {tuple(e) for t in triangles.tolist() for e in zip(t, t[1:] + t[:1])}
    assert {tuple(e) for e in rim.tolist()} <= directed


def test_collapsed_triangles_do_not_hide_or_make_boundary():
    triangles = np.concatenate([cube_triangles(), [[0, 1, 1]], [[3, 3, 3]]])
    assert proper(triangles).sum() == 12
    assert len(boundary_edges(triangles)) == 0


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
    parts = area(points, triangles)
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


def test_weld_joins_what_is_within_the_tolerance_and_nothing_else():
    rng = np.random.default_rng(1)
    base = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), axis=-1).reshape(-1, 3)
    copies = np.concatenate([base, base + rng.uniform(-1, 1, base.shape) * 1e-4 / np.sqrt(3)])
    representative, unique = weld(copies, tolerance=1e-4)
    assert unique == len(base)
    np.testing.assert_array_equal(representative, np.tile(np.arange(len(base)), 2))
    assert weld(copies, tolerance=1e-9)[1] == len(copies)


def test_weld_default_closes_a_soup_of_triangles():
    soup = CUBE[cube_triangles()].reshape(-1, 3).astype(np.float32) * 0.01 + 3.0
    representative, unique = weld(soup)
    assert unique == 8
    welded = representative[np.arange(36).reshape(-1, 3)]
    assert len(boundary_edges(welded)) == 0


def test_weld_of_a_cluster_and_a_far_point_stays_small_work():
    # 20,000 points within the tolerance of each other would be 2e8 pairs.
    cluster = np.random.default_rng(2).uniform(0, 1e-3, (20000, 3))
    _, unique = weld(np.concatenate([cluster, [[1e6, 0, 0]]]))
    assert unique == 2


def test_weld_of_nothing_and_of_one_place():
    assert weld(np.zeros((0, 3)))[1] == 0
    assert weld(np.ones((5, 3)))[1] == 1


def test_shells_are_joined_by_edges_not_by_corners():
    one = cube_triangles()
    apart = np.concatenate([one, one + 8])
    assert sorted(np.bincount(shells(apart)).tolist()) == [12, 12]
    touching = np.where(apart == 8, 7, apart)  # corner 0 of the second on corner 7 of the first
    assert len(np.unique(shells(touching))) == 2
    assert len(np.unique(shells(one))) == 1
    assert len(shells(np.zeros((0, 3), dtype=int))) == 0


def test_triangles_are_divided_into_pieces_of_at_most_an_area():
    points = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.1]])
    triangles = np.array([[0, 2, 3], [0, 1, 2], [0, 1, 3]])
    pieces = divided(points, triangles, 0.2)
    size = np.linalg.norm(area(points, triangles), axis=1)
    # 0.1 is not more than 0.2; 3 / 4^2 < 0.2 < 3 / 3^2; 0.15 is not more.
    assert np.bincount(pieces.of).tolist() == [1, 16, 1]
    assert (np.diff(pieces.of) >= 0).all()
    assert np.bincount(pieces.of, pieces.share).tolist() == [1.0, 1.0, 1.0]
    middle = np.einsum("nk,nka->na", pieces.weights, points[triangles[pieces.of]])
    # Middles of congruent pieces: their mean is that of the triangle, their moments about it are
    # 1 - 1 / n^2 of its own, area / 18 times the squares of its sides here.
    mean = np.stack([middle[pieces.of == k].mean(0) for k in range(3)])
    np.testing.assert_allclose(mean, points[triangles].mean(1), atol=1e-15)
    large = middle[pieces.of == 1] - mean[1]
    np.testing.assert_allclose(
        size[1] * (large[:, :2] ** 2).mean(0), size[1] / 18.0 * np.array([9.0, 4.0]) * (1 - 1 / 16)
    )
    assert len(divided(points, np.zeros((0, 3), int), 0.2).of) == 0
    assert divided(points, triangles, np.inf).of.tolist() == [0, 1, 2]


@pytest.mark.parametrize("longest", [0.05, 0.3, 0.9, 10.0])
def test_short_edges_leave_the_surface_as_it_is(longest: float) -> None:
    points, triangles = CUBE_POINTS * [1.0, 2.0, 0.1], CUBE_TRIANGLES
    finer, cut = with_short_edges(points, triangles, longest)
    assert np.array_equal(finer[: len(points)], points)
    edges = np.stack([cut, np.roll(cut, -1, axis=1)], -1).reshape(-1, 2)
    assert np.linalg.norm(finer[edges[:, 0]] - finer[edges[:, 1]], axis=1).max() <= max(
        longest, np.sqrt(5.0) if longest == 10.0 else 0.0
    )
    # Closed and of one winding: each edge is there once each way.
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert {tuple(e) for e in edges.tolist()} == {tuple(e) for e in edges[:, ::-1].tolist()}
    assert areas(finer, cut).sum() == pytest.approx(areas(points, triangles).sum(), rel=1e-12)
    assert areas(finer, cut).min() > 0.0
    assert signed_volume(finer, cut) == pytest.approx(0.2, rel=1e-12)
    assert (len(cut) == 12) == (longest == 10.0)


def test_edges_at_seams_are_cut_at_the_same_places() -> None:
    """Triangles that do not share their vertices."""
    apart = CUBE_POINTS[CUBE_TRIANGLES].reshape(-1, 3)
    finer, cut = with_short_edges(apart, np.arange(36).reshape(-1, 3), 0.4)
    joined, same = with_short_edges(CUBE_POINTS, CUBE_TRIANGLES, 0.4)
    assert len(cut) == len(same)
    assert {tuple(p) for p in finer.tolist()} == {tuple(p) for p in joined.tolist()}


@pytest.mark.parametrize("most", [7, 1 << 40, 1 << 61], ids=["small", "packed", "too large"])
def test_keys_are_numbered_as_numpy_does(most: int) -> None:
    keys = np.random.default_rng(0).integers(0, 40, 200) * (most // 7)
    found = numbered(keys)
    expected, back, count = np.unique(keys, return_inverse=True, return_counts=True)
    assert found.keys.tolist() == expected.tolist()
    assert found.of.tolist() == back.tolist()
    assert found.count.tolist() == count.tolist()
    assert found.order.tolist() == np.argsort(keys, kind="stable").tolist()


def test_no_keys_have_no_numbers() -> None:
    found = numbered(np.zeros(0, np.int64))
    assert [len(one) for one in (found.keys, found.of, found.count, found.order)] == [0] * 4


def test_equal_rows_have_the_first_of_them() -> None:
    rows = np.array([(1, 2), (3, 0), (1, 2), (1, 0), (3, 0), (1, 2)])
    assert first_equal(rows).tolist() == [0, 1, 0, 3, 1, 0]


def test_welded_triangles_know_their_borders() -> None:
    closed = Welded(np.arange(8), cube_triangles())
    assert closed.balanced
    assert closed.consistent
    assert not len(closed.boundary)
    assert not closed.shell.any()
    open_box = Welded(np.arange(8), cube_triangles()[2:])
    assert open_box.consistent
    assert not open_box.balanced
    assert len(open_box.boundary) == 4
    turned = cube_triangles()
    turned[0] = turned[0, ::-1]
    assert not Welded(np.arange(8), turned).consistent


def test_collapsed_triangles_are_left_out_and_their_rows_known() -> None:
    welded = Welded(np.array([0, 1, 2, 2]), np.array([(0, 2, 3), (0, 1, 3)]))
    assert welded.triangles.tolist() == [[0, 1, 2]]
    assert welded.source.tolist() == [1]


def test_edges_are_found_once_until_they_are_released(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    true = Edges.of
    monkeypatch.setattr(Edges, "of", lambda triangles: made.append(1) or true(triangles))
    welded = Welded(np.arange(8), cube_triangles())
    assert welded.edges is welded.edges
    assert welded.balanced
    assert not welded.shell.any()
    assert len(made) == 1
    welded.release()
    assert welded.balanced
    assert not welded.shell.any()
    assert len(made) == 1
    assert len(welded.edges.pairs) == 18
    assert len(made) == 2


def test_a_fine_mesh_is_not_divided() -> None:
    triangles = cube_triangles()
    assert with_short_edges(CUBE, triangles, 1.5)[1] is triangles
    assert len(with_short_edges(CUBE, triangles, 1.2)[1]) > len(triangles)
