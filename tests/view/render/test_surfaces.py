"""The surface pass against geometry that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.asset import Texture
from gf_usd.core.errors import UsageError
from gf_usd.core.scene import Bounds, Camera, RenderEllipsoids, RenderMesh, Scene
from gf_usd.system.taichi_runtime import ensure_taichi, init_taichi
from gf_usd.view.render import raster
from gf_usd.view.render.camera import pinhole_camera
from gf_usd.view.render.render import render, render_linear
from gf_usd.view.render.surfaces import BACKDROP, BACKDROP_EDGE

UP = (0.0, 1.0, 0.0)
FRONT = Camera(eye=(0.0, 0.0, 5.0), target=(0.0, 0.0, 0.0), up=UP, fov=40.0)
RED = np.array((0.9, 0.0, 0.0))
BLUE = np.array((0.0, 0.0, 0.9))


def mesh(points, triangles, color=RED, **rest) -> RenderMesh:
    return RenderMesh(
        name="/mesh",
        points=np.array(points, dtype=float),
        triangles=np.array(triangles),
        colors=color,
        roughness=np.array(1.0),
        metallic=np.array(0.0),
        **rest,
    )


def quad(z: float, color=RED, half: float = 0.8) -> RenderMesh:
    corners = [(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)]
    return mesh(corners, [(0, 1, 2), (0, 2, 3)], color)


def ball(height: float = 0.0) -> RenderEllipsoids:
    return RenderEllipsoids(
        name="/ball",
        positions=np.array([[0.0, height, 0.0]]),
        axes=np.eye(3)[None],
        colors=np.array([[0.8, 0.4, 0.1]]),
    )


def covered(points, triangles, width=200, height=150, camera=FRONT) -> np.ndarray:
    """(H, W) index of the triangle that is visible at each sample, -1 none."""
    ensure_taichi()
    view = pinhole_camera(camera, width, height, np.zeros(3))
    key = np.full((height, width), raster.EMPTY, dtype=np.int64)
    clip = view.clip(np.array(points, dtype=float))
    raster.draw_triangles(clip, np.array(triangles, dtype=np.int32), view.near, 0.0, key)
    return np.where(key == raster.EMPTY, -1, key & 0xFFFFFFFF)


def test_a_red_triangle_covers_its_area():
    corners = np.array([(-1.0, -0.7, 0.0), (1.1, -0.4, 0.0), (0.2, 0.9, 0.0)])
    view = pinhole_camera(FRONT, 200, 150, np.zeros(3))
    clip = view.clip(corners)
    flat = clip[:, :2] / clip[:, 2:]
    edges = np.roll(flat, -1, axis=0) - flat
    area = 0.5 * abs(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])
    perimeter = float(np.linalg.norm(edges, axis=1).sum())
    scene = Scene(up=UP, meshes=(mesh(corners, [(0, 1, 2)]),))
    picture = render_linear(scene, FRONT, (200, 150))
    red = float((picture[..., 0] > 2.0 * picture[..., 1]).sum())
    # a pixel is miscounted only where the outline crosses it: at most 2 a pixel of its length
    assert abs(red - area) < 2.0 * perimeter
    assert red > 0.9 * area
    # and by samples the error is random, far smaller than the outline
    samples = float((covered(corners, [(0, 1, 2)]) >= 0).sum())
    assert abs(samples - area) < 0.1 * perimeter


def test_neighbors_leave_no_crack_and_share_no_sample():
    ring = np.linspace(0.0, 2.0 * np.pi, 41)[:-1]
    rim = np.stack([np.cos(ring), np.sin(ring), np.zeros(40)], axis=1)
    points = np.concatenate([[(0.1, -0.2, 0.4)], rim])
    fan = [(0, i, i % 40 + 1) for i in range(1, 41)]
    together = covered(points, fan)
    alone = sum((covered(points, [one]) >= 0).astype(int) for one in fan)
    assert alone.max() == 1
    inside = covered(points, fan[::-1]) >= 0
    assert np.array_equal(inside, together >= 0)
    # the outline is convex: within each row the samples have no gap
    for row in together >= 0:
        hit = np.flatnonzero(row)
        assert len(hit) == 0 or len(hit) == hit[-1] - hit[0] + 1


def test_a_triangle_through_the_camera_is_cut_at_the_horizon():
    # an endless floor below the camera: exactly the lower half of the picture
    far = 1e7
    floor = [(-far, -1.0, far), (far, -1.0, far), (0.0, -1.0, -far)]
    level = Camera(eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, -1.0), up=UP, fov=60.0)
    seen = covered(floor, [(0, 1, 2)], camera=level) >= 0
    assert seen[75:].all()
    assert not seen[:75].any()


@pytest.mark.parametrize("swap", [False, True])
def test_the_nearer_surface_wins_in_any_order(swap):
    near, far = quad(0.5, RED), quad(-0.5, BLUE)
    scene = Scene(up=UP, meshes=(far, near) if swap else (near, far))
    middle = render_linear(scene, FRONT, (60, 40))[20, 30]
    assert middle[0] > 10.0 * middle[2]


def test_texture_coordinates_are_perspective_correct():
    # a floor that runs from 2 to 18 away, red nearer than half of it and blue beyond
    points = [(-1.0, -1.0, -2.0), (1.0, -1.0, -2.0), (1.0, -1.0, -18.0), (-1.0, -1.0, -18.0)]
    uvs = np.array([(0.5, 0.0), (0.5, 0.0), (0.5, 1.0), (0.5, 1.0)])
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    pixels = np.zeros((256, 4, 3), dtype=np.uint8)
    pixels[:128, :, 2] = 255  # row 0 is the top, v = 1
    pixels[128:, :, 0] = 255
    strip = mesh(
        points,
        triangles,
        uvs=uvs[triangles],
        textures=(Texture(pixels=pixels, srgb=True, wrap_s="clamp", wrap_t="clamp"),),
        triangle_textures=np.zeros(2, dtype=int),
    )
    camera = Camera(eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, -1.0), up=UP, fov=60.0)
    column = render_linear(Scene(up=UP, meshes=(strip,)), camera, (100, 400))[:, 50]
    blue = np.flatnonzero(column[:, 2] > 2.0 * column[:, 0])
    focal = 200.0 / np.tan(np.radians(30.0))
    # the colors meet at z = -10; linear interpolation in the picture would put it at z = -3.6
    boundary = 200.0 + focal / 10.0
    assert abs(blue.max() + 1 - boundary) <= 1.0


def test_an_ellipsoid_is_as_large_as_its_silhouette():
    seen = render_linear(Scene(up=UP, ellipsoids=(ball(),)), FRONT, (300, 300))
    disc = seen[..., 0] > 1.5 * seen[..., 2]
    focal = 150.0 / np.tan(np.radians(20.0))
    # a unit ball at distance 5 spans the cone of sine 1/5
    radius = focal * np.tan(np.arcsin(1.0 / 5.0))
    assert abs(disc.sum() - np.pi * radius**2) < 2.0 * np.pi * radius


def test_an_empty_scene_is_the_backdrop():
    picture = render_linear(Scene(up=UP, ground=0.0), FRONT, (80, 60))
    y, x = np.mgrid[0:60, 0:80]
    a, b = (2 * x + 1) / 80 - 1, 1 - (2 * y + 1) / 60
    t = np.clip((np.hypot(a, b - 0.12) - 0.15) / 1.4, 0.0, 1.0)
    t = (t * t * (3.0 - 2.0 * t))[..., None]
    expected = np.array(BACKDROP) * (1.0 - t) + np.array(BACKDROP_EDGE) * t
    # four samples a pixel average the gradient's curvature away: 1e-3 of 1
    assert np.abs(picture - expected).max() < 1e-3


@pytest.mark.slow
def test_the_floor_is_dark_where_the_body_stands_and_untouched_far_away():
    camera = Camera(eye=(0.0, 3.0, 12.0), target=(0.0, 0.0, 0.0), up=UP, fov=40.0)
    bare = render_linear(Scene(up=UP, ground=-1.0), camera, (160, 120))
    body = render_linear(Scene(up=UP, ground=-1.0, ellipsoids=(ball(),)), camera, (160, 120))
    ratio = (body / bare).mean(axis=2)
    below = ratio[70:90, 60:100]
    assert below.min() < 0.6
    assert np.array_equal(body[-1], bare[-1])
    floating = render_linear(Scene(up=UP, ellipsoids=(ball(),)), camera, (160, 120))
    assert np.array_equal(floating[85:], bare[85:])


@pytest.mark.slow
def test_shadows_on_a_ground_a_thousand_times_larger_are_there():
    """The maps of the shadows covered all of it, with texels larger than the body."""
    camera = Camera(eye=(0.0, 4.0, 12.0), target=(0.0, 0.0, 0.0), up=UP, fov=40.0)
    far = 1000.0
    corners = [(-far, -1.2, far), (far, -1.2, far), (far, -1.2, -far), (-far, -1.2, -far)]
    ground = mesh(corners, [(0, 1, 2), (0, 2, 3)], np.array((0.5, 0.5, 0.5)))
    focus = Bounds(low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 1.0))
    shadow = {}
    for name, about in (("all", None), ("body", focus)):
        bare, body = (
            render_linear(
                Scene(up=UP, meshes=(ground,), ellipsoids=balls, focus=about), camera, (160, 120)
            )
            for balls in ((), (ball(),))
        )
        # right below the ball, where its shadow is
        shadow[name] = float((body / bare).mean(axis=2)[71:74, 90:98].mean())
    assert shadow["all"] > 0.95
    assert shadow["body"] < 0.6


@pytest.mark.slow
def test_the_shadow_of_a_plate_on_a_ground_has_no_steps():
    """A ground of the stage has no light map that is blurred; the dome has 80 directions."""
    camera = Camera(eye=(0.0, 1.5, 14.0), target=(0.0, -0.6, 0.0), up=UP, fov=24.0)

    def lying(y, half):
        corners = [(-half, y, half), (half, y, half), (half, y, -half), (-half, y, -half)]
        return mesh(corners, [(0, 1, 2), (0, 2, 3)], np.array((0.5, 0.5, 0.5)))

    ground, plate = lying(-1.2, 8.0), lying(0.0, 1.6)
    focus = Bounds(low=(-1.6, -1.2, -1.6), high=(1.6, 0.0, 1.6))
    bare, dark = (
        render_linear(Scene(up=UP, meshes=meshes, focus=focus), camera, (320, 240))
        for meshes in ((ground,), (ground, plate))
    )
    seen = (dark / bare).mean(axis=2)[136:190]  # below the plate in the picture
    assert seen.min() < 0.2
    assert seen.max() > 0.95
    # A step is a change between two pixels beyond the changes on both sides of it.
    change = np.diff(seen, axis=1)
    steps = np.abs(change[:, 1:-1] - 0.5 * (change[:, :-2] + change[:, 2:]))
    # one look-up for each direction gives 0.024, five 0.012; steps of the key light are rarer
    assert np.quantile(steps, 0.999) < 0.017


@pytest.mark.slow
def test_a_picture_is_the_same_every_time_and_for_any_number_of_threads():
    scene = Scene(up=UP, ground=-1.0, meshes=(quad(0.2),), ellipsoids=(ball(0.3),))
    pictures = []
    for threads in (1, 2):
        init_taichi(threads=threads)
        pictures += [render(scene, None, (120, 90)) for _ in range(2)]
    assert all(np.array_equal(pictures[0], other) for other in pictures[1:])


@pytest.mark.parametrize("size", [(0, 10), (10, 9000)])
def test_an_impossible_size_is_refused(size):
    with pytest.raises(UsageError, match=f"{size[0]}x{size[1]}"):
        render(Scene(up=UP), None, size)
