"""Meshes posed by a skeleton, against UsdSkel's own BakeSkinning."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdSkel

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.readers import read_asset

# A bar of two cells along x; the second joint, at x = 1, turns about z and moves.
BAR = """
    point3f[] points = [(0,0,0), (0,1,0), (0,1,1), (0,0,1), (1,0,0), (1,1,0), (1,1,1), (1,0,1),
                        (2,0,0), (2,1,0), (2,1,1), (2,0,1)]
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [3,2,1,0, 8,9,10,11, 0,1,5,4, 1,2,6,5, 2,3,7,6, 3,0,4,7,
                               4,5,9,8, 5,6,10,9, 6,7,11,10, 7,4,8,11]
"""
NORMALS = {
    "faceVarying": [
        v
        for v in [(-1, 0, 0), (1, 0, 0), *[(0, 0, -1), (0, 1, 0), (0, 0, 1), (0, -1, 0)] * 2]
        for _ in range(4)
    ],
    "vertex": [
        (0, y - 0.5, z - 0.5) for _ in range(3) for y, z in [(0, 0), (1, 0), (1, 1), (0, 1)]
    ],
}
WEIGHTS = """
    int[] primvars:skel:jointIndices = [0,1, 0,1, 0,1, 0,1, 0,1, 0,1, 0,1, 0,1,
                                         0,1, 0,1, 0,1, 0,1] (
        elementSize = 2
        interpolation = "vertex"
    )
    float[] primvars:skel:jointWeights = [1,0, 1,0, 1,0, 1,0, .5,.5, .5,.5, .5,.5, .5,.5,
                                          0,1, 0,1, 0,1, 0,1] (
        elementSize = 2
        interpolation = "vertex"
    )
"""
RIGID = """
    int[] primvars:skel:jointIndices = [1] (
        elementSize = 1
        interpolation = "constant"
    )
    float[] primvars:skel:jointWeights = [1] (
        elementSize = 1
        interpolation = "constant"
    )
"""
BIND = """
    matrix4d primvars:skel:geomBindTransform = ( (1, 0, 0, 0), (0, 2, 0, 0), (0, 0, 1, 0),
                                                 (0, -1, 0, 1) )
"""


def rig(skin, *, normals="faceVarying", on_mesh="", above="", joints="", root="SkelRoot"):
    rows = ", ".join(str(tuple(n)) for n in NORMALS[normals])
    return f"""#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    startTimeCode = 5
)
def {root} "Rig" ( prepend apiSchemas = ["SkelBindingAPI"] )
{{
    double3 xformOp:translate = (0, 0, 7)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    {above}
    def Skeleton "Skel" ( prepend apiSchemas = ["SkelBindingAPI"] )
    {{
        double3 xformOp:translate = (100, 0, 0)
        float xformOp:rotateX = 30
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
        uniform token[] joints = ["A", "A/B"]
        uniform matrix4d[] bindTransforms = [
            ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) ),
            ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, 0, 0, 1) )]
        uniform matrix4d[] restTransforms = [
            ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) ),
            ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, 0, 0, 1) )]
        rel skel:animationSource = </Rig/Anim>
    }}
    def SkelAnimation "Anim"
    {{
        uniform token[] joints = ["A/B"]
        float3[] translations.timeSamples = {{ 0: [(1, 0, 0)], 5: [(1, 0.3, 0)] }}
        quatf[] rotations = [(0.8, 0, 0, 0.6)]
        half3[] scales = [(1, 1.5, 1)]
        uniform token[] blendShapes = ["Fat"]
        float[] blendShapeWeights.timeSamples = {{ 0: [0], 5: [0.5] }}
    }}
    def Xform "Other"
    {{
        double3 xformOp:translate = (-3, 2, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Mesh "Bar" ( prepend apiSchemas = ["SkelBindingAPI"] )
        {{
            {BAR}
            normal3f[] normals = [{rows}] ( interpolation = "{normals}" )
            {skin}
            {on_mesh}
            {joints}
        }}
    }}
}}
"""


BOUND = "rel skel:skeleton = </Rig/Skel>"
CASES = {
    "smooth": rig(WEIGHTS + BIND, on_mesh=BOUND),
    "vertex normals": rig(WEIGHTS + BIND, on_mesh=BOUND, normals="vertex"),
    "rigid": rig(RIGID + BIND, on_mesh=BOUND),
    "inherited": rig(WEIGHTS, above=BOUND),
    "dual quaternion": rig(
        WEIGHTS, on_mesh=BOUND + '\nuniform token primvars:skel:skinningMethod = "dualQuaternion"'
    ),
    "joints in another order": rig(
        WEIGHTS, on_mesh=BOUND, joints='uniform token[] skel:joints = ["A/B", "A"]'
    ),
}


def baked(path: Path) -> Path:
    """The same stage with UsdSkel's points authored on the mesh and no skeleton."""
    stage = Usd.Stage.Open(Usd.Stage.Open(str(path)).Flatten())
    assert UsdSkel.BakeSkinning(stage.Traverse(), Gf.Interval(5, 5))
    result = path.with_name("baked.usda")
    mesh = stage.GetPrimAtPath("/Rig/Other/Bar")
    mesh.RemoveAPI(UsdSkel.BindingAPI)
    for name in ("skel:skeleton", "primvars:skel:jointIndices", "primvars:skel:jointWeights"):
        mesh.RemoveProperty(name)
    stage.GetPrimAtPath("/Rig").RemoveProperty("skel:skeleton")
    stage.GetRootLayer().Export(str(result))
    return result


