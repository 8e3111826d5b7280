"""TetMesh prims: their surface, orientation and rest shape, and tetrahedra that are no body."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges
from gf_usd.readers.usd.solids.tets import boundary, signed_volumes

# A cube of edge 1 in six tetrahedra around its diagonal (Kuhn), each of volume 1/6.
CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
OWN = [tuple(row) for row in np.arange(24).reshape(6, 4).tolist()]
KUHN = [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]


def tet_mesh(inner: str = "", points=CORNERS, tets=KUHN, apis: str = "") -> str:
    schemas = f"(prepend apiSchemas = [{apis}])" if apis else ""
    return (
        f'def TetMesh "T" {schemas}\n{{\npoint3f[] points = {points}\n'
        f"int4[] tetVertexIndices = {tets}\n{inner}\n}}"
    )


def test_the_surface_of_a_cube_is_its_twelve_triangles(read) -> None:
    (surface,) = read(tet_mesh()).surfaces
    assert (surface.path, surface.type_name, surface.own_points) == ("/T", "TetMesh", None)
    assert surface.triangles.shape == (12, 3)
    assert not len(boundary_edges(surface.triangles))
    assert signed_volume(surface.points, surface.triangles) == pytest.approx(1.0)
    np.testing.assert_allclose(signed_volumes(surface.points, np.array(KUHN)), 1 / 6)


def test_points_inside_stay_points_of_the_surface_that_move_with_it(read) -> None:
    (surface,) = read(
        tet_mesh(
            points=[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.2, 0.2, 0.2)],
            tets=[(4, 1, 2, 3), (0, 4, 2, 3), (0, 1, 4, 3), (0, 1, 2, 4)],
        )
    ).surfaces
    assert len(surface.points) == 5
    assert not (surface.triangles == 4).any()
    assert signed_volume(surface.points, surface.triangles) == pytest.approx(1 / 6)


def test_tetrahedra_with_points_of_their_own_are_one_body(read) -> None:
    points = [CORNERS[corner] for tet in KUHN for corner in tet]
    (surface,) = read(tet_mesh(points=points, tets=OWN)).surfaces
    assert len(surface.points) == 24
    assert len(surface.triangles) == 12
    assert signed_volume(surface.points, surface.triangles) == pytest.approx(1.0)


@pytest.mark.parametrize("mirror", [1, -1])
@pytest.mark.parametrize("handed", ["rightHanded", "leftHanded"])
def test_outside_is_outside_whatever_the_orientation(read, handed: str, mirror: int) -> None:
    tets = KUHN if handed == "rightHanded" else [(a, c, b, d) for a, b, c, d in KUHN]
    asset = read(
        tet_mesh(
            f'uniform token orientation = "{handed}"\n'
            f"double3 xformOp:scale = ({mirror}, 2, 1)\n"
            'uniform token[] xformOpOrder = ["xformOp:scale"]',
            tets=tets,
        )
    )
    assert signed_volume(asset.surfaces[0].points, asset.surfaces[0].triangles) == pytest.approx(2)
    assert not any("reversed" in note for note in asset.facts.notes)


def test_tetrahedra_of_the_opposite_orientation_are_reversed(read) -> None:
    asset = read(tet_mesh('uniform token orientation = "leftHanded"'))
    assert signed_volume(asset.surfaces[0].points, asset.surfaces[0].triangles) == pytest.approx(1)
    assert any("contradicts its orientation" in note for note in asset.facts.notes)


def test_authored_faces_keep_their_order_so_that_values_find_them(read) -> None:
    faces = boundary(np.array(KUHN))[::-1].tolist()
    colors = ", ".join(f"({k / 12}, 0, 0)" for k in range(12))
    asset = read(
        tet_mesh(
            f"int3[] surfaceFaceVertexIndices = {[tuple(face) for face in faces]}\n"
            f'color3f[] primvars:displayColor = [{colors}] (interpolation = "uniform")'
        )
    )
    (surface,) = asset.surfaces
    np.testing.assert_array_equal(surface.triangles, faces)
    np.testing.assert_allclose(surface.triangle_colors[:, 0, 0], np.arange(12) / 12, atol=1e-6)


def test_authored_faces_that_point_inward_are_turned_round(read) -> None:
    faces = boundary(np.array(KUHN))
    faces[:5] = faces[:5, ::-1]
    shown = [tuple(face) for face in faces.tolist()]
    asset = read(tet_mesh(f"int3[] surfaceFaceVertexIndices = {shown}"))
    assert signed_volume(asset.surfaces[0].points, asset.surfaces[0].triangles) == pytest.approx(1)
    assert any("5 of its 12 surfaceFaceVertexIndices" in note for note in asset.facts.notes)


REST = '"PhysicsVolumeDeformableSimAPI"'


@pytest.mark.parametrize("name", ["physics:restShapePoints", "omniphysics:restShapePoints"])
def test_a_rest_shape_that_is_strained_is_said(read, name: str) -> None:
    wide = [(1.5 * x, y, z) for x, y, z in CORNERS]
    asset = read(tet_mesh(f"point3f[] {name} = {wide}", apis=REST))
    # The edge along x is .5 shorter than at rest, where the longest is |(1.5, 1, 1)| = 2.06.
    assert any("by 24 % of the longest" in note for note in asset.facts.notes)
    np.testing.assert_allclose(asset.surfaces[0].points, CORNERS)


def test_a_rest_shape_that_stands_elsewhere_says_nothing(read) -> None:
    away = [(x + 7, -z, y) for x, y, z in CORNERS]  # turned and moved
    asset = read(tet_mesh(f"point3f[] physics:restShapePoints = {away}", apis=REST))
    assert not any("rest shape" in note for note in asset.facts.notes)


def test_a_rest_shape_may_have_points_and_tetrahedra_of_its_own(read) -> None:
    points = [CORNERS[corner] for tet in KUHN for corner in tet]
    inner = f"point3f[] physics:restShapePoints = {points}"
    inner += f"\nint4[] physics:restTetVertexIndices = {OWN}"
    asset = read(tet_mesh(inner, apis=REST))
    assert not any("rest shape" in note for note in asset.facts.notes)


INVERTED = [*KUHN[:4], (0, 5, 1, 7), KUHN[5]]


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            tet_mesh(tets=[*KUHN[:5], (0, 5, 4, 8)]),
            "</T>: 1 tetVertexIndices do not refer to any of its 8 points; the first is 8",
        ),
        (
            tet_mesh(tets=INVERTED),
            "</T>: 1 of 6 tetrahedra are inverted at its points: number 4 has a volume of -0.167",
        ),
        (
            tet_mesh(tets=[*KUHN, (0, 4, 6, 7), (0, 4, 6, 7)]),
            "faces belong to more than two tetrahedra",
        ),
        (
            tet_mesh("int3[] surfaceFaceVertexIndices = [(0, 4, 6), (0, 4, 7)]"),
            "1 of its 2 surfaceFaceVertexIndices are not faces of the surface of its tetrahedra,"
            " and 11 of the 12 faces of that surface are missing",
        ),
        (
            tet_mesh("int3[] surfaceFaceVertexIndices = [(0, 4, 9)]"),
            "1 surfaceFaceVertexIndices do not refer to any of its 8 points; the first is 9",
        ),
        (
            tet_mesh(points=[(x, y, 0) for x, y, _ in CORNERS]),
            "all of its 6 tetrahedra have no volume at its points",
        ),
        (
            tet_mesh("point3f[] physics:restShapePoints = [(0, 0, 0)]", apis=REST),
            "it has 8 points but 1 restShapePoints",
        ),
        (
            tet_mesh(
                f"point3f[] physics:restShapePoints = {CORNERS}\n"
                f"int4[] physics:restTetVertexIndices = {INVERTED}",
                apis=REST,
            ),
            "1 of 6 tetrahedra are inverted at its rest shape",
        ),
        (
            tet_mesh(points=["(nan, 0, 0)", *CORNERS[1:]]).replace("'", ""),
            "1 of 8 points are not finite",
        ),
    ],
)
def test_broken_tetrahedra_are_refused_in_words(read, body: str, message: str) -> None:
    with pytest.raises(InputError) as refused:
        read(body)
    assert message in str(refused.value)
    assert "</T>: " in str(refused.value)
    assert refused.value.hint


def test_a_tet_mesh_of_nothing_is_left_alone(read) -> None:
    with pytest.raises(InputError, match="has 0 points and 0 tetrahedra"):
        read('def TetMesh "T" {}')
