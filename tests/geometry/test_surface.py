"""The nearest surface point, its normal and its color."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd
from solids import CUBE_TRIANGLES, cube, solid, sphere, surface

from gf_usd.core.asset import NO_COLOR, SurfaceMaterial, Texture
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.geometry.surface import barycentric, colors, nearest, nearest_own, sample
from gf_usd.readers.pictures.prims import to_render_mesh

RED, GREEN, BLUE = (0.8, 0.1, 0.1), (0.1, 0.7, 0.2), (0.0, 0.2, 0.9)


def test_the_nearest_point_of_a_box_by_face_normal_and_distance():
    body = solid(cube())
    X = np.array([[0.5, 0.5, 0.1], [0.05, 0.4, 0.6], [0.5, 2.0, 0.5], [0.6, 0.5, 0.9]])
    at = nearest(body, X)
    np.testing.assert_allclose(at.distance, [0.1, 0.05, 1.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(
        at.normal, [[0, 0, -1], [-1, 0, 0], [0, 1, 0], [0, 0, 1]], atol=1e-12
    )
    shape = body.surfaces[0]
    found = np.einsum("nk,nkd->nd", at.barycentric, shape.points[shape.triangles[at.triangle]])
    np.testing.assert_allclose(
        found, [[0.5, 0.5, 0], [0, 0.4, 0.6], [0.5, 1, 0.5], [0.6, 0.5, 1]], atol=1e-12
    )


def test_normals_of_an_inside_out_surface_still_point_outward():
    shape = sphere()
    turned = surface(shape.points, shape.triangles[:, ::-1])
    X = 0.7 * shape.points[::20]
    normal = nearest(solid(turned), X).normal
    assert ((normal * X).sum(1) > 0.6).all()


def test_each_point_finds_its_own_surface_far_from_the_origin():
    far = np.array([4e5, 0.0, -3e5])
    body = solid(cube(low=far, path="/A"), cube(low=far + [5.0, 0.0, 0.0], path="/B"))
    at = nearest(body, far + [[0.5, 0.5, 0.2], [5.5, 0.5, 0.2]])
    assert at.surface.tolist() == [0, 1]
    # Positions of 5e5 m have 6e-11 m left in float64.
    np.testing.assert_allclose(at.distance, 0.2, atol=1e-9)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("overlap", [0.0, 3e-8])  # [m] less than the rounding of float32 at 1 m
def test_of_surfaces_that_coincide_a_point_gets_the_one_around_it(turned, overlap):
    below, above = cube(edge=(1.0, 1.0, 0.5)), cube((0.3, 0.3, 0.5 - overlap), 0.4)
    body = solid(above, below) if turned else solid(below, above)
    grid = 0.35 + 0.1 * np.indices((4, 4)).reshape(2, -1).T
    X = np.array([[x, y, 0.5 + z] for z in (-0.04, 0.04) for x, y in grid])
    at, high = nearest_own(body, X), X[:, 2] > 0.5
    assert (at.surface == (high ^ turned)).all()
    np.testing.assert_allclose(at.normal[:, 2], np.where(high, -1.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(at.distance, 0.04, atol=1e-7)
    triangles = [s.triangles for s in body.surfaces]
    found = [
        w @ body.surfaces[s].points[triangles[s][t]]
        for s, t, w in zip(at.surface, at.triangle, at.barycentric)
    ]
    np.testing.assert_allclose(found, np.c_[X[:, :2], np.full(len(X), 0.5)], atol=1e-7)


def test_a_point_belongs_to_the_innermost_surface_around_it():
    """It belonged to the nearest one: a bead of metal made much of the rubber around it metal."""
    body = solid(cube(), cube((0.4, 0.4, 0.4), 0.2))
    X = np.array([[0.5, 0.5, 0.35], [0.5, 0.5, 0.1], [0.5, 0.5, 0.5], [0.45, 0.5, 0.45]])
    own = nearest_own(body, X)
    assert own.surface.tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(own.distance, [0.35, 0.1, 0.1, 0.05], atol=1e-12)
    assert nearest(body, X).surface.tolist() == [1, 0, 1, 1]


def test_a_point_in_two_surfaces_that_overlap_belongs_to_the_nearer():
    body = solid(cube(), cube((0.6, 0.0, 0.0)))
    X = np.array([[0.7, 0.5, 0.5], [0.9, 0.5, 0.5], [0.58, 0.5, 0.5], [1.02, 0.5, 0.5]])
    assert nearest_own(body, X).surface.tolist() == [1, 0, 0, 1]


def test_a_point_in_no_surface_belongs_to_the_nearest():
    body = solid(cube(), cube((2.0, 0.0, 0.0)))
    assert nearest_own(body, np.array([[1.2, 0.5, 0.5], [1.8, 0.5, 0.5]])).surface.tolist() == [
        0,
        1,
    ]


def test_rows_are_those_of_the_authored_triangles():
    triangles = np.insert(CUBE_TRIANGLES, 0, [7, 7, 2], axis=0)  # a collapsed one first
    body = solid(surface(cube().points, triangles))
    at = nearest(body, np.array([[0.5, 0.4, 0.02]]))
    assert at.triangle[0] in (1, 2)  # the two of the face z = 0, one row later than in the cube


def test_barycentric_weights_of_corners_middles_and_slivers():
    a, b, c = (np.array([p], float) for p in ([0, 0, 0], [2, 0, 0], [0, 3, 0]))
    p = np.array([[0, 0, 0], [1, 0, 0], [0, 3, 0]], float)
    wanted = [[1, 0, 0], [0.5, 0.5, 0], [0, 0, 1]]
    np.testing.assert_allclose(barycentric(p, *np.repeat([a, b, c], 3, 1)), wanted, atol=1e-15)
    np.testing.assert_allclose(barycentric(a, a, a, a), [[1.0, 0.0, 0.0]])


def face_colors(shape, X=((0.5, 0.4, 0.05), (0.5, 0.6, 0.95))):
    body = solid(shape)
    return colors(body, nearest(body, np.array(X)))


def test_nothing_said_is_the_gray_that_the_mesh_is_drawn_in():
    """What a body turns into, particles or the surface of a flow, keeps its color."""
    np.testing.assert_array_equal(face_colors(cube()), [NO_COLOR] * 2)
    drawn = to_render_mesh(cube(), Usd.Stage.CreateInMemory(), Usd.TimeCode.Default())
    np.testing.assert_array_equal(drawn.colors, np.tile(NO_COLOR, (12, 3, 1)))


def test_display_colors_are_blended_over_the_triangle():
    corner = np.zeros((12, 3, 3))
    corner[:] = cube().points[CUBE_TRIANGLES]  # color = position
    got = face_colors(cube(triangle_colors=corner))
    np.testing.assert_allclose(got, [[0.5, 0.4, 0.0], [0.5, 0.6, 1.0]], atol=1e-12)


def test_a_bound_constant_wins_over_display_color_where_it_is_bound():
    bound = np.full(12, -1)
    bound[:2] = 1
    shape = cube(
        triangle_colors=np.tile(RED, (12, 3, 1)), triangle_materials=bound,
        materials=(
            SurfaceMaterial(path="/M0", color=BLUE), SurfaceMaterial(path="/M1", color=GREEN),
        ),
    )  # fmt: skip
    np.testing.assert_allclose(face_colors(shape), [GREEN, RED])


def test_a_texture_wins_over_its_materials_constant():
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [51, 51, 51]]], np.uint8)
    uvs = cube().points[CUBE_TRIANGLES][..., :2]  # u = x, v = y on the faces across z
    made = SurfaceMaterial(path="/M", color=BLUE, texture=Texture(pixels=pixels, srgb=False))
    shape = cube(triangle_uvs=uvs, triangle_materials=np.zeros(12, int), materials=(made,))
    # Texel centers lie at 1/4 and 3/4; row 0 is at the top, v = 3/4.
    X = [(0.25, 0.75, 0.01), (0.75, 0.75, 0.01), (0.25, 0.25, 0.99), (0.75, 0.25, 0.99)]
    wanted = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.2, 0.2]]
    np.testing.assert_allclose(face_colors(shape, X), wanted, atol=1e-9)


def test_a_texture_without_coordinates_falls_back_to_its_constant():
    texture = Texture(pixels=np.zeros((1, 1, 3), np.uint8), srgb=True)
    made = SurfaceMaterial(path="/M", color=GREEN, texture=texture)
    shape = cube(triangle_materials=np.zeros(12, int), materials=(made,))
    np.testing.assert_allclose(face_colors(shape), [GREEN, GREEN])


def test_every_surface_gives_its_own_color():
    a = cube(path="/A", triangle_colors=np.tile(RED, (12, 3, 1)))
    b = cube(low=(3.0, 0.0, 0.0), path="/B", triangle_colors=np.tile(BLUE, (12, 3, 1)))
    body = solid(a, b)
    got = colors(body, nearest(body, np.array([[3.5, 0.5, 0.1], [0.5, 0.5, 0.1]])))
    np.testing.assert_allclose(got, [BLUE, RED])


def test_texels_are_blended_in_linear_light():
    pixels = np.array([[[0, 0, 0], [188, 188, 188]]], np.uint8)
    half = sample(Texture(pixels=pixels, srgb=True), np.array([[0.5, 0.5]]))
    np.testing.assert_allclose(half, 0.5 * srgb_to_linear(np.full((1, 3), 188.0 / 255.0)))


@pytest.mark.parametrize(
    ("mode", "beyond"),
    [("repeat", [0.2, 1.0]), ("clamp", [1.0, 0.2]), ("mirror", [1.0, 0.2]), ("black", [0.0, 0.0])],
)
def test_coordinates_beyond_the_picture_follow_its_wrap_mode(mode, beyond):
    # Texel centers lie at u = 1/6, 3/6, 5/6: these are one beyond either end.
    pixels = np.array([[[51] * 3, [153] * 3, [255] * 3]], np.uint8)
    texture = Texture(pixels=pixels, srgb=False, wrap_s=mode, wrap_t="repeat")
    got = sample(texture, np.array([[7.0 / 6.0, 0.5], [-1.0 / 6.0, 0.5]]))[:, 0]
    np.testing.assert_allclose(got, beyond, atol=1e-9)