@pytest.mark.parametrize("case", CASES)
def test_posed_points_and_normals_equal_bake_skinning(write, case):
    path = write(CASES[case])
    (posed,) = read_asset(path).surfaces
    (expected,) = read_asset(baked(path)).surfaces
    assert posed.skinned
    assert not expected.skinned
    # Single precision points about 100 units from the origin.
    np.testing.assert_allclose(posed.points, expected.points, atol=3e-5)
    np.testing.assert_array_equal(posed.triangles, expected.triangles)
    rest = read_asset(write(CASES[case].replace("startTimeCode = 5", "startTimeCode = 0")))
    assert np.abs(posed.points - rest.surfaces[0].points).max() > 0.1
    assert signed_volume(posed.points, posed.triangles) > 0.5
    np.testing.assert_allclose(np.linalg.norm(posed.normals, axis=1), 1.0, rtol=1e-12)
    if case != "dual quaternion":  # BakeSkinning blends normals linearly there as well
        np.testing.assert_allclose(posed.normals, expected.normals, atol=1e-5)


def test_blend_shapes_equal_bake_skinning(write):
    shape = """
        uniform token[] skel:blendShapes = ["Fat"]
        rel skel:blendShapeTargets = </Rig/Other/Bar/Fat>
        def BlendShape "Fat"
        {
            uniform vector3f[] offsets = [(0, 0.5, 0), (0, 0.25, 0.5)]
            uniform int[] pointIndices = [5, 6]
        }
    """
    path = write(rig(WEIGHTS, on_mesh=BOUND, joints=shape))
    (posed,) = read_asset(path).surfaces
    (expected,) = read_asset(baked(path)).surfaces
    np.testing.assert_allclose(posed.points, expected.points, atol=3e-5)
    (plain,) = read_asset(write(rig(WEIGHTS, on_mesh=BOUND))).surfaces
    moved = np.linalg.norm(posed.points - plain.points, axis=1) > 1e-3
    assert np.flatnonzero(moved).tolist() == [5, 6]


def test_instanced_characters_are_posed(write):
    write(CASES["smooth"].replace("upAxis", 'defaultPrim = "Rig"\n    upAxis'), name="rig.usda")
    path = write("""#usda 1.0
    (
        metersPerUnit = 1
        upAxis = "Y"
        startTimeCode = 5
    )
    def "One" (
        instanceable = true
        references = @rig.usda@
    )
    {
    }
    """)
    (instance,) = read_asset(path).surfaces
    assert instance.path == "/One/Other/Bar"
    assert instance.skinned
    (plain,) = read_asset(path.with_name("rig.usda")).surfaces
    np.testing.assert_array_equal(instance.points, plain.points)


ANIMATED = (
    "</Rig/Other/Bar> is animated by its skeleton: the simulation starts from its pose at the"
    " first frame; --flesh keeps the animation, and makes the flesh around the bones soft"
)


def test_the_animation_that_is_replaced_is_said(write):
    assert read_asset(write(CASES["smooth"])).facts.notes == (ANIMATED,)


def test_influences_without_a_skeleton_are_said(write):
    bound = rig(WEIGHTS, on_mesh=BOUND)
    for body, why in (
        (rig(WEIGHTS), "none is bound"),
        (rig(WEIGHTS, on_mesh=BOUND, root="Xform"), "it is not below a SkelRoot"),
        (bound.replace('def Xform "Other"', 'def "Other"'), "</Rig/Other> has no type, and USD"),
        (bound.replace('def Xform "Other"', 'def Material "Other"'), "</Rig/Other> is a Material"),
    ):
        asset = read_asset(write(body))
        assert not asset.surfaces[0].skinned
        assert f"has joint influences but no skeleton poses it ({why}" in asset.facts.notes[0]
        if "Other" not in why:
            assert asset.surfaces[0].points[:, 0].max() == -1.0  # 2 - 3: where it was authored


@pytest.mark.parametrize(("old", "new"), [("[1,0, 1,0, ", "["), ("[0,1, 0,1, ", "[0,9, 0,1, ")])
def test_influences_that_do_not_fit_are_said(write, capfd, old, new):
    asset = read_asset(write(rig(WEIGHTS.replace(old, new), on_mesh=BOUND)))
    assert asset.facts.notes == (
        ANIMATED,
        "</Rig/Other/Bar>: its joint influences do not match its points: it is read without a pose",
    )
    assert not asset.surfaces[0].skinned
    assert asset.surfaces[0].points[:, 0].max() == -1.0  # 2 - 3: where it was authored
    assert capfd.readouterr().err == ""


def test_a_skeleton_without_a_bind_pose_is_said(write):
    asset = read_asset(write(CASES["smooth"].replace("bindTransforms", "unknown")))
    assert asset.facts.notes == (
        ANIMATED,
        "</Rig/Other/Bar>: its skeleton has no bind pose: the identity is assumed",
    )


def test_a_joint_scaled_to_nothing_keeps_its_normals_in_the_bind_pose(write):
    asset = read_asset(write(CASES["smooth"].replace("(1, 1.5, 1)", "(0, 0, 0)")))
    assert np.isfinite(asset.surfaces[0].normals).all()
    assert asset.facts.notes == (
        ANIMATED,
        "</Rig/Other/Bar>: its normals cannot follow its joints and stay in their bind pose",
    )
