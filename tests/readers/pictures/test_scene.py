"""What a picture takes from a stage."""

from __future__ import annotations

from pathlib import Path

import arm
import numpy as np
import pytest

from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.readers.pictures.scene import PictureStage, read_scene
from gf_usd.view.render.packing import splat_covariances

Y_0 = 0.28209479177387814


def write(folder: Path, body: str, head: str = 'metersPerUnit = 0.01\n upAxis = "Y"') -> Path:
    path = folder / "stage.usda"
    path.write_text(f"#usda 1.0\n(\n {head}\n)\n{body}\n", encoding="utf-8")
    return path


BOX = """
def Xform "root" {
    double3 xformOp:translate = (0, 100, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "strip" {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4, 4]
        int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4]
        point3f[] points = [(0,0,0), (100,0,0), (200,0,0), (0,100,0), (100,100,0), (200,100,0)]
        color3f[] primvars:displayColor = [(0.1, 0.2, 0.3)]
        def GeomSubset "right" (prepend apiSchemas = ["MaterialBindingAPI"]) {
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1]
            rel material:binding = </root/metal>
        }
    }
    def Material "metal" {
        token outputs:surface.connect = </root/metal/shader.outputs:surface>
        def Shader "shader" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.7, 0.6, 0.5)
            float inputs:roughness = 0.2
            float inputs:metallic = 1
            token outputs:surface
        }
    }
}
"""

# 2 cm wide; its bottom rises by a centimeter per time code, with a sample at each of 100
RISING = """
def Cube "box" {
    double size = 2
    double3 xformOp:translate.timeSamples = { SAMPLES }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    VISIBILITY
}
""".replace("SAMPLES", ", ".join(f"{k}: (0, {k}, 0)" for k in range(1, 101)))


def test_a_mesh_in_meters_with_the_shading_of_each_subset(tmp_path):
    scene = read_scene(write(tmp_path, BOX))
    (mesh,) = scene.meshes
    assert mesh.points.min(axis=0) == pytest.approx((0.0, 1.0, 0.0))
    assert mesh.points.max(axis=0) == pytest.approx((2.0, 2.0, 0.0))
    right = mesh.points[mesh.triangles][:, :, 0].mean(axis=1) > 1.0
    assert np.allclose(mesh.colors[right], (0.7, 0.6, 0.5))
    assert np.allclose(mesh.colors[~right], (0.1, 0.2, 0.3))
    assert np.allclose(mesh.roughness[right], 0.2)
    assert np.allclose(mesh.metallic, right)
    assert scene.up == (0.0, 1.0, 0.0)
    # nothing stands near height 0: the floor is under the body
    assert scene.ground == pytest.approx(1.0)


MOVING = """
def Mesh "fall" {
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points.timeSamples = {
        1: [(0,0,3), (1,0,3), (0,1,4)],
        5: [(0,0,-0.05), (1,0,0), (0,1,1)],
        9: [(0,0,2), (1,0,2), (0,1,3)],
    }
}
"""
Z_UP = 'metersPerUnit = 1\n upAxis = "Z"\n startTimeCode = 1\n endTimeCode = 9'


def test_the_motion_is_known_whole_and_its_floor_is_the_ground(tmp_path):
    stage = PictureStage(write(tmp_path, MOVING, Z_UP))
    motion = stage.motion
    assert motion.time_codes == (1.0, 5.0, 9.0)
    assert motion.bounds is not None
    assert motion.bounds.low == pytest.approx((0.0, 0.0, -0.05))
    assert motion.bounds.high == pytest.approx((1.0, 1.0, 4.0))
    # it dips into the floor by 1 % of its size: the floor is height 0, not the dip
    assert motion.ground == 0.0
    assert motion.up == (0.0, 0.0, 1.0)
    assert stage.scene(9.0).meshes[0].points[:, 2].min() == pytest.approx(2.0)
    assert stage.scene().meshes[0].points[:, 2].min() == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("heights", "ground"),
    [
        ((3.0, -0.9), 0.0),  # comes down on the floor and is pressed through it
        ((3.0, 2.0), 2.0),  # never comes near height 0
        ((-3.0, 1.0), -3.0),  # begins below it: height 0 is no floor
        ((3.0, -1.1), None),  # falls past it by more than its own height
    ],
)
def test_the_floor_of_a_motion(tmp_path, heights, ground):
    samples = ", ".join(
        f"{code}: [(0,0,{z}), (1,0,{z}), (0,1,{z + 1})]" for code, z in zip((1, 2), heights)
    )
    body = MOVING[: MOVING.index("point3f")] + f"point3f[] points.timeSamples = {{ {samples} }}\n}}"
    stage = PictureStage(write(tmp_path, body, Z_UP))
    assert stage.motion.ground == pytest.approx(ground)
    assert not any("simulation" in note for note in stage.scene().notes)


