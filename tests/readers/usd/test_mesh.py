"""Meshes: transforms, winding, holes, normals, displayColor, and data that is broken."""

import numpy as np
import pytest

from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges
from gf_usd.geometry.solid import closed_triangles

# A unit cube on the origin, quads, outward.
CUBE = """
    point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0), (0,0,1), (1,0,1), (1,1,1), (0,1,1)]
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [3,2,1,0, 4,5,6,7, 0,1,5,4, 2,3,7,6, 1,2,6,5, 3,0,4,7]
"""


def mesh(inner="", metadata="", cube=CUBE):
    return f'def Mesh "M" {metadata}\n{{\n{cube}\n{inner}\n}}'


def test_the_plain_cube(read):
    (surface,) = read(mesh()).surfaces
    assert (surface.path, surface.type_name) == ("/M", "Mesh")
    assert surface.points.shape == (8, 3)
    assert surface.triangles.shape == surface.triangle_corners.shape == (12, 3)
    np.testing.assert_array_equal(surface.face_indices[surface.triangle_corners], surface.triangles)
    assert signed_volume(surface.points, surface.triangles) == pytest.approx(1.0)
    assert surface.normals is surface.triangle_colors is surface.triangle_uvs is None
    assert surface.triangle_materials is None
    assert not surface.skinned


PIECES = """
def Xform "Set" (kind = "assembly")
{
    def Mesh "Cloth" { CUBE }
    def Xform "White" (kind = "group")
    {
        def Xform "King" (kind = "component")
        {
            def Xform "Crown" (kind = "subcomponent")
            {
                def Mesh "Cross" { CUBE }
            }
            def Xform "Base" (kind = "component")
            {
                def Mesh "Foot" { CUBE }
            }
        }
    }
}
def Mesh "Board" (kind = "component") { CUBE }
""".replace("CUBE", CUBE)


def test_the_outermost_component_of_a_mesh(read):
    assert {s.path: s.component for s in read(PIECES).surfaces} == {
        "/Set/Cloth": "",
        "/Set/White/King/Crown/Cross": "/Set/White/King",
        "/Set/White/King/Base/Foot": "/Set/White/King",
        "/Board": "/Board",
    }


TRANSFORM = """
    double3 xformOp:translate = (10, 0, 0)
    float3 xformOp:rotateXYZ = (0, 90, 0)
    double3 xformOp:scale = (%s)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
"""


@pytest.mark.parametrize(
    ("scale", "handed"),
    [("1, 2, 3", ""), ("-1, 2, 3", ""), ("1, 2, 3", "left"), ("-1, 2, 3", "left")],
)
def test_volume_is_positive_whatever_mirrors_it(read, scale, handed):
    cube, left = CUBE, ""
    if handed:
        left = 'uniform token orientation = "leftHanded"'
        # The same cube with the winding of every face reversed.
        cube = CUBE.replace(
            "[3,2,1,0, 4,5,6,7, 0,1,5,4, 2,3,7,6, 1,2,6,5, 3,0,4,7]",
            "[0,1,2,3, 7,6,5,4, 4,5,1,0, 6,7,3,2, 5,6,2,1, 7,4,0,3]",
        )
        assert cube != CUBE
    (surface,) = read(mesh(TRANSFORM % scale + left, cube=cube), meters_per_unit=0.01).surfaces
    assert signed_volume(surface.points, surface.triangles) == pytest.approx(6e-6)
    np.testing.assert_array_equal(surface.face_indices[surface.triangle_corners], surface.triangles)
    # Rotated 90 degrees about Y, the local z (size 3) runs along x from 10 [units of 0.01 m].
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    np.testing.assert_allclose([low[0], high[0]], [0.10, 0.13], rtol=1e-12)


def test_parent_transform_at_the_pose_time_and_a_reset_stack(read):
    asset = read(
        f"""def Xform "P"
        {{
            double3 xformOp:translate.timeSamples = {{ 1: (0, 0, 0), 11: (10, 0, 0) }}
            uniform token[] xformOpOrder = ["xformOp:translate"]
            {mesh()}
            def Mesh "R"
            {{
                {CUBE}
                uniform token[] xformOpOrder = ["!resetXformStack!"]
            }}
        }}""",
        time_code=6,
    )
    assert [s.points[:, 0].min() for s in asset.surfaces] == [5.0, 0.0]


