"""Projected Gaussians against the closed form."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.matrices import gaussian_axes
from gf_usd.core.radiance import basis
from gf_usd.core.scene import Camera, Harmonics, RenderSplats, Scene
from gf_usd.system.taichi_runtime import ensure_taichi
from gf_usd.view.render.camera import pinhole_camera
from gf_usd.view.render.image import encode
from gf_usd.view.render.render import render
from gf_usd.view.render.splats import FILTER, MIN_OPACITY, draw_splats, view_dependent_color

UP = (0.0, 1.0, 0.0)
WIDTH, HEIGHT = 160, 120
DISTANCE = 5.0
CAMERA = Camera(eye=(0.0, 0.0, DISTANCE), target=(0.0, 0.0, 0.0), up=UP, fov=40.0)
FOCAL = 0.5 * HEIGHT / np.tan(np.radians(20.0))
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def splats(positions, scales, opacities, orientations=None, **rest) -> RenderSplats:
    positions = np.array(positions, dtype=float)
    if orientations is None:
        orientations = [IDENTITY] * len(positions)
    return RenderSplats(
        name="/splats",
        positions=positions,
        axes=gaussian_axes(np.array(orientations), np.array(scales)),
        colors=rest.pop("colors", np.ones((len(positions), 3))),
        opacities=np.array(opacities, dtype=float),
        **rest,
    )


def over_black(cloud: RenderSplats, depth: float = np.inf) -> np.ndarray:
    """(H, W, 3) the splats' own colors over black, behind nothing nearer than depth."""
    ensure_taichi()
    picture = np.zeros((HEIGHT, WIDTH, 3), dtype=np.float32)
    seen = np.full((HEIGHT, WIDTH), depth, dtype=np.float32)
    draw_splats(
        cloud, cloud.colors, pinhole_camera(CAMERA, WIDTH, HEIGHT, np.zeros(3)), picture, seen
    )
    return picture


def grid() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    return x + 0.5 - WIDTH / 2, HEIGHT / 2 - y - 0.5


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.3])
def test_an_isotropic_splat_is_a_gaussian(sigma):
    picture = over_black(splats([(0, 0, 0)], [(sigma,) * 3], [0.8]))[..., 0]
    x, y = grid()
    own = (FOCAL * sigma / DISTANCE) ** 2
    wide = own + FILTER
    expected = 0.8 * (own / wide) * np.exp(-0.5 * (x * x + y * y) / wide)
    # opacity below MIN_OPACITY is left out; the rest is single-precision rounding
    assert np.abs(picture - expected).max() < MIN_OPACITY
    shown = expected > 1.01 * MIN_OPACITY
    assert np.abs(picture - expected)[shown].max() < 1e-5


def test_a_long_splat_lies_along_its_axis():
    turn = np.radians(30.0)
    about_z = (np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2))
    picture = over_black(splats([(0, 0, 0)], [(0.25, 0.05, 0.05)], [0.9], [about_z]))[..., 0]
    x, y = grid()
    mass = picture.sum()
    xx, xy, yy = (picture * x * x).sum(), (picture * x * y).sum(), (picture * y * y).sum()
    angle = np.degrees(0.5 * np.arctan2(2 * xy, xx - yy))
    # the cut at MIN_OPACITY trims both axes alike: a tenth of a degree
    assert abs(angle - 30.0) < 0.1
    moments = np.linalg.eigvalsh(np.array([[xx, xy], [xy, yy]]) / mass)
    lengths = np.sqrt(np.maximum(moments - FILTER, 0.0)) * DISTANCE / FOCAL
    # what is trimmed holds 1 % of a variance
    assert np.allclose(lengths, [0.05, 0.25], rtol=0.02)


