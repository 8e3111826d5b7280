"""Rigs as UsdSkel prims: a skeleton with its animation, and meshes that are bound to it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import reduce

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.delivery.joints import STEPS
from gf_usd.delivery.rig import Rig
from gf_usd.delivery.transforms import hierarchy
from gf_usd.layers.stage import vectors
from gf_usd.readers.pictures.extent import has_animated_visibility
from gf_usd.readers.usd_physics.motion import transform_varies

NAME = "Skeleton"
ROOT = "Root"
PURPOSES = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
ALIKE = 1e-4  # relative difference of squared scales that is none
FIT = 1e-6  # of the size: source points map to the first frame within single precision


def bind_meshes(
    stage: Usd.Stage,
    rigs: Sequence[Rig],
    names: Sequence[str],
    triangles: Sequence[Ints],
    time_codes: Sequence[float],
    unit: float,
    root: Usd.Prim,
) -> None:
    """Author rigs at the stage's edit target, over meshes that hold no motion any more.

    rigs : of bodies below `root`, the prim to become their SkelRoot: see `skel_roots`.
    names, triangles : prim paths of the meshes, by the numbers that bodies have, and (T, 3) into
    their points, for prims that are implicit shapes.  unit : [m] per stage unit.

    Raises InputError where no prim above a mesh can be a SkelRoot.
    """
    _make_skel_root(root)
    for number, rig in enumerate(rigs):
        name = NAME if number == 0 else f"{NAME}{number}"
        skeleton = _skeleton(root, name, rig, time_codes, unit)
        for mesh in rig.body.meshes:
            prim = stage.GetPrimAtPath(names[mesh])
            _type_parents(prim)
            if not prim.IsA(UsdGeom.Mesh):
                _make_mesh(prim, triangles[mesh])
            _bind(prim, mesh, rig, skeleton, unit)
    _author_extent(root, rigs, names, time_codes, unit)


def skel_roots(stage: Usd.Stage, bodies: Sequence[Sequence[str]]) -> dict[str, Sdf.Path]:
    """The prim that becomes the SkelRoot of each mesh of bodies below one root prim.

    It is the lowest prim above all meshes of a body that places what is below it, by a transform
    without unequal scales, so that other prims of a stage, such as obstacles, stay outside:
    engines import a SkelRoot as one skinned object.  SkelRoots do not nest: one below that of
    another body, or below one of the source, is replaced by that one.
    """
    own = {meshes: _lowest_above(stage, meshes) for meshes in map(tuple, bodies)}
    homes = sorted(set(own.values()))
    return {
        mesh: next(home for home in homes if path.HasPrefix(home))  # those above come first
        for meshes, path in own.items()
        for mesh in meshes
    }


def _lowest_above(stage: Usd.Stage, meshes: Collection[str]) -> Sdf.Path:
    """The SkelRoot of the meshes of one body alone."""
    paths = [Sdf.Path(mesh) for mesh in meshes]
    common = paths[0] if len(paths) == 1 else reduce(Sdf.Path.GetCommonPrefix, paths)
    above = [stage.GetPrimAtPath(path) for path in common.GetPrefixes()]
    for prim in above:
        if prim.IsA(UsdSkel.Root):
            return prim.GetPath()
    fit = [prim for prim in above if prim.IsA(UsdGeom.Xform)]
    fit = [prim for prim in fit if _is_similarity(prim)] or fit[:1]
    return (fit[-1] if fit else above[0]).GetPath()


def _is_similarity(prim: Usd.Prim) -> bool:
    """Whether a prim is moved, turned and scaled alike along all axes.

    A skeleton below it undoes that (`_cancel`).  The inverse of another transform has a shear,
    which programs with a position, a rotation and scales for each object, such as Blender, drop.
    """
    world = UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime())
    A = np.array(world)[:3, :3]
    gram = A @ A.T
    scale = np.trace(gram) / 3.0
    return bool(np.abs(gram - scale * np.eye(3)).max() <= ALIKE * scale)


def _make_skel_root(root: Usd.Prim) -> None:
    if root.IsA(UsdGeom.Gprim):
        raise InputError(
            f"<{root.GetPath()}> is a {root.GetTypeName()} without a parent, but joints need a "
            f"prim above the mesh",
            "put the mesh under an Xform and bake that",
        )
    if root.GetTypeName() != "SkelRoot":
        # not at the edit target, which may be a variant: text layers have no types there
        Sdf.CreatePrimInLayer(root.GetStage().GetRootLayer(), root.GetPath()).typeName = "SkelRoot"
    for prim in Usd.PrimRange(root):
        if prim != root and prim.IsA(UsdSkel.Root):
            prim.SetTypeName("Xform")  # they do not nest


def _type_parents(prim: Usd.Prim) -> None:
    """Make prims above a mesh that have no type scopes, which do not transform it either.

    UsdSkel looks for meshes only below imageable prims, and not below other meshes and shapes.

    Raises InputError for a mesh below one of these.
    """
    above = prim
    while (above := above.GetParent()) and not above.IsPseudoRoot():
        if above.IsA(UsdGeom.Gprim):
            raise InputError(
                f"<{prim.GetPath()}> is below <{above.GetPath()}>, a {above.GetTypeName()}, where"
                " UsdSkel poses nothing",
                "deliver to .glb, or put the two next to each other in the asset and bake that",
            )
        if not above.GetTypeName():
            layer = above.GetStage().GetRootLayer()  # as in `_make_skel_root`
            Sdf.CreatePrimInLayer(layer, above.GetPath()).typeName = "Scope"


def _skeleton(
    root: Usd.Prim, name: str, rig: Rig, time_codes: Sequence[float], unit: float
) -> UsdSkel.Skeleton:
    stage = root.GetStage()
    path = root.GetPath().AppendChild(name)
    skeleton = UsdSkel.Skeleton.Define(stage, path)
    _cancel(skeleton, root, time_codes)
    joints = hierarchy(rig)
    names = [ROOT, *(f"{ROOT}/Joint{j}" for j in range(len(joints) - 1))]
    skeleton.CreateJointsAttr(names)
    skeleton.CreateBindTransformsAttr(_shifts(joints.bind / unit))
    skeleton.CreateRestTransformsAttr(_shifts(joints.bind_local / unit))
    animation = UsdSkel.Animation.Define(stage, path.AppendChild("Animation"))
    animation.CreateJointsAttr(names)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0, 1.0, 1.0)] * len(names)))
    turn, move = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    quaternions = joints.rotations.astype(np.float32)
    for frame, code in enumerate(time_codes):
        turn.Set(Vt.QuatfArray.FromNumpy(np.ascontiguousarray(quaternions[frame])), code)
        move.Set(vectors(joints.translations[frame] / unit), code)
    if rig.blend_shapes:
        assert rig.keys is not None
        animation.CreateBlendShapesAttr([f"shape{k}" for k in range(rig.blend_shapes)])
        weights = animation.CreateBlendShapeWeightsAttr()
        for frame, code in enumerate(time_codes):
            weights.Set(Vt.FloatArray.FromNumpy(rig.keys[frame].astype(np.float32)), code)
    api = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    api.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    return skeleton


def _cancel(skeleton: UsdSkel.Skeleton, root: Usd.Prim, time_codes: Sequence[float]) -> None:
    """Undo the transform of the root prim: joints are given in the world."""
    image = UsdGeom.Imageable(root)
    worlds = [image.ComputeLocalToWorldTransform(code) for code in time_codes]
    if all(world == Gf.Matrix4d(1.0) for world in worlds):
        return
    op = skeleton.AddTransformOp()
    if all(world == worlds[0] for world in worlds):
        op.Set(worlds[0].GetInverse())
        return
    for code, world in zip(time_codes, worlds):
        op.Set(world.GetInverse(), code)


def _make_mesh(prim: Usd.Prim, triangles: Ints) -> None:
    """Make an implicit shape the mesh that the bake made of it."""
    prim.SetTypeName("Mesh")
    mesh = UsdGeom.Mesh(prim)
    mesh.CreateFaceVertexCountsAttr([3] * len(triangles))
    mesh.CreateFaceVertexIndicesAttr(np.asarray(triangles).reshape(-1).tolist())
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePointsAttr()


def _bind(prim: Usd.Prim, mesh: int, rig: Rig, skeleton: UsdSkel.Skeleton, unit: float) -> None:
    rest = rig.body.rest[rig.body.points_of(mesh)] / unit
    matrix = _placed(prim, rest)
    _forget(prim)
    api = UsdSkel.BindingAPI.Apply(prim)
    api.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    api.CreateGeomBindTransformAttr(Gf.Matrix4d(matrix.tolist()))
    if rig.skinning is None:
        indices = api.CreateJointIndicesPrimvar(True, 1)
        weights = api.CreateJointWeightsPrimvar(True, 1)
        indices.Set(Vt.IntArray([0]))
        weights.Set(Vt.FloatArray([1.0]))
    else:
        part = rig.body.points_of(mesh)
        width = rig.skinning.joints.shape[1]
        joints = np.where(rig.skinning.weights > 0, rig.skinning.joints + 1, 0)[part]
        indices = api.CreateJointIndicesPrimvar(False, width)
        weights = api.CreateJointWeightsPrimvar(False, width)
        indices.Set(Vt.IntArray.FromNumpy(joints.reshape(-1).astype(np.int32)))
        share = rig.skinning.weights[part] / STEPS
        weights.Set(Vt.FloatArray.FromNumpy(share.reshape(-1).astype(np.float32)))
    if rig.blend_shapes:
        _shape_prims(api, prim, mesh, rig, matrix, unit)


def _forget(prim: Usd.Prim) -> None:
    """Block the joints and blend shapes of the source."""
    for name in ("skel:joints", "skel:blendShapes", "primvars:skel:skinningMethod"):
        attribute = prim.GetAttribute(name)
        if attribute.HasAuthoredValue():
            attribute.Block()
    for name in ("skel:blendShapeTargets", "skel:animationSource"):
        relation = prim.GetRelationship(name)
        if relation and relation.HasAuthoredTargets():
            relation.SetTargets([])


def _placed(prim: Usd.Prim, rest: Floats) -> Floats:
    """(4, 4) for row vectors from the mesh's points to rest (V, 3), world.

    The source's own points are kept if one matrix maps all of them there; else they are replaced,
    with their normals and box, by the points of the first frame as the prim's transform places
    them.
    """
    mesh = UsdGeom.Mesh(prim)
    own = mesh.GetPointsAttr()
    values = None if own.ValueMightBeTimeVarying() else own.Get()
    size = float(np.ptp(rest, axis=0).max())
    if values is not None and len(values) == len(rest):
        given = np.asarray(values, np.float64)
        center = given.mean(axis=0)
        spread = np.column_stack([given - center, np.ones(len(given))])
        solved, *_ = np.linalg.lstsq(spread, rest, rcond=1e-9)
        if np.abs(spread @ solved - rest).max() <= FIT * max(size, float(np.abs(rest).max())):
            matrix = np.eye(4)
            matrix[:3, :3] = solved[:3]
            matrix[3, :3] = solved[3] - center @ solved[:3]
            if np.linalg.matrix_rank(matrix) == 4:
                return matrix
    matrix = np.array(UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(Usd.TimeCode(0.0)))
    local = (rest - matrix[3, :3]) @ np.linalg.inv(matrix[:3, :3])
    extent = mesh.GetExtentAttr()
    for attribute in (own, mesh.GetNormalsAttr(), mesh.GetVelocitiesAttr(), extent):
        if attribute.GetNumTimeSamples() or attribute == own:
            attribute.Block()
    own.Set(vectors(local))
    extent.Set(vectors(np.array([local.min(axis=0), local.max(axis=0)])))
    return matrix


def _shape_prims(
    api: UsdSkel.BindingAPI, prim: Usd.Prim, mesh: int, rig: Rig, matrix: Floats, unit: float
) -> None:
    assert rig.shapes is not None
    back = np.linalg.inv(matrix[:3, :3])
    part = rig.body.points_of(mesh)
    names, targets = [f"shape{k}" for k in range(rig.blend_shapes)], []
    for name, shape in zip(names, rig.shapes):
        path = prim.GetPath().AppendChild(name)
        made = UsdSkel.BlendShape.Define(prim.GetStage(), path)
        made.CreateOffsetsAttr(vectors(shape[part] / unit @ back))
        targets.append(path)
    api.CreateBlendShapesAttr(names)
    api.CreateBlendShapeTargetsRel().SetTargets(targets)


def _author_extent(
    root: Usd.Prim,
    rigs: Sequence[Rig],
    names: Sequence[str],
    time_codes: Sequence[float],
    unit: float,
) -> None:
    """The box of all that is below the root prim in each frame, in the space of the root prim.

    The bounds of a SkelRoot include those of all that is below it.
    """
    moving = {names[mesh] for rig in rigs for mesh in rig.body.meshes}
    others = [
        prim
        for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies())
        if (prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdGeom.PointInstancer))
        and str(prim.GetPath()) not in moving
    ]
    changing = [prim for prim in others if _changes(prim)]
    boxes = UsdGeom.BBoxCache(Usd.TimeCode(time_codes[0]), PURPOSES)
    static = _corners(boxes, [prim for prim in others if prim not in changing])
    extent = UsdGeom.Boundable(root).CreateExtentAttr()
    for frame, code in enumerate(time_codes):
        boxes.SetTime(Usd.TimeCode(code))
        boxes.Clear()  # it keeps the boxes of points that change where no extent is authored
        world = UsdGeom.Imageable(root).ComputeLocalToWorldTransform(code)
        back = np.array(world.GetInverse())
        baked = np.concatenate([rig.body.frames[frame] for rig in rigs]) / unit
        points = np.concatenate([baked, static, _corners(boxes, changing)])
        local = points @ back[:3, :3] + back[3, :3]
        extent.Set(vectors(np.array([local.min(axis=0), local.max(axis=0)])), code)


def _changes(prim: Usd.Prim) -> bool:
    """Whether the box of a prim and of all below it may change over time."""
    if transform_varies(prim) or has_animated_visibility(prim):
        return True
    for one in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()):
        if one.IsA(UsdGeom.PointInstancer):  # its prototypes may be anywhere
            return True
        if any(attribute.ValueMightBeTimeVarying() for attribute in one.GetAttributes()):
            return True
    return False


def _corners(boxes: UsdGeom.BBoxCache, prims: Sequence[Usd.Prim]) -> Floats:
    """(n, 3) corners of the boxes of prims in the world."""
    found = [boxes.ComputeWorldBound(prim).ComputeAlignedRange() for prim in prims]
    corners = [box.GetCorner(k) for box in found if not box.IsEmpty() for k in range(8)]
    return np.reshape(np.array(corners, float), (-1, 3))


def _shifts(rows: Floats) -> Vt.Matrix4dArray:
    return Vt.Matrix4dArray(
        [Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*row)) for row in rows.tolist()]
    )