def test_points_only_in_time_samples(read):
    cube = CUBE.replace("points = ", "points.timeSamples = { 7: ").replace("(0,1,1)]", "(0,1,1)] }")
    body = mesh(cube=cube)
    assert read(body).surfaces[0].points.max() == 1.0
    assert read("#usda 1.0\n(startTimeCode = 3)\n" + body).surfaces[0].points.max() == 0.01


def test_hole_faces_are_open(read):
    (surface,) = read(mesh("int[] holeIndices = [1, 2]")).surfaces
    assert len(surface.triangles) == 8
    assert len(boundary_edges(surface.triangles)) == 6
    assert len(surface.face_counts) == 6  # as authored


def test_the_reason_of_a_mesh_that_its_hole_faces_open_names_them(read):
    asset = read(mesh("int[] holeIndices = [1, 2]"))
    assert asset.surfaces[0].hole_faces == 2
    reason = closed_triangles(asset.surfaces[0])[2]
    assert reason.startswith("the surface is open: 6 boundary edges")
    assert "holeIndices of the mesh makes 2 of its faces holes" in reason


def test_concave_face(read):
    (surface,) = read("""def Mesh "M"
    {
        point3f[] points = [(0,0,0), (2,0,0), (2,1,0), (1,1,0), (1,2,0), (0,2,0)]
        int[] faceVertexCounts = [6]
        int[] faceVertexIndices = [0, 1, 2, 3, 4, 5]
    }""").surfaces
    a, b, c = np.moveaxis(surface.points[surface.triangles], 1, 0)
    area = 0.5 * np.cross(b - a, c - a)[:, 2]
    assert area.min() > 0
    assert area.sum() == pytest.approx(3.0)


FACES = ["(0,0,-1)", "(0,0,1)", "(0,-1,0)", "(0,1,0)", "(1,0,0)", "(-1,0,0)"]
FLAT = f"[{', '.join(FACES)}]"
CORNERS = "[" + ", ".join(v for v in FACES for _ in range(4)) + "]"


@pytest.mark.parametrize("scale", ["1, 2, 3", "-1, 2, 3"])
def test_face_varying_normals_turn_with_the_mesh(read, scale):
    body = mesh(
        f'normal3f[] normals = {CORNERS} ( interpolation = "faceVarying" )\n{TRANSFORM % scale}'
    )
    (surface,) = read(body).surfaces
    assert surface.normals_interpolation == "faceVarying"
    np.testing.assert_array_equal(surface.normal_points, surface.face_indices)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, rtol=1e-12)
    a, b, c = np.moveaxis(surface.points[surface.triangles], 1, 0)
    facing = np.cross(b - a, c - a)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    for corner in range(3):
        # Rotation in double precision from single precision angles: 1e-7.
        np.testing.assert_allclose(
            surface.normals[surface.triangle_corners[:, corner]], facing, atol=1e-6
        )


def test_indexed_primvar_normals_win_over_normals(read):
    body = mesh(f"""
        normal3f[] normals = [(1,0,0)] ( interpolation = "constant" )
        normal3f[] primvars:normals = {FLAT} ( interpolation = "uniform" )
        int[] primvars:normals:indices = [0, 1, 2, 3, 5, 4]
    """)
    (surface,) = read(body).surfaces
    assert surface.normals_interpolation == "uniform"
    np.testing.assert_array_equal(surface.normals[4], [-1, 0, 0])
    np.testing.assert_array_equal(surface.normal_points, [3, 4, 0, 2, 1, 3])


def test_normals_of_the_wrong_number_are_ignored_in_words(read):
    asset = read(mesh('normal3f[] normals = [(0,0,1), (0,1,0)] ( interpolation = "vertex" )'))
    assert asset.surfaces[0].normals is None
    assert asset.surfaces[0].normals_interpolation == ""
    assert asset.facts.notes == (
        "</M>: its 2 normals do not match the elements of its 'vertex' interpolation: ignored",
    )


def test_normals_without_direction_take_that_of_the_faces(read):
    eight = ", ".join(["(0, 0, 0)", "(nan, 0, 0)"] + ["(0, 0, 2)"] * 6)
    asset = read(mesh(f'normal3f[] normals = [{eight}] ( interpolation = "vertex" )'))
    normals = asset.surfaces[0].normals
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-12)
    assert np.all(normals[0] < 0)
    assert "2 of its 8 normals have no direction" in asset.facts.notes[0]


