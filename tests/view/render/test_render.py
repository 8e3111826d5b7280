"""Camera, normals, textures, tone curve and files."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image

from gf_usd.core.asset import Texture
from gf_usd.core.errors import UsageError
from gf_usd.core.radiance import linear_to_srgb, srgb_to_linear
from gf_usd.core.scene import Bounds, Camera, Light
from gf_usd.view.render.camera import fit_camera, pinhole_camera, view_direction
from gf_usd.view.render.image import tone, untone, write_png
from gf_usd.view.render.lights import make_light_rig
from gf_usd.view.render.normals import corner_normals
from gf_usd.view.render.textures import LEVELS, make_atlas

Y_UP = (0.0, 1.0, 0.0)


@pytest.mark.parametrize("up", [Y_UP, (0.0, 0.0, 1.0)])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_the_fitted_camera_holds_the_box_and_no_more(up, aspect):
    box = Bounds(low=(10.0, -1.0, 3.0), high=(12.0, 4.0, 4.5))
    height = 1000
    camera = fit_camera(box.corners, up, aspect, margin=0.1)
    clip = pinhole_camera(camera, int(height * aspect), height, np.zeros(3)).clip(box.corners)
    across = np.abs(2.0 * clip[:, 0] / clip[:, 2] / (height * aspect) - 1.0).max()
    down = np.abs(2.0 * clip[:, 1] / clip[:, 2] / height - 1.0).max()
    # the tighter way reaches the margin exactly, the other stays inside
    assert max(across, down) == pytest.approx(0.9, abs=1e-9)
    assert (clip[:, 2] > 0.0).all()


def test_the_front_of_an_asset_faces_the_camera():
    assert view_direction(np.array(Y_UP))[2] > 0.5
    assert view_direction(np.array((0.0, 0.0, 1.0)))[1] < -0.5


def test_a_lone_point_gets_a_camera():
    camera = fit_camera(np.array([[1.0, 2.0, 3.0]]), Y_UP, 1.0)
    assert np.linalg.norm(np.subtract(camera.eye, camera.target)) == pytest.approx(1.0)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), Y_UP])
def test_a_camera_without_direction_is_refused(up):
    target = (0.0, 0.0, 0.0) if up == Y_UP else (0.0, 0.0, -5.0)
    with pytest.raises(UsageError, match="no direction"):
        pinhole_camera(Camera(eye=(0.0, 0.0, 0.0), target=target, up=up), 10, 10, np.zeros(3))


def test_a_rig_has_light_even_straight_from_above():
    rig = make_light_rig((), np.array(Y_UP), np.array(Y_UP))
    assert np.isfinite(rig.frames).all()
    axes = rig.frames[:, :9].reshape(-1, 3, 3)
    assert np.allclose(axes @ np.swapaxes(axes, 1, 2), np.eye(3), atol=1e-6)


def test_more_lights_than_can_be_drawn_are_refused():
    light = Light(direction=Y_UP, radiance=(1.0, 1.0, 1.0))
    with pytest.raises(UsageError, match="has 3 lights"):
        make_light_rig((light, light, light), np.array((1.0, 0.0, 0.0)), np.array(Y_UP))


def test_smooth_normals_of_a_ball_point_outward():
    ball = trimesh.creation.icosphere(subdivisions=3)
    normals = corner_normals(ball.vertices, ball.faces, 50.0)
    # a face spans 8 degrees; angle weights on so regular a mesh leave well under one
    cosine = np.einsum("tci,tci->tc", normals, ball.vertices[ball.faces])
    assert cosine.min() > np.cos(np.radians(1.0))


def test_a_box_keeps_its_edges_and_a_wide_crease_rounds_them():
    box = trimesh.creation.box()
    flat = corner_normals(box.vertices, box.faces, 50.0)
    assert np.allclose(flat, box.face_normals[:, None, :], atol=1e-6)
    # each corner's three right angles weigh alike, however its faces were cut
    round_ = corner_normals(box.vertices, box.faces, 180.0)
    expected = np.sign(box.vertices[box.faces]) / np.sqrt(3.0)
    assert np.allclose(round_, expected, atol=1e-6)


def test_a_triangle_without_area_does_not_spoil_its_neighbors():
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.5, 0, 0)], dtype=float)
    normals = corner_normals(points, np.array([(0, 1, 2), (0, 3, 1)]), 50.0)
    assert np.isfinite(normals).all()
    assert np.allclose(normals[0], (0, 0, 1))


def test_every_mip_level_has_the_mean_of_the_texture():
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (64, 16, 3), dtype=np.uint8)
    atlas = make_atlas((Texture(pixels=pixels, srgb=True), Texture(pixels=pixels, srgb=False)))
    for index, linear in enumerate((srgb_to_linear(pixels / 255.0), pixels / 255.0)):
        assert atlas.kinds[index, 0] == 7
        for level in range(7):
            start, width, height = atlas.levels[index * LEVELS + level]
            block = atlas.texels[start : start + width * height]
            assert np.allclose(block.mean(axis=0), linear.mean(axis=(0, 1)), atol=1e-5)


def test_the_transfer_function_and_the_tone_curve_have_inverses():
    value = np.linspace(0.0, 1.0, 101)
    assert np.allclose(srgb_to_linear(linear_to_srgb(value)), value, atol=1e-6)
    shown = np.linspace(0.0, 0.99, 100)
    assert np.allclose(tone(untone(shown)), shown, atol=1e-9)
    assert np.all(np.diff(tone(np.linspace(0.0, 3.0, 300))) > 0.0)


def test_a_png_holds_the_pixels(tmp_path):
    pixels = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)
    write_png(tmp_path / "a.png", pixels)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), pixels)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"missing.out\.png cannot be written"):
        write_png(tmp_path / "missing" / "out.png", np.zeros((2, 2, 3), dtype=np.uint8))
