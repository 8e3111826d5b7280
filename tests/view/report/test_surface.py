"""A mesh split for a graphics card, and how its stretch is measured."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import BOX, TRIANGLES, FallingBox

from gf_usd.core.asset import Texture
from gf_usd.core.scene import RenderMesh
from gf_usd.view.report.motion import SurfaceStretch, stretch_range, volume_ratio
from gf_usd.view.report.surface import corner_colors, make_display_mesh, smooth_groups


def box(colors: np.ndarray | None = None, crease: float = 50.0) -> RenderMesh:
    colors = np.full((12, 3, 3), 0.5) if colors is None else colors
    return RenderMesh(
        name="/Box", points=BOX, triangles=TRIANGLES, colors=colors, crease_angle=crease,
        roughness=np.array(0.5), metallic=np.array(0.0),
    )  # fmt: skip


def test_a_box_has_three_normals_a_corner_and_a_smooth_one_has_one():
    sharp = make_display_mesh([box()], 100)
    assert len(sharp.source) == 24  # 8 corners x 3 sides
    assert len(set(sharp.shade.tolist())) == 24
    smooth = make_display_mesh([box(crease=95.0)], 100)
    assert len(smooth.source) == 8
    # triangles of a side share their normals
    groups = smooth_groups(BOX, TRIANGLES, np.full(12, 50.0)).reshape(12, 3)
    assert set(groups[0]) & set(groups[1])
    assert not set(groups[0]) & set(groups[2])


def test_vertices_split_where_the_color_changes_and_keep_their_normal():
    colors = np.full((12, 3, 3), 0.1)
    colors[::2] = 0.9  # one triangle of each side
    skin = make_display_mesh([box(colors, crease=180.0)], 100)
    assert len(skin.kept) == 8
    assert len(set(skin.shade.tolist())) == 8
    assert len(skin.source) > 8
    # every corner of a triangle has the color it came with
    shown = skin.colors[skin.corners][:, :, 0]
    assert (shown[::2] > 200).all()
    assert (shown[1::2] < 130).all()
    assert np.array_equal(skin.kept[skin.source][skin.corners], TRIANGLES)


def test_two_meshes_are_one_skin():
    skin = make_display_mesh([box(), box()], 100)
    assert (skin.vertices, skin.triangles, len(skin.kept)) == (16, 24, 16)
    assert np.array_equal(skin.kept[skin.source][skin.corners][12:], TRIANGLES + 8)
    empty = make_display_mesh([], 100)
    assert (len(empty.kept), empty.corners.shape) == (0, (0, 3))


@pytest.mark.parametrize(
    ("wrap", "u", "texel"),
    [("repeat", 1.3, 0), ("clamp", 1.3, 1), ("mirror", 1.3, 1), ("mirror", 1.8, 0)],
)
def test_textures_are_looked_up_at_the_corners(wrap, u, texel):
    pixels = np.array([[[255, 0, 0], [0, 0, 255]], [[9, 9, 9], [9, 9, 9]]], dtype=np.uint8)
    mesh = RenderMesh(
        name="/T", points=BOX, triangles=TRIANGLES[:1], colors=np.full((1, 3, 3), 0.5),
        uvs=np.array([[[u, 0.9], [0.2, 0.8], [0.7, 0.6]]]),
        textures=(Texture(pixels=pixels, srgb=True, wrap_s=wrap),),
        triangle_textures=np.array([0]), roughness=np.array(0.5), metallic=np.array(0.0),
    )  # fmt: skip
    # v above 1/2 is the top row
    expected = [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]
    assert corner_colors(mesh)[0].tolist() == [list(expected[k]) for k in (texel, 0, 1)]


def test_surface_stretch_is_that_of_the_deformation():
    F = np.array([[1.5, 0.2, 0.0], [0.0, 0.8, 0.1], [0.0, 0.0, 1.1]])
    # the sheet y = 0 feels the columns of x and z
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 0, 1), (1, 0, 1)], dtype=float)
    triangles = np.array([(0, 2, 1), (1, 2, 3)])
    surface = SurfaceStretch(points, triangles)
    truth = np.sort(np.linalg.svd(F[:, [0, 2]])[1])
    faces = surface.faces(points @ F.T)
    # sums of a few doubles
    assert faces == pytest.approx(np.tile(truth, (2, 1)), rel=1e-12)
    assert surface.at_vertices(faces) == pytest.approx(np.full(4, truth[1]), rel=1e-12)
    turned = points @ np.linalg.qr(F)[0].T + (3, 4, 5)
    assert surface.faces(turned) == pytest.approx(np.ones((2, 2)), rel=1e-12)


def test_slivers_and_lone_points_are_unstretched():
    points = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (9, 9, 9)], dtype=float)
    surface = SurfaceStretch(points, np.array([(0, 1, 2), (0, 1, 3)]))
    faces = surface.faces(points * 2.0)
    assert faces.shape == (1, 2)
    assert surface.at_vertices(faces) == pytest.approx([2, 2, 1, 2, 1])


def test_a_few_slivers_do_not_make_the_range_of_stretches():
    """One of the 1,359 faces of a car was stretched 160 times, and flattened all curves."""
    stretches = np.repeat([[0.9, 1.1], [0.8, 1.2], [1e-3, 160.0]], [500, 500, 1], axis=0)
    areas = np.repeat([1.0, 1e-3], [1000, 1])
    assert stretch_range(stretches, areas) == (0.8, 1.2)
    # where each face is a large part of the surface, none is left out
    assert stretch_range(stretches[-3:], np.ones(3)) == (1e-3, 160.0)
    assert stretch_range(stretches[:2], np.zeros(2)) == (0.9, 1.1)


def test_volume_ratio_needs_no_rotation():
    rng = np.random.default_rng(1)
    F = np.eye(3) + 0.3 * rng.standard_normal((20, 3, 3))
    turn = np.linalg.qr(rng.standard_normal((20, 3, 3)))[0]
    scales = rng.uniform(0.5, 2.0, (20, 3))
    axes = F @ turn * scales[:, None, :]
    assert volume_ratio(axes, scales) == pytest.approx(np.abs(np.linalg.det(F)), rel=1e-10)
    assert volume_ratio(axes[:1], np.zeros((1, 3))).tolist() == [1.0]


def test_the_box_of_the_tests_is_outward():
    normals = np.cross(BOX[TRIANGLES[:, 1]] - BOX[TRIANGLES[:, 0]],
                       BOX[TRIANGLES[:, 2]] - BOX[TRIANGLES[:, 0]])  # fmt: skip
    middle = BOX[TRIANGLES].mean(axis=1) - BOX.mean(axis=0)
    assert (np.einsum("ij,ij->i", normals, middle) > 0).all()
    assert FallingBox().recording().baked == (True,)