def test_a_picture_of_a_character_has_no_note_for_bakes(tmp_path):
    path = arm.write(tmp_path, arm.arm())
    assert read_scene(path).notes == ()


def test_the_motion_of_a_bake_ends_with_its_stage(tmp_path):
    """Its asset may be animated for longer than was simulated."""
    head = Z_UP.replace("endTimeCode = 9", "endTimeCode = 5")
    baked = head + "\n customLayerData = { dictionary gaussianFlesh = {} }"
    assert PictureStage(write(tmp_path, MOVING, head)).motion.time_codes == (1.0, 5.0, 9.0)
    assert PictureStage(write(tmp_path, MOVING, baked)).motion.time_codes == (1.0, 5.0)


# an obstacle whose top is at height 0, under a square that falls on it; heights in meters
PIT = """
def Mesh "pit" {
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
    point3f[] points = [(-1,-1,0), (1,-1,0), (1,1,0), (0,0,-0.1)]
}
"""


@pytest.mark.parametrize(
    ("floor", "ground"),
    [
        ("", -0.1),  # not baked: height 0, near the lowest point, would cut the pit
        ("double floor = 0.5", 0.5),  # as it was baked
        ("double drag = 0", -0.1),  # baked without a floor
        ("double floor = 0\ndouble3 floor_normal = (0, 0.6, 0.8)", None),
    ],
)
def test_the_floor_is_that_of_the_bake_and_cuts_nothing(tmp_path, floor, ground):
    about = (
        f"""customLayerData = {{ dictionary gaussianFlesh = {{ dictionary looks = {{
        dictionary rubber = {{ dictionary settings = {{
        {floor}
        }} }} }} }} }}"""
        if floor
        else ""
    )
    head = f"{about}\n{Z_UP}"
    falling = MOVING.replace("(0,0,-0.05), (1,0,0)", "(0,0,0.2), (1,0,0.2)")
    stage = PictureStage(write(tmp_path, falling + PIT, head))
    assert stage.motion.ground == (None if ground is None else pytest.approx(ground))
    tilted = "its floor is tilted and is not drawn" in stage.scene().notes
    assert tilted == ("normal" in floor)


def test_a_bake_without_a_floor_has_none_where_something_falls(tmp_path):
    head = f"""customLayerData = {{ dictionary gaussianFlesh = {{ dictionary looks = {{
        dictionary rubber = {{ dictionary settings = {{ double drag = 0 }} }} }} }} }}
        {Z_UP}"""
    assert PictureStage(write(tmp_path, MOVING, head)).motion.ground is None


