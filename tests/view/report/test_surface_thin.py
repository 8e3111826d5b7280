"""What a page leaves out."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import BOX, TRIANGLES

from gf_usd.view.report.thinning import cluster_vertices, evenly_spaced, random_subset


def bumpy_sheet(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A grid of n x n points over the unit square, and its triangles."""
    x, z = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    points = np.stack([x, 0.1 * np.sin(7 * x) * np.cos(5 * z), z], axis=-1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1])
    quads = np.stack([a, b, c, d], axis=-1).reshape(-1, 4)
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_frames_are_spread_with_the_ends():
    assert evenly_spaced(5, 10).tolist() == [0, 1, 2, 3, 4]
    thin = evenly_spaced(1000, 240)
    assert (thin[0], thin[-1], len(thin)) == (0, 999, 240)
    assert set(np.diff(thin)) == {4, 5}  # 999 / 239 = 4.18


def test_gaussians_are_sampled_the_same_every_time():
    assert random_subset(4, 9).tolist() == [0, 1, 2, 3]
    few = random_subset(10_000, 100)
    assert len(set(few.tolist())) == 100
    assert np.array_equal(few, random_subset(10_000, 100))
    # a fair sample of 0..9999: its mean is within four standard errors
    assert few.mean() == pytest.approx(5000, abs=4 * 2887 / 10)


def test_a_small_mesh_stays_as_it_is():
    kept, corners, faces = cluster_vertices(BOX, TRIANGLES, np.zeros(8), 8)
    assert np.array_equal(kept, np.arange(8))
    assert np.array_equal(corners, TRIANGLES)
    assert np.array_equal(faces, np.arange(12))


def test_a_thinned_mesh_keeps_its_shape():
    points, triangles = bumpy_sheet(60)
    kept, corners, faces = cluster_vertices(points, triangles, np.zeros(3600), 500)
    assert 250 < len(kept) <= 500
    assert len(set(kept.tolist())) == len(kept)
    # every triangle is one of the mesh, moved by no more than a cell (1 / sqrt(250)) and a bit
    moved = np.linalg.norm(points[kept][corners] - points[triangles[faces]], axis=2)
    assert moved.max() < 2.0 / np.sqrt(250)
    # and together they still cover the sheet seen from above, but for its ragged border
    a, b, c = (points[kept][corners[:, i]][:, [0, 2]] for i in range(3))
    cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert abs(cross.sum()) / 2 == pytest.approx(1.0, abs=0.1)


def test_sides_of_a_thin_wall_and_different_meshes_stay_apart():
    points, triangles = bumpy_sheet(40)
    wall = np.concatenate([points, points + (0, 1e-4, 0)])
    both = np.concatenate([triangles, triangles[:, ::-1] + len(points)])
    for part in (np.zeros(3200), np.repeat([0, 1], 1600)):
        kept, corners, _ = cluster_vertices(wall, both, part, 400)
        side = kept[corners] >= len(points)
        assert (side.all(axis=1) | ~side.any(axis=1)).all()
