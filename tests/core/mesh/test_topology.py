"""Welding, edges, shells and borders of meshes."""

import numpy as np
import pytest
from unit_cube import CUBE, CUBE_FACES, cube_triangles

from gf_usd.core.mesh.topology import (
    Edges,
    Welded,
    boundary_edges,
    first_equal,
    numbered,
    proper,
    shells,
    weld,
)
from gf_usd.core.mesh.triangulation import triangulate


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
