"""Authoring of the skeletons of a mesh file as UsdSkel: Skeleton, SkelAnimation and bindings, with
the blend shapes that they animate.

/hero (SkelRoot)
    /hero/Skeleton (Skeleton)
        /hero/Skeleton/Animation (SkelAnimation)
    /hero/body (Mesh, SkelBindingAPI)
        /hero/body/smile (BlendShape)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from gf_usd.core.arrays import Floats
from gf_usd.readers.mesh.data import FileShape, FileSkeleton, FileSkin

FIRST = 1.0  # time code of the first frame
ANIMATION = "Animation"


def write_skeletons(
    stage: Usd.Stage,
    root: Usd.Prim,
    skeletons: Sequence[FileSkeleton],
    fps: float | None,
    identifier: Callable[[str, set[str]], str],
) -> list[UsdSkel.Skeleton]:
    """Define the skeletons under a SkelRoot, and set the time range of the stage.

    identifier : makes a unique prim name from a name of the file and the names in use.
    """
    made: list[UsdSkel.Skeleton] = []
    for one in skeletons:
        taken = {child.GetName() for child in root.GetAllChildren()}
        path = root.GetPath().AppendChild(identifier(one.name, taken))
        skeleton = UsdSkel.Skeleton.Define(stage, path)
        skeleton.AddTransformOp().Set(_matrix(one.matrix))
        joints = _tokens(one, identifier)
        skeleton.CreateJointsAttr(joints)
        skeleton.CreateBindTransformsAttr([_matrix(M) for M in one.bind])
        skeleton.CreateRestTransformsAttr([_matrix(M) for M in one.rest])
        binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        if one.translations is not None:
            animation = UsdSkel.Animation.Define(stage, path.AppendChild(ANIMATION))
            animation.CreateJointsAttr(joints)
            _write_motion(animation, one)
            binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
        made.append(skeleton)
    frames = [len(one.translations) for one in skeletons if one.translations is not None]
    if frames and fps is not None:
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(FIRST)
        stage.SetEndTimeCode(FIRST + max(frames) - 1)
    return made


def bind_to_skeleton(mesh: UsdGeom.Mesh, skin: FileSkin, skeleton: UsdSkel.Skeleton) -> None:
    """Author the SkelBindingAPI of a mesh."""
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateGeomBindTransformAttr(_matrix(skin.matrix))
    width = skin.joints.shape[1]
    joints = np.ascontiguousarray(skin.joints.ravel(), np.int32)
    binding.CreateJointIndicesPrimvar(False, width).Set(Vt.IntArray.FromNumpy(joints))
    weights = np.ascontiguousarray(skin.weights.ravel(), np.float32)
    binding.CreateJointWeightsPrimvar(False, width).Set(Vt.FloatArray.FromNumpy(weights))


def write_shapes(
    mesh: UsdGeom.Mesh,
    shapes: Sequence[FileShape],
    weights: dict[str, Floats],
    identifier: Callable[[str, set[str]], str],
) -> None:
    """Define the blend shapes of a mesh, and add the weights (F,) of each under its name, which is
    unique in the animation.

    identifier : as in `write_skeletons`.
    """
    names, targets = [], []
    for one in shapes:
        taken = weights.keys() | {child.GetName() for child in mesh.GetPrim().GetAllChildren()}
        name = identifier(one.name, taken)
        path = mesh.GetPath().AppendChild(name)
        shape = UsdSkel.BlendShape.Define(mesh.GetPrim().GetStage(), path)
        moved = one.offsets.any(1)
        if one.normal_offsets is not None:
            moved |= one.normal_offsets.any(1)
        rows = np.flatnonzero(moved)
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(rows.astype(np.int32)))
        shape.CreateOffsetsAttr(_vectors(one.offsets[rows]))
        if one.normal_offsets is not None:
            shape.CreateNormalOffsetsAttr(_vectors(one.normal_offsets[rows]))
        weights[name] = one.weights
        names.append(name)
        targets.append(path)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateBlendShapesAttr(names)
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)


def write_weights(skeleton: UsdSkel.Skeleton, weights: Mapping[str, Floats]) -> None:
    """Add the weights (F,) of blend shapes, by name, to the animation of a skeleton."""
    path = skeleton.GetPath().AppendChild(ANIMATION)
    animation = UsdSkel.Animation.Get(skeleton.GetPrim().GetStage(), path)
    animation.CreateBlendShapesAttr(list(weights))
    attribute = animation.CreateBlendShapeWeightsAttr()
    for frame, values in enumerate(np.stack(list(weights.values()), 1).astype(np.float32)):
        attribute.Set(Vt.FloatArray.FromNumpy(values), FIRST + frame)


def _tokens(one: FileSkeleton, identifier: Callable[[str, set[str]], str]) -> list[str]:
    """The joint paths of UsdSkel."""
    out: list[str] = []
    below: dict[int, set[str]] = {}
    for name, parent in zip(one.joints, one.parents.tolist()):
        taken = below.setdefault(parent, set())
        last = identifier(name, taken)
        taken.add(last)
        out.append(f"{out[parent]}/{last}" if parent >= 0 else last)
    return out


def _write_motion(animation: UsdSkel.Animation, one: FileSkeleton) -> None:
    assert one.translations is not None
    assert one.rotations is not None
    assert one.scales is not None
    moves, turns, scales = (
        animation.CreateTranslationsAttr(),
        animation.CreateRotationsAttr(),
        animation.CreateScalesAttr(),
    )
    for frame in range(len(one.translations)):
        code = FIRST + frame
        moves.Set(_vectors(one.translations[frame]), code)
        turns.Set(Vt.QuatfArray([Gf.Quatf(*q) for q in one.rotations[frame].tolist()]), code)
        scales.Set(Vt.Vec3hArray([Gf.Vec3h(*s) for s in one.scales[frame].tolist()]), code)


def _vectors(values: Floats) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def _matrix(rows: Floats) -> Gf.Matrix4d:
    return Gf.Matrix4d(*np.asarray(rows, float).ravel().tolist())