@pytest.mark.parametrize(
    ("axis", "turn", "height", "extra", "ground"),
    [
        ("Z", "(0, 0, 0)", -0.5, "", -0.5),
        ("Y", "(90, 0, 0)", -0.5, "", -0.5),
        ("Z", "(20, 0, 0)", -0.5, "", None),
        ("Z", "(180, 0, 0)", -0.5, "", None),  # a ceiling
        ("Z", "(0, 0, 0)", 90.0, "", None),  # above all bodies
        ("Z", "(0, 0, 0)", -0.5, "bool physics:collisionEnabled = false", None),
    ],
)
def test_the_floor_is_a_level_plane_that_bodies_collide_with(
    tmp_path, axis, turn, height, extra, ground
):
    head = f"""customLayerData = {{ dictionary gaussianFlesh = {{ dictionary looks = {{
        dictionary rubber = {{ dictionary settings = {{ double drag = 0 }} }} }} }} }}
        {Z_UP}"""
    plane = f"""
def Plane "ground" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{
    uniform token axis = "{axis}"
    {extra}
    double3 xformOp:translate = (3, 0, {height})
    float3 xformOp:rotateXYZ = {turn}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
}}
"""
    stage = PictureStage(write(tmp_path, MOVING + plane, head))
    assert stage.motion.ground == (None if ground is None else pytest.approx(ground))


def splats(extra: str = "", radiance: str = "", place: str = "") -> str:
    return f"""
def ParticleField3DGaussianSplat "cloud" {{
    {place}
    point3f[] positions = [(1, 0, 0), (0, 2, 0)]
    quatf[] orientations = [(1, 0, 0, 0), (0.7071067811865476, 0, 0, 0.7071067811865476)]
    float3[] scales = [(3, 2, 1), (3, 2, 1)]
    float[] opacities = [0.25, 1]
    {radiance or DC}
    {extra}
}}
"""


DC = """
    uniform int radiance:sphericalHarmonicsDegree = 0
    float3[] radiance:sphericalHarmonicsCoefficients = [(0, 1, -1), (1, 0, 0)]
"""
PLACE = """
    matrix4d xformOp:transform = ((0, 2, 0, 0), (-2, 0, 0, 0), (0, 0, 2, 0), (0, 0, 5, 1))
    uniform token[] xformOpOrder = ["xformOp:transform"]
"""


def test_gaussians_are_placed_scaled_and_turned(tmp_path):
    scene = read_scene(write(tmp_path, splats(place=PLACE)))
    (cloud,) = scene.splats
    # twice as large, a quarter turn about z, 5 up z; a unit is a centimeter
    assert np.allclose(cloud.positions, [(0, 0.02, 0.05), (-0.04, 0, 0.05)])
    sigma = splat_covariances(cloud.axes) / 0.02**2
    assert np.allclose(sigma[0], np.diag([4, 9, 1]), atol=1e-6)
    assert np.allclose(sigma[1], np.diag([9, 4, 1]), atol=1e-6)
    assert np.allclose(cloud.opacities, [0.25, 1.0])
    assert not cloud.lit
    expected = srgb_to_linear(0.5 + Y_0 * np.array([(0, 1, -1), (1, 0, 0)]))
    assert np.allclose(cloud.colors, expected, atol=1e-6)
    assert any("sRGB is assumed" in note for note in scene.notes)


def test_a_color_space_that_is_authored_is_believed(tmp_path):
    body = splats().replace('"cloud" {', '"cloud" (prepend apiSchemas = ["ColorSpaceAPI"]) {')
    body = body.replace(
        "point3f[]", 'uniform token colorSpace:name = "lin_rec709_scene"\npoint3f[]'
    )
    scene = read_scene(write(tmp_path, body))
    assert np.allclose(scene.splats[0].colors[1], (0.5 + Y_0, 0.5, 0.5), atol=1e-6)
    assert not any("color space" in note for note in scene.notes)


def test_gaussians_of_a_bake_are_lit_and_linear(tmp_path):
    ours = "uniform point3f[] gaussianFlesh:restPositions = [(1, 0, 0), (0, 2, 0)]"
    (cloud,) = read_scene(write(tmp_path, splats(extra=ours))).splats
    assert cloud.lit
    assert np.allclose(cloud.colors[1], (0.5 + Y_0, 0.5, 0.5), atol=1e-6)


