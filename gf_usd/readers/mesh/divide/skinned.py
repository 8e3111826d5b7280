"""Joint weights and blend shapes of the new points of a divided mesh.

Both are linear in the points, and are interpolated like them.
"""

from __future__ import annotations

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from gf_usd.core.arrays import Floats, Ints
from gf_usd.readers.mesh.divide.cages import FIRST, RefinedCage
from gf_usd.readers.mesh.divide.faces import POINTS, DividedFaces

BLOCK = 16  # joints whose weights are interpolated at a time
INFLUENCES = 8  # joints per point at most, unless the original points have more
LEAST = 1e-4  # of the sum of a point's weights: smaller ones are dropped
INDICES, WEIGHTS = "skel:jointIndices", "skel:jointWeights"
SKIN = (INDICES, WEIGHTS)


def refusal(prim: Usd.Prim, points: int) -> str:
    """The reason why joint weights or blend shapes cannot be interpolated; "" where they can.

    points : of the mesh.
    """
    joints, weights = (UsdGeom.PrimvarsAPI(prim).GetPrimvar(name) for name in SKIN)
    if _per_point(joints) or _per_point(weights):
        given = [len(one.Get(FIRST) or ()) for one in (joints, weights)]
        size = joints.GetElementSize()
        if not _per_point(joints) or given != [points * size] * 2:
            return "its joint weights do not fit its points"
    shared = _of_others(prim)
    for shape in _shapes(prim):
        if shape.GetPath() in shared:
            return f"its blend shape <{shape.GetPath()}> is that of another mesh, too"
        if shape.GetPrim().IsInstanceProxy():
            return f"its blend shape <{shape.GetPath()}> is part of an instance"
        if _rows(shape, points) is None:
            return f"its blend shape <{shape.GetPath()}> does not fit its points"
    return ""


def author_skin(prim: Usd.Prim, made: DividedFaces | RefinedCage, points: int) -> None:
    """Author joint weights and blend shapes of the new points; points : of the original mesh."""
    joints, weights = (UsdGeom.PrimvarsAPI(prim).GetPrimvar(name) for name in SKIN)
    if _per_point(joints):
        size = joints.GetElementSize()
        index, weight = _divided(
            np.asarray(joints.Get(FIRST), np.int64).reshape(points, size),
            np.asarray(weights.Get(FIRST), float).reshape(points, size),
            made,
        )
        joints.Set(index.astype(np.int32).ravel())
        weights.Set(weight.astype(np.float32).ravel())
        for one in (joints, weights):
            one.SetElementSize(index.shape[1])
    for shape in _shapes(prim):
        _author_shape(shape, made, points)


def _per_point(primvar: UsdGeom.Primvar) -> bool:
    """Whether there are joint weights per point; constant ones (rigid binding) do not change."""
    return primvar.HasAuthoredValue() and primvar.GetInterpolation() != UsdGeom.Tokens.constant


def _divided(
    joints: Ints, weights: Floats, made: DividedFaces | RefinedCage
) -> tuple[Ints, Floats]:
    """(V', k') joints and weights of the new points, from those (V, k) of the original ones."""
    names, column = np.unique(joints, return_inverse=True)
    column = column.reshape(-1)
    rows = np.repeat(np.arange(len(joints)), joints.shape[1])
    most = min(len(names), max(joints.shape[1], INFLUENCES))
    new = len(made.values(np.zeros((len(joints), 1)), POINTS))
    best, kept, total = np.zeros((new, 0), np.int64), np.zeros((new, 0)), np.zeros((new, 1))
    for first in range(0, len(names), BLOCK):
        mine = (column >= first) & (column < first + BLOCK)
        table = np.zeros((len(joints), min(BLOCK, len(names) - first)))
        np.add.at(table, (rows[mine], column[mine] - first), weights.ravel()[mine])
        table = made.values(table, POINTS)
        total += table.sum(1, keepdims=True)
        of = np.broadcast_to(first + np.arange(table.shape[1]), table.shape)
        table, of = np.concatenate([kept, table], 1), np.concatenate([best, of], 1)
        order = np.argsort(-table, axis=1, kind="stable")[:, :most]
        best, kept = np.take_along_axis(of, order, 1), np.take_along_axis(table, order, 1)
    kept[kept < LEAST * total] = 0.0
    left = kept.sum(1, keepdims=True)
    kept *= np.divide(total, left, out=np.zeros_like(left), where=left > 0.0)
    size = max(1, int((kept > 0.0).any(0).sum()))
    return np.where(kept > 0.0, names[best], 0)[:, :size], kept[:, :size]


def _targets(prim: Usd.Prim) -> list[Sdf.Path]:
    return UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().GetTargets()


def _shapes(prim: Usd.Prim) -> list[UsdSkel.BlendShape]:
    found = (UsdSkel.BlendShape(prim.GetStage().GetPrimAtPath(path)) for path in _targets(prim))
    return [shape for shape in found if shape]


def _of_others(prim: Usd.Prim) -> set[Sdf.Path]:
    """The blend shapes of all other meshes; empty where this mesh has none."""
    if not _targets(prim):
        return set()
    meshes = (one for one in prim.GetStage().Traverse() if one.IsA(UsdGeom.Mesh) and one != prim)
    return {path for one in meshes for path in _targets(one)}


def _rows(shape: UsdSkel.BlendShape, points: int) -> Ints | None:
    """(K,) points of the offsets of a blend shape; None: they are invalid for the mesh."""
    offsets = len(shape.GetOffsetsAttr().Get() or ())
    given = shape.GetPointIndicesAttr().Get()
    at = np.arange(offsets) if not given else np.asarray(given, np.int64)
    fits = len(at) == offsets and (len(at) == 0 or (at.min() >= 0 and at.max() < points))
    return at if fits else None


def _author_shape(shape: UsdSkel.BlendShape, made: DividedFaces | RefinedCage, points: int) -> None:
    at = _rows(shape, points)
    if at is None:
        return
    between = shape.GetInbetweens()
    attributes = [shape.GetOffsetsAttr(), *(one.GetAttr() for one in between)]
    normals = [shape.GetNormalOffsetsAttr(), *(one.GetNormalOffsetsAttr() for one in between)]
    tables = {}
    for attribute in (*attributes, *normals):
        values = attribute.Get() if attribute else None
        if values is not None and len(values) == len(at):
            table = np.zeros((points, 3))
            table[at] = np.asarray(values)
            tables[attribute.GetPath()] = made.values(table, POINTS)
    if not tables:
        return
    moved = np.flatnonzero(np.any([np.any(t != 0.0, axis=1) for t in tables.values()], axis=0))
    for path, table in tables.items():
        offsets = Vt.Vec3fArray.FromNumpy(table[moved].astype(np.float32))
        shape.GetPrim().GetStage().GetAttributeAtPath(path).Set(offsets)
    shape.CreatePointIndicesAttr().Set(moved.astype(np.int32))
