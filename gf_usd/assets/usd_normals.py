"""Authored normals of a mesh, in the world, each with the point that carries it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_place import Placement
from gf_usd.assets.usd_primvars import Corners

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Normals:
    """Unit normals (K, 3) with their points (K,), or nothing."""

    values: Floats | None = None
    interpolation: str = ""
    carriers: Ints | None = None


def read_normals(
    prim: Usd.Prim,
    place: Placement,
    points: Floats,
    where: Corners,
    counts: Ints,
    indices: Ints,
    time: Usd.TimeCode,
    notes: Notes,
) -> Normals:
    """Authored normals; none (and a note) where their number fits no interpolation.

    `primvars:normals` wins over `normals`, as USD says.  A normal without direction becomes that
    of the faces around its point.
    """
    authored = _authored(prim, time)
    if authored is None:
        return Normals()
    values, interpolation = authored
    starts = np.minimum(np.cumsum(counts) - counts, len(indices) - 1)
    carriers = {
        "vertex": np.arange(len(points)),
        "varying": np.arange(len(points)),
        "faceVarying": indices,
        "uniform": indices[starts],
    }.get(interpolation)
    if carriers is None or len(carriers) != len(values):
        notes.add(
            f"its {len(values)} normals are not one for each '{interpolation}' element: ignored",
            str(prim.GetPath()),
        )
        return Normals()
    finite = np.all(np.isfinite(values), axis=1, keepdims=True)
    world = place.normals(np.where(finite, values, 0.0), carriers)
    length = np.asarray(np.linalg.norm(world, axis=1))
    lost = np.asarray(length == 0.0)
    if lost.any():
        notes.add(
            f"{int(lost.sum())} of its {len(values)} normals have no direction: "
            "that of the faces around them is used",
            str(prim.GetPath()),
        )
        world[lost] = _of_the_faces(points, where.triangles)[carriers[lost]]
        length = np.asarray(np.linalg.norm(world, axis=1))
    unit = world / np.where(length > 0.0, length, 1.0)[:, None]
    return Normals(values=unit, interpolation=interpolation, carriers=carriers)


def _authored(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Floats, str] | None:
    """Values (K, 3) in the prim's space and their interpolation."""
    if not prim.IsA(UsdGeom.PointBased):
        return None
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        values, interpolation = primvar.ComputeFlattened(time), primvar.GetInterpolation()
    else:
        base = UsdGeom.PointBased(prim)
        values, interpolation = base.GetNormalsAttr().Get(time), base.GetNormalsInterpolation()
    array = np.asarray([] if values is None else values)
    if array.ndim != 2 or array.shape[1] != 3 or not np.issubdtype(array.dtype, np.number):
        return None
    return array.astype(np.float64), str(interpolation)


def _of_the_faces(points: Floats, triangles: Ints) -> Floats:
    """(V, 3) sum of the area vectors of the triangles at each point."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    area = np.cross(b - a, c - a)
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, triangles[:, corner], area)
    # A point without area keeps some direction rather than none.
    total[~np.any(total, axis=1)] = (0.0, 0.0, 1.0)
    return total
