"""A skinned mesh that is divided keeps its joint weights and blend shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from gf_usd.readers.isolated import read_untrusted
from gf_usd.readers.mesh.divide.cages import cage_of, refine_until
from gf_usd.readers.mesh.divide.faces import divide_faces, long_faces

BOX = np.array([[x, y, z] for z in (0, 1) for y in (0, 1, 2) for x in (0, 1)], float)
FACES = np.array([
    *(0, 2, 3, 1), *(2, 4, 5, 3), *(6, 7, 9, 8), *(8, 9, 11, 10), *(0, 1, 7, 6), *(4, 10, 11, 5),
    *(0, 6, 8, 2), *(2, 8, 10, 4), *(1, 3, 9, 7), *(3, 5, 11, 9),
])  # fmt: skip
COUNTS = np.full(10, 4)
LONGEST = 0.4
WEIGHTS = np.stack([1.0 - 0.5 * BOX[:, 1], 0.5 * BOX[:, 1]], 1)
BULGE = {3: (0.0, 0.0, 0.5), 9: (0.25, 0.0, 0.0)}
TURN = Gf.Quatf(Gf.Rotation(Gf.Vec3d(0, 0, 1), 30.0).GetQuat())


def stage_of(path: Path, scheme: str) -> Usd.Stage:
    """A box of two by one by one with a bone in each half, bent by 30 degrees, and a bulge."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetStartTimeCode(1)
    root = UsdSkel.Root.Define(stage, "/Root")
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, "/Root/Skeleton")
    joints = ["Low", "Low/High"]
    high = Gf.Matrix4d().SetTranslate(Gf.Vec3d(0.5, 1.0, 0.5))
    skeleton.CreateJointsAttr(joints)
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1.0), high])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1.0), high])
    motion = UsdSkel.Animation.Define(stage, "/Root/Motion")
    motion.CreateJointsAttr(joints)
    motion.CreateTranslationsAttr([Gf.Vec3f(0), Gf.Vec3f(0.5, 1.0, 0.5)])
    motion.CreateRotationsAttr([Gf.Quatf(1.0), TURN])
    motion.CreateScalesAttr([Gf.Vec3h(1), Gf.Vec3h(1)])
    motion.CreateBlendShapesAttr(["Bulge"])
    motion.CreateBlendShapeWeightsAttr([1.0])
    mesh = UsdGeom.Mesh.Define(stage, "/Root/Box")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(BOX.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(COUNTS.tolist())
    mesh.CreateFaceVertexIndicesAttr(FACES.tolist())
    mesh.CreateSubdivisionSchemeAttr(scheme)
    skin = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    skin.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    bound = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    bound.CreateAnimationSourceRel().SetTargets([motion.GetPath()])
    skin.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * len(BOX))
    skin.CreateJointWeightsPrimvar(False, 2).Set(WEIGHTS.astype(np.float32).ravel().tolist())
    skin.CreateBlendShapesAttr(["Bulge"])
    shape = UsdSkel.BlendShape.Define(stage, "/Root/Box/Bulge")
    shape.CreatePointIndicesAttr(list(BULGE))
    shape.CreateOffsetsAttr([Gf.Vec3f(*d) for d in BULGE.values()])
    between = shape.CreateInbetween("half")
    between.SetWeight(0.5)
    between.SetOffsets([Gf.Vec3f(0, 0, 0.1), Gf.Vec3f(0, 0, 0.2)])
    skin.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    stage.GetRootLayer().Save()
    return stage


def made_of(stage: Usd.Stage, posed):
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Box"))
    if cage := cage_of(mesh, COUNTS, FACES, len(BOX)):
        return refine_until(
            cage, posed, lambda p, c, i: not long_faces(p, c, i, LONGEST).any(), 10**6
        )
    return divide_faces(posed, COUNTS, FACES, LONGEST)