def test_splats_blend_front_to_back_in_any_order():
    near, far = (0.0, 0.0, 0.5), (0.0, 0.0, -0.5)
    colors = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    one = splats([near, far], [(0.3,) * 3] * 2, [0.5, 0.6], colors=colors)
    two = splats([far, near], [(0.3,) * 3] * 2, [0.6, 0.5], colors=colors[::-1])
    picture = over_black(one)
    assert np.array_equal(picture, over_black(two))
    x, y = grid()
    alphas = []
    for opacity, depth in ((0.5, DISTANCE - 0.5), (0.6, DISTANCE + 0.5)):
        own = (FOCAL * 0.3 / depth) ** 2
        square = x * x + y * y
        alphas.append(opacity * own / (own + FILTER) * np.exp(-0.5 * square / (own + FILTER)))
    a, b = (alpha[HEIGHT // 2, WIDTH // 2] for alpha in alphas)
    assert np.allclose(picture[HEIGHT // 2, WIDTH // 2], [a, 0.0, (1 - a) * b], atol=1e-5)


def test_a_surface_in_front_hides_splats():
    cloud = splats([(0, 0, 0)], [(0.2,) * 3], [0.9])
    assert over_black(cloud, depth=DISTANCE + 0.1).max() > 0.5
    assert over_black(cloud, depth=DISTANCE - 0.1).max() == 0.0


def test_splats_behind_the_camera_and_without_opacity_do_not_show():
    cloud = splats([(0, 0, 9), (0, 0, 0)], [(0.2,) * 3] * 2, [0.9, 0.0])
    assert over_black(cloud).max() == 0.0


@pytest.mark.slow
def test_captured_colors_come_out_as_they_are():
    sheet = np.stack(np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 40)), -1).reshape(-1, 2)
    positions = np.concatenate([sheet, np.zeros((len(sheet), 1))], axis=1)
    color = np.array((0.6, 0.3, 0.75))
    cloud = splats(
        positions,
        [(0.1,) * 3] * len(sheet),
        np.ones(len(sheet)),
        colors=np.tile(color, (1600, 1)),
    )
    shown = render(Scene(up=UP, splats=(cloud,)), CAMERA, (WIDTH, HEIGHT))[HEIGHT // 2, WIDTH // 2]
    flat = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055)
    # one step of 8 bits and the dither's one
    assert np.abs(shown - 255.0 * flat).max() <= 2.0


@pytest.mark.slow
def test_a_lit_splat_shows_less_on_the_side_away_from_the_light():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes = np.zeros((3000, 3, 3))
    for i, n in enumerate(normals):
        u = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        u /= np.linalg.norm(u)
        axes[i] = np.stack([0.01 * n, 0.06 * u, 0.06 * np.cross(n, u)], axis=1)
    cloud = RenderSplats(
        name="/ball",
        positions=normals,
        axes=axes,
        colors=np.full((3000, 3), 0.6),
        opacities=np.full(3000, 0.95),
        lit=True,
    )
    picture = render(Scene(up=UP, splats=(cloud,)), CAMERA, (WIDTH, HEIGHT)).mean(axis=2)
    # the studio's key stands above, on the left
    assert picture[45, 65] > 1.3 * picture[75, 95]


@pytest.mark.slow
def test_rendering_splats_is_reproducible():
    rng = np.random.default_rng(1)
    cloud = splats(
        rng.normal(size=(500, 3)) * 0.5,
        np.exp(rng.normal(size=(500, 3))) * 0.05,
        rng.random(500),
        rng.normal(size=(500, 4)),
        colors=rng.random((500, 3)),
    )
    scene = Scene(up=UP, splats=(cloud,), ground=-1.0)
    first, second = (render(scene, CAMERA, (WIDTH, HEIGHT)) for _ in range(2))
    assert np.array_equal(first, second)


def test_harmonics_are_orthonormal():
    # Gauss-Legendre in height and even steps around integrate degree 6 exactly
    height, weight = np.polynomial.legendre.leggauss(8)
    around = np.arange(16) * np.pi / 8
    z, t = (part.ravel() for part in np.meshgrid(height, around, indexing="ij"))
    ring = np.sqrt(1 - z * z)
    y = basis(np.stack([ring * np.cos(t), ring * np.sin(t), z], axis=1))
    w = np.repeat(weight, 16) * np.pi / 8
    assert np.allclose(y.T @ (w[:, None] * y), np.eye(16), atol=1e-12)


def test_harmonics_turn_with_their_frame():
    coefficients = np.zeros((1, 4, 3))
    coefficients[0, 2] = 1.0  # proportional to z in the space of the coefficients
    tilt = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # world y to local z
    turned = Harmonics(coefficients=coefficients, frame=tilt, srgb=False)
    rate = np.sqrt(3 / (4 * np.pi))
    assert np.allclose(view_dependent_color(turned, np.array([[0.0, 2.0, 0.0]])), 0.5 + rate)
    assert np.allclose(view_dependent_color(turned, np.array([[3.0, 0.0, 0.0]])), 0.5)


def test_encode_keeps_black_and_is_monotone():
    ramp = np.repeat(np.linspace(0.0, 3.0, 200)[None, :, None], 3, axis=2)
    codes = encode(ramp).astype(int)
    assert codes[0, 0].max() == 0
    # the dither is less than one step
    assert (np.diff(codes[0, :, 0]) >= -1).all()
    assert codes.max() <= 255