@pytest.mark.parametrize(
    ("interpolation", "count", "indices"),
    [
        ("constant", 1, ""),
        ("uniform", 6, ""),
        ("vertex", 8, ""),
        ("varying", 8, ""),
        ("faceVarying", 24, ""),
        ("uniform", 2, "int[] primvars:displayColor:indices = [0, 1, 0, 1, 0, 1]"),
    ],
)
def test_display_color(read, interpolation, count, indices):
    values = np.stack([np.arange(count)] * 3, axis=1) / 32.0  # exact in single precision
    text = ", ".join(str(tuple(v)) for v in values.tolist())
    (surface,) = read(
        mesh(
            f"color3f[] primvars:displayColor = [{text}]"
            f' ( interpolation = "{interpolation}" )\n{indices}'
        )
    ).surfaces
    face = np.repeat(np.arange(6), 2)[:, None].repeat(3, axis=1)
    expected = {
        "constant": np.zeros((12, 3)),
        "uniform": face % 2 if indices else face,
        "vertex": surface.triangles,
        "varying": surface.triangles,
        "faceVarying": surface.triangle_corners,
    }[interpolation]
    np.testing.assert_array_equal(surface.triangle_colors[:, :, 0], expected / 32.0)


def test_inherited_display_color(read):
    (surface,) = read(
        'def Xform "P"\n{\ncolor3f[] primvars:displayColor = [(0.5, 0.25, 0)]\n' + mesh() + "\n}"
    ).surfaces
    np.testing.assert_array_equal(surface.triangle_colors[0, 0], [0.5, 0.25, 0])


@pytest.mark.parametrize(
    ("authored", "message"),
    [
        (
            '[(1,0,0), (0,1,0)] ( interpolation = "vertex" )',
            "has 2 values, which does not match the number of elements of its 'vertex' "
            "interpolation: ignored",
        ),
        ("[(nan, 0, 0)]", "has values that are not finite: ignored"),
        (
            '[(1,0,0)] ( interpolation = "uniform" )\n'
            "int[] primvars:displayColor:indices = [0, 0, 0, 0, 0, 7]",
            "has indices outside its values: ignored",
        ),
    ],
)
def test_display_color_that_does_not_fit_is_ignored_in_words(read, authored, message, capfd):
    asset = read(mesh(f"color3f[] primvars:displayColor = {authored}"))
    assert asset.surfaces[0].triangle_colors is None
    assert asset.facts.notes == (f"</M>: primvar displayColor {message}",)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("(1,1,1)", "(nan,1,1)", "</M>: 1 of 8 points are not finite (NaN or infinity)"),
        (
            "3,0,4,7]",
            "3,0,4,8]",
            "</M>: 1 faceVertexIndices do not refer to any of its 8 points; the first is 8",
        ),
        (
            "3,0,4,7]",
            "3,0,-4,7]",
            "</M>: 1 faceVertexIndices do not refer to any of its 8 points; the first is -4",
        ),
        (
            "[4, 4, 4, 4, 4, 4]",
            "[4, 4, 4, 4, 4]",
            "</M>: faceVertexCounts add up to 20 corners, but there are 24 faceVertexIndices",
        ),
        ("[4, 4, 4, 4, 4, 4]", "[4, 4, 4, 4, 12, -4]", "</M>: a face has -4 corners"),
    ],
)
def test_broken_meshes_are_refused_with_path_and_numbers(read, old, new, message):
    assert old in CUBE
    with pytest.raises(InputError) as error:
        read(mesh(cube=CUBE.replace(old, new)))
    assert error.value.message.endswith(message)
    assert "asset.usda" in error.value.message
    assert "--prim" in error.value.hint


def test_a_mesh_of_lines_is_left_alone(read):
    asset = read("""def Cube "C" {}
    def Mesh "M"
    {
        point3f[] points = [(0,0,0), (2,0,0)]
        int[] faceVertexCounts = [2, 0]
        int[] faceVertexIndices = [0, 1]
    }""")
    assert asset.skipped == (("/M", "has no face with at least three corners"),)
