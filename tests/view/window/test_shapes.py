"""What a window shows, without opening one."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import BOX, TRIANGLES, FallingBox, MeltingBox

from gf_usd.view.window.shapes import (
    EllipsoidMesh,
    ShadedMesh,
    floor_lines,
    icosahedron,
    mesh_at_frame,
)


def test_a_balls_normals_stand_on_its_ellipsoid():
    corners, faces = icosahedron()
    assert (corners.shape, faces.shape) == ((12, 3), (20, 3))
    cloud = FallingBox(gaussians=5).recording().gaussians
    balls = EllipsoidMesh(cloud)
    rng = np.random.default_rng(2)
    positions, axes = rng.standard_normal((5, 3)), rng.standard_normal((5, 3, 3))
    points, normals = balls.pose(positions, axes)
    for i in range(5):
        x = points[12 * i : 12 * i + 12] - positions[i]
        # f(x) = x' (A A')^-1 x is 1 on the ellipsoid, and its gradient is the normal
        gradient = np.linalg.solve(axes[i] @ axes[i].T, x.T).T
        assert np.einsum("ij,ij->i", x, gradient) == pytest.approx(np.ones(12), rel=1e-6)
        gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
        assert normals[12 * i : 12 * i + 12] == pytest.approx(gradient, abs=1e-6)
    assert balls.triangles.max() == 59
    assert balls.colors.shape == (60, 3)


def test_a_box_has_flat_sides():
    skin = ShadedMesh(FallingBox().recording().meshes)
    points, normals = skin.pose((BOX,))
    assert points[skin.triangles] == pytest.approx(BOX[TRIANGLES])
    assert np.sort(np.abs(normals), axis=1) == pytest.approx(np.tile([0, 0, 1], (24, 1)))


def test_a_surface_whose_faces_change_has_the_faces_of_its_frame():
    box = MeltingBox()
    recording = box.recording()
    whole = ShadedMesh(recording.meshes)
    counts = []
    for frame in box.frames(recording.time_codes):
        skin = mesh_at_frame(recording, whole, frame)
        points, _ = skin.pose(tuple(mesh.points for mesh in frame.flows))
        (mesh,) = frame.flows
        assert points[skin.triangles] == pytest.approx(mesh.points[mesh.triangles])
        counts.append(len(skin.triangles))
    assert counts == [11, 12, 11, 12, 11, 12, 11]
    assert len(whole.pose(())[0]) == 0
    solid = FallingBox().recording()
    skin = ShadedMesh(solid.meshes)
    assert mesh_at_frame(solid, skin, next(iter(FallingBox().frames([1.0])))) is skin


def test_the_floor_lies_under_the_box():
    lines = floor_lines(np.zeros(3), np.array([1.0, 2.0, 4.0]), np.array([0, 0, 1.0]), -0.5)
    assert (lines[..., 2] == -0.5).all()
    assert lines[..., :2].mean(axis=(0, 1)) == pytest.approx([0.5, 1.0])
