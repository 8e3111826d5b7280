"""The tree of boxes against libigl, on surfaces that moved since it was made."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.distance.closest import closest
from gf_usd.physics.contact.distance.tree import SurfaceTree
from gf_usd.system.taichi_runtime import init_taichi

REACH = 0.3
OCTAHEDRON = (
    np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], float),
    np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5],
              [0, 4, 5]]),
)  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    init_taichi("cpu", 1)


def blob(times: int) -> tuple[Floats, Ints]:
    points, triangles = igl.upsample(*OCTAHEDRON, times)
    return points / np.linalg.norm(points, axis=1, keepdims=True), triangles


def bent(points: Floats, by: float) -> Floats:
    """Squeezed, stretched and wavy, but not folded."""
    wave = 0.1 * by * np.sin(4.0 * points[:, [1, 2, 0]])
    return points * [1.0, 1.0 + by, 1.0 - 0.5 * by] + wave


def compare(tree: SurfaceTree, X: Floats, points: Floats, triangles: Ints) -> int:
    """How many points see the surface; fails where libigl says something else of one."""
    expected, got = (
        closest(X, points, triangles, REACH), tree.closest(X, points, REACH)
    )  # fmt: skip
    assert np.array_equal(got.rows, expected.rows)
    # 1e-16 in some dozen operations, over the sine of the smallest angle of a triangle, above .1
    assert got.gap == pytest.approx(expected.gap, abs=1e-13)
    assert got.point == pytest.approx(expected.point, abs=1e-13)
    corners = points[triangles[got.triangle]]
    assert np.einsum("nk,nka->na", got.weights, corners) == pytest.approx(got.point, abs=1e-13)
    assert got.weights.min(initial=0.0) >= 0.0
    # A direction is the difference of two places, over their distance.
    sure = np.abs(got.gap) > 1e-3
    assert got.normal[sure] == pytest.approx(expected.normal[sure], abs=1e-9)
    assert np.linalg.norm(got.normal, axis=1) == pytest.approx(1.0)
    return len(got.rows)


@pytest.mark.parametrize("by", [0.0, 0.4, 0.8])
def test_what_moved_is_seen_where_it_is(by: float) -> None:
    rest, triangles = blob(4)
    tree, points = SurfaceTree(rest, triangles), bent(rest, by)
    X = np.random.default_rng(0).uniform(-1.8, 1.8, (2_000, 3))
    assert compare(tree, X, points, triangles) > 200
    assert compare(tree, X, rest, triangles) > 200  # and back again


def test_edges_and_vertices_have_the_sign_of_all_that_meets_there() -> None:
    """In front of a vertex some of its triangles face away from the point."""
    rest, triangles = blob(0)  # an octahedron, as sharp as it gets
    tree = SurfaceTree(rest, triangles)
    middle = 0.5 * (rest[triangles] + np.roll(rest[triangles], 1, axis=1)).reshape(-1, 3)
    for scale in (0.9, 1.1):
        X = scale * np.concatenate([rest, middle])
        seen = tree.closest(X, rest, REACH)
        assert len(seen.rows) == len(X)
        assert (np.sign(seen.gap) == np.sign(scale - 1.0)).all()
    compare(tree, X, rest, triangles)  # inside, several faces are as near


def test_on_the_surface_the_normal_is_that_of_what_lies_there() -> None:
    rest, triangles = blob(3)
    X = np.concatenate([rest, rest[triangles].mean(1)])
    seen = SurfaceTree(rest, triangles).closest(X, rest, REACH)
    assert np.abs(seen.gap).max() < 1e-12
    out = X / np.linalg.norm(X, axis=1, keepdims=True)
    # A vertex normal of this mesh is off by the angle between neighboring faces at most.
    assert (seen.normal * out).sum(1).min() > 0.98


def test_few_triangles_an_open_surface_and_nothing() -> None:
    rest, triangles = blob(1)
    X = np.random.default_rng(1).uniform(-1.3, 1.3, (500, 3))
    for count in (1, 3, 4, 5, 9, 31):
        assert compare(SurfaceTree(rest, triangles[:count]), X, rest, triangles[:count]) > 0
    assert len(SurfaceTree(rest, triangles[:0]).closest(X, rest, REACH).rows) == 0
    assert len(SurfaceTree(rest, triangles).closest(X[:0], rest, REACH).rows) == 0


def test_triangles_without_an_area_are_seen_as_edges() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0.4, 0, 0], [0, 1, 0]], float)
    triangles = np.array([[0, 1, 2], [0, 1, 3]])
    X = np.array([[0.5, -0.2, 0.0], [0.7, 0.1, 0.1]])
    seen = SurfaceTree(points, triangles).closest(X, points, REACH)
    assert np.abs(seen.gap) == pytest.approx([0.2, 0.1])


def scattered() -> tuple[list[Floats], list[Ints], Floats, Ints]:
    """Points and triangles of three surfaces, the second without triangles, and places X (n, 3)
    with the surface that each asks for."""
    ball, octahedron = blob(3), blob(0)
    points = [ball[0], ball[0], octahedron[0] + [0.4, 0.1, -0.2]]
    X = np.random.default_rng(2).uniform(-1.4, 1.4, (900, 3))
    return points, [ball[1], ball[1][:0], octahedron[1]], X, np.arange(900, dtype=np.int32) % 3


def test_joined_surfaces_are_seen_as_each_by_itself() -> None:
    points, triangles, X, of = scattered()
    joined = SurfaceTree.joined([SurfaceTree(p, t) for p, t in zip(points, triangles)])
    for by in (0.0, 0.6):
        moved = [bent(p, by) for p in points]
        got = joined.closest(X, np.concatenate(moved), REACH, of=of)
        for k in (0, 2):
            rows = np.flatnonzero(of == k)
            alone = SurfaceTree(points[k], triangles[k]).closest(X[rows], moved[k], REACH)
            mine = np.flatnonzero(of[got.rows] == k)
            assert len(mine) > 20
            assert np.array_equal(got.rows[mine], rows[alone.rows])
            for name in ("gap", "triangle", "weights", "point", "normal"):
                assert np.array_equal(getattr(got, name)[mine], getattr(alone, name)), name
        assert not (of[got.rows] == 1).any()


def test_only_what_moved_of_joined_surfaces_is_fitted_again() -> None:
    points, triangles, X, of = scattered()
    joined = SurfaceTree.joined([SurfaceTree(p, t) for p, t in zip(points, triangles)])
    rest, now = np.concatenate(points), np.concatenate([points[0], points[1], 0.7 * points[2]])
    first = of == 0
    joined.closest(X[first], rest, REACH, of=of[first])
    # The last was not asked for before, the first did not move.
    moved = np.array([False, False, True])
    got = joined.closest(X, now, REACH, of=of, moved=moved)
    fresh = SurfaceTree.joined([SurfaceTree(p, t) for p, t in zip(points, triangles)])
    expected = fresh.closest(X, now, REACH, of=of)
    assert np.array_equal(got.rows, expected.rows)
    assert np.array_equal(got.gap, expected.gap)


@pytest.mark.parametrize("by", [0.0, 0.5])
def test_a_triangle_that_may_be_near_changes_nothing(by: float) -> None:
    points, triangles, X, of = scattered()
    joined = SurfaceTree.joined([SurfaceTree(p, t) for p, t in zip(points, triangles)])
    before = joined.closest(X, np.concatenate(points), REACH, of=of)
    now = np.concatenate([bent(p, by) for p in points])
    alone = joined.closest(X, now, REACH, of=of)
    likely = np.full(len(X), -1)
    likely[before.rows] = before.triangle
    far = np.where(likely >= 0, 0, -1)  # a triangle anywhere
    for given in (likely, far):
        got = joined.closest(X, now, REACH, of=of, likely=given)
        for name in ("rows", "gap", "triangle", "weights", "point", "normal"):
            assert np.array_equal(getattr(got, name), getattr(alone, name)), name


@pytest.mark.parametrize("away", [0.0, 4096.0, 1e5])
@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-8])
def test_a_place_on_a_triangle_that_is_known_is_found(away: float, gap: float) -> None:
    """Distances of zero, and those that are less than the rounding of coordinates."""
    rest, triangles = blob(2)
    points = rest + away
    X = (1.0 + gap) * rest[triangles].mean(1) + away
    tree = SurfaceTree(points, triangles)
    first = tree.closest(X, points, REACH)
    assert len(first.rows) > 0.9 * len(X)
    likely = np.full(len(X), -1)
    likely[first.rows] = first.triangle
    again = tree.closest(X, points, REACH, moved=False, likely=likely)
    for name in ("rows", "gap", "triangle", "weights"):
        assert np.array_equal(getattr(again, name), getattr(first, name)), name
