"""Division of triangles into smaller ones."""

import numpy as np
import pytest
from solids import CUBE_POINTS, CUBE_TRIANGLES
from unit_cube import CUBE, area_vectors, cube_triangles

from gf_usd.core.mesh.measures import areas, signed_volume
from gf_usd.core.mesh.subdivision import divided, with_short_edges


def test_triangles_are_divided_into_pieces_of_at_most_an_area():
    points = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.1]])
    triangles = np.array([[0, 2, 3], [0, 1, 2], [0, 1, 3]])
    pieces = divided(points, triangles, 0.2)
    size = np.linalg.norm(area_vectors(points, triangles), axis=1)
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


def test_a_fine_mesh_is_not_divided() -> None:
    triangles = cube_triangles()
    assert with_short_edges(CUBE, triangles, 1.5)[1] is triangles
    assert len(with_short_edges(CUBE, triangles, 1.2)[1]) > len(triangles)