def test_higher_harmonics_are_kept_in_their_own_space(tmp_path):
    four = ", ".join(["(0, 0, 0), (1, 1, 1), (0, 0, 0), (0, 0, 0)"] * 2)
    radiance = f"""
    uniform int radiance:sphericalHarmonicsDegree = 1
    float3[] radiance:sphericalHarmonicsCoefficients = [{four}]
    """
    (cloud,) = read_scene(write(tmp_path, splats(radiance=radiance, place=PLACE))).splats
    assert cloud.harmonics is not None
    assert cloud.harmonics.coefficients.shape == (2, 4, 3)
    # the placement turns local x to world y
    assert np.allclose(cloud.harmonics.frame @ (0, 1, 0), (1, 0, 0), atol=1e-6)


def test_too_few_coefficients_are_gray_and_said(tmp_path):
    radiance = """
    uniform int radiance:sphericalHarmonicsDegree = 3
    float3[] radiance:sphericalHarmonicsCoefficients = [(1, 1, 1), (1, 1, 1)]
    """
    scene = read_scene(write(tmp_path, splats(radiance=radiance)))
    assert np.allclose(scene.splats[0].colors, 0.5)
    assert any("fewer than 16 for each of 2 Gaussians" in note for note in scene.notes)


def test_gaussians_as_ellipsoids_have_their_axes(tmp_path):
    scene = read_scene(write(tmp_path, splats()), show="ellipsoids")
    assert not scene.splats
    assert np.allclose(np.linalg.norm(scene.ellipsoids[0].axes, axis=1), (0.03, 0.02, 0.01))


POINTS = """
def Points "dots" {
    point3f[] points = [(0,0,0), (10,0,0)]
    float[] widths = [2] (interpolation = "constant")
    color3f[] primvars:displayColor = [(1,0,0), (0,0,1)] (interpolation = "vertex")
}
"""


def test_points_are_balls_of_their_widths(tmp_path):
    (dots,) = read_scene(write(tmp_path, POINTS)).ellipsoids
    assert np.allclose(dots.axes, 0.01 * np.eye(3))
    assert np.allclose(dots.colors, [(1, 0, 0), (0, 0, 1)])


def test_points_without_widths_still_show(tmp_path):
    bare = POINTS.replace('float[] widths = [2] (interpolation = "constant")', "")
    scene = read_scene(write(tmp_path, bare))
    assert np.allclose(scene.ellipsoids[0].axes, 0.0005 * np.eye(3))
    assert any("no usable widths" in note for note in scene.notes)


SWITCH = """
def Xform "root" (
    variants = { string display = "mesh" }
    prepend variantSets = "display"
)
{
    def Mesh "skin" {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0,0,0), (1,0,0), (0,1,0)]
    }
    def Points "dots" {
        point3f[] points = [(0,0,0)]
        float[] widths = [1]
    }
    variantSet "display" = {
        "gaussians" {
            over "skin" {
                token visibility = "invisible"
            }
        }
        "mesh" {
            over "dots" {
                token visibility = "invisible"
            }
        }
        "points" {
            over "skin" {
                token visibility = "invisible"
            }
        }
    }
}
"""


def test_show_switches_the_display_of_a_bake_and_leaves_the_file_alone(tmp_path):
    path = write(tmp_path, SWITCH)
    before = path.read_bytes()
    assert len(read_scene(path).meshes) == 1
    dots = read_scene(path, show="points")
    assert len(dots.ellipsoids) == 1
    assert not dots.meshes
    assert path.read_bytes() == before


def test_gaussians_of_a_bake_are_drawn_next_to_obstacles(tmp_path):
    """As what flows is shown: its own mesh is hidden, the obstacle's is not."""
    ours = "uniform point3f[] gaussianFlesh:restPositions = [(1, 0, 0), (0, 2, 0)]"
    path = write(tmp_path, BOX + splats(extra=ours))
    scene = read_scene(path)
    assert (len(scene.meshes), len(scene.splats)) == (1, 1)
    assert not read_scene(path, show="mesh").splats
    assert not read_scene(path, show="gaussians").meshes