@pytest.mark.parametrize("scheme", ["none", "catmullClark"])
def test_weights_and_shapes_are_interpolated(tmp_path: Path, scheme: str):
    path = tmp_path / "box.usda"
    source = stage_of(path, scheme)
    (before,) = read_untrusted(path).asset.surfaces
    assert before.skinned
    read = read_untrusted(path, max_edge_length=LONGEST)
    assert read.converted is not None
    made = made_of(source, before.points)
    stage = Usd.Stage.Open(str(read.converted.layer))
    mesh = stage.GetPrimAtPath("/Root/Box")
    points = made.values(BOX, "points")
    skin = UsdSkel.BindingAPI(mesh)
    joints, weights = skin.GetJointIndicesPrimvar(), skin.GetJointWeightsPrimvar()
    assert joints.GetElementSize() == weights.GetElementSize() == 2
    dense = np.zeros((len(points), 2))
    index = np.array(joints.Get()).reshape(-1, 2)
    np.add.at(
        dense, (np.arange(len(points))[:, None], index), np.array(weights.Get()).reshape(-1, 2)
    )
    np.testing.assert_allclose(dense, made.values(WEIGHTS, "points"), atol=1e-6)
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath("/Root/Box/Bulge"))
    offsets, half = np.zeros((2, len(points), 3))
    offsets[np.array(shape.GetPointIndicesAttr().Get())] = shape.GetOffsetsAttr().Get()
    half[np.array(shape.GetPointIndicesAttr().Get())] = shape.GetInbetween("half").GetOffsets()
    table = np.zeros((len(BOX), 3))
    table[list(BULGE)] = list(BULGE.values())
    np.testing.assert_allclose(offsets, made.values(table, "points"), atol=1e-6)
    table[list(BULGE)] = [(0, 0, 0.1), (0, 0, 0.2)]
    np.testing.assert_allclose(half, made.values(table, "points"), atol=1e-6)
    # posed by linear blend skinning of the new points: x = (1 - w) p + w (c + R (p - c))
    (after,) = read.asset.surfaces
    rest = points + offsets
    center = np.array([0.5, 1.0, 0.5])
    turn = np.array(Gf.Matrix3d(Gf.Rotation(Gf.Vec3d(0, 0, 1), 30.0)))
    w = dense[:, 1:]
    posed = (1.0 - w) * rest + w * (center + (rest - center) @ turn)
    np.testing.assert_allclose(after.points, posed, atol=1e-5)
    assert any("no edge is longer" in note for note in read.asset.facts.notes)


def test_joints_of_all_points_stay(tmp_path: Path):
    path = tmp_path / "box.usda"
    stage = stage_of(path, "none")
    skin = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Root/Box"))
    for name in ("skel:jointIndices", "skel:jointWeights"):
        UsdGeom.PrimvarsAPI(skin.GetPrim()).RemovePrimvar(name)
    skin.CreateJointIndicesPrimvar(True, 1).Set([1])
    skin.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    stage.GetRootLayer().Save()
    read = read_untrusted(path, max_edge_length=LONGEST)
    assert read.converted is not None
    made = Usd.Stage.Open(str(read.converted.layer))
    skin = UsdSkel.BindingAPI(made.GetPrimAtPath("/Root/Box"))
    assert list(skin.GetJointIndicesPrimvar().Get()) == [1]
    assert len(read.asset.surfaces[0].points) > len(BOX)


def few(stage: Usd.Stage) -> None:
    mesh = stage.GetPrimAtPath("/Root/Box")
    mesh.GetAttribute("primvars:skel:jointWeights").Set([1.0] * 6)


def wide(stage: Usd.Stage) -> None:
    UsdSkel.BlendShape(stage.GetPrimAtPath("/Root/Box/Bulge")).GetPointIndicesAttr().Set([3, 12])


def twice(stage: Usd.Stage) -> None:
    Sdf.CopySpec(stage.GetRootLayer(), "/Root/Box", stage.GetRootLayer(), "/Root/Other")
    rel = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Root/Other")).GetBlendShapeTargetsRel()
    rel.SetTargets(["/Root/Box/Bulge"])


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (few, "its joint weights do not fit its points"),
        (wide, "its blend shape </Root/Box/Bulge> does not fit its points"),
        (twice, "its blend shape </Root/Box/Bulge> is that of another mesh, too"),
    ],
)
def test_a_skin_that_does_not_fit_stays(tmp_path: Path, change, why):
    from gf_usd.readers.mesh.divide.skinned import refusal

    stage = stage_of(tmp_path / "box.usda", "none")
    mesh = stage.GetPrimAtPath("/Root/Box")
    assert refusal(mesh, len(BOX)) == ""
    change(stage)
    assert refusal(mesh, len(BOX)) == why
