"""Normals of tessellated shapes."""

from __future__ import annotations

import numpy as np
from small_stages import CUBE_INDICES

from gf_usd.layers.tracks.meshes import CornerNormals

CORNERS = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], float
)


def cylinder(sides: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius 1 about z between 0 and 1: n-gon caps and quads around."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([np.c_[ring, np.zeros(sides)], np.c_[ring, np.ones(sides)]])
    j = np.arange(sides)
    k = (j + 1) % sides
    around = np.stack([j, k, k + sides, j + sides], axis=1)
    counts = np.array([sides, sides, *[4] * sides])
    return points, counts, np.concatenate([j[::-1], j + sides, around.ravel()])


def test_a_box_is_flat_between_its_creases() -> None:
    shading = CornerNormals(CORNERS, np.full(6, 4), np.array(CUBE_INDICES))
    outward = np.array([(0, 0, -1), (0, 0, 1), (0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0)], float)
    np.testing.assert_allclose(shading.of(CORNERS), np.repeat(outward, 4, axis=0), atol=1e-12)


def test_a_cylinder_is_round_and_its_caps_are_flat() -> None:
    points, counts, indices = cylinder(36)
    normals = CornerNormals(points, counts, indices).of(points)
    np.testing.assert_allclose(normals[:36], np.tile((0, 0, -1), (36, 1)), atol=1e-12)
    np.testing.assert_allclose(normals[36:72], np.tile((0, 0, 1), (36, 1)), atol=1e-12)
    round_part = points[indices[72:]] * (1, 1, 0)
    # two equal faces meet at each point: their mean is exactly the radius
    np.testing.assert_allclose(normals[72:], round_part, atol=1e-12)


def test_a_face_without_area_has_no_normal_of_its_own() -> None:
    points = np.zeros((3, 3))
    assert not CornerNormals(points, np.array([3]), np.arange(3)).of(points).any()