def test_what_is_not_there_is_said(tmp_path):
    path = write(tmp_path, BOX)
    with pytest.raises(InputError, match="no visible gaussians") as caught:
        PictureStage(path, "gaussians")
    assert "it contains mesh" in caught.value.hint
    with pytest.raises(UsageError, match="unknown --show fog"):
        PictureStage(path, "fog")
    with pytest.raises(InputError, match="does not exist"):
        PictureStage(tmp_path / "nothing.usda")
    with pytest.raises(InputError, match="no visible mesh") as caught:
        PictureStage(write(tmp_path, ""))
    assert "nothing to draw" in caught.value.hint


def test_hidden_and_guide_prims_are_not_drawn(tmp_path):
    hidden = BOX.replace('"strip" {', '"strip" {\n token visibility = "invisible"')
    guide = BOX.replace('"strip" {', '"strip" {\n uniform token purpose = "guide"')
    for body in (hidden, guide):
        with pytest.raises(InputError, match="no visible mesh"):
            PictureStage(write(tmp_path, body))


@pytest.mark.parametrize(
    "visibility", ['visibility = "invisible"', 'visibility.timeSamples = { 200: "inherited" }']
)
def test_what_is_never_visible_is_refused_with_the_reason(tmp_path, visibility):
    always = visibility.replace("{", '{ 1: "invisible",')
    body = RISING.replace("VISIBILITY", f"token {always}")
    with pytest.raises(InputError, match="every mesh is invisible") as caught:
        PictureStage(write(tmp_path, body)).scene(2.0)
    assert "make it visible" in caught.value.hint


def test_the_camera_and_the_floor_are_those_of_the_times_at_which_something_is_visible(tmp_path):
    flash = '{ 1: "invisible", 50.5: "inherited", 51.5: "invisible" }'
    body = RISING.replace("VISIBILITY", f"token visibility.timeSamples = {flash}")
    stage = PictureStage(write(tmp_path, body))
    assert stage.motion.bounds is not None
    assert stage.motion.bounds.low[1] == pytest.approx(0.495, abs=0.02)
    assert stage.motion.ground == pytest.approx(0.495, abs=0.02)
    assert stage.scene(1.0).meshes == ()
    assert [mesh.name for mesh in stage.scene(51.0).meshes] == ["/box"]


def test_prototypes_of_an_instancer_are_not_drawn_by_themselves(tmp_path):
    instancer = """
def PointInstancer "many" {
    def Cube "one" {
    }
}
"""
    scene = read_scene(write(tmp_path, BOX + instancer))
    assert [mesh.name for mesh in scene.meshes] == ["/root/strip"]
    assert any("PointInstancer" in note for note in scene.notes)


@pytest.mark.parametrize("kind", ["BasisCurves", "NurbsCurves", "HermiteCurves", "NurbsPatch"])
def test_what_cannot_be_drawn_is_named(write, kind):
    path = write(
        f'def Cube "Head" {{}}\ndef {kind} "Hair" {{}}\n'
        f'def {kind} "Control" {{\n uniform token purpose = "guide"\n}}\n'
        f'def {kind} "Hidden" {{\n token visibility = "invisible"\n}}\n'
    )
    assert read_scene(path).notes == (f"</Hair>: not drawn: {kind}",)


def test_a_variant_of_a_bake_is_drawn_in_place_of_the_selected_one(write):
    path = write("""def Xform "A" (
        variants = { string gaussianFlesh = "rubber" }
        prepend variantSets = "gaussianFlesh"
    ) {
        def Cube "B" {}
        variantSet "gaussianFlesh" = {
            "rubber" {
                over "B" {
                    double size = 2
                }
            }
            "jelly" {
                over "B" {
                    double size = 6
                }
            }
        }
    }""")
    text = path.read_bytes()
    wide = PictureStage(path, variant="jelly").motion.bounds
    assert wide.high[0] == 3.0 * PictureStage(path).motion.bounds.high[0]
    assert path.read_bytes() == text
    with pytest.raises(UsageError, match="has no variant 'jely'") as caught:
        PictureStage(path, variant="jely")
    assert caught.value.hint.startswith("did you mean jelly?")
