"""Regions of an asset by name: a GeomSubset, a mesh, all meshes under a prim, or a weight map.

A weight map is a primvar on points, or the skinning weights of a joint.  Its region consists of
the faces all of whose points have a weight of at least `HALF`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts, first_time_code
from gf_usd.core.errors import InputError, counted, meant, similar
from gf_usd.core.stage import Region
from gf_usd.readers.usd.mesh import has_surface, posed_points, read_surface
from gf_usd.readers.usd.select import PROXIES, named_prim
from gf_usd.readers.usd.stage import SkippedPrim, open_stage, reading
from gf_usd.readers.usd_physics.motion import bare_reading, shape_varies, transform_varies


def read_regions(
    file: Path,
    names: Sequence[str],
    facts: StageFacts,
    *,
    rest: float | None,
    times: Sequence[float],
    option: str = "--pin",
    without: Collection[str] = (),
) -> tuple[Region, ...]:
    """The regions of prim paths, with their motion.

    file : the USD file; facts.path is its name in messages.
    rest : time code of the rest pose; None: the stage's startTimeCode, or 1.
    times : time codes of the frames.
    option : the command-line option, for messages.
    without : prim paths of meshes that are no part of regions above them.

    Raises InputError for a path without a prim, and for a prim without a surface.
    """
    with reading(file):
        stage = open_stage(file)
        first = Usd.TimeCode(first_time_code(facts, rest))
        return tuple(_region(stage, facts, name, first, times, option, without) for name in names)


HALF = 0.5
PAINT, JOINT = "paint:", "joint:"  # prefixes of names of primvars and joints
ON_POINTS = (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)
TYPES = Sdf.ValueTypeNames
WEIGHTS = (
    *(TYPES.Float, TYPES.Double, TYPES.Half),
    *(TYPES.Int, TYPES.Int64, TYPES.UInt, TYPES.UInt64),  # masks; bytes could mean 0 to 255
)


def read_weighted(
    file: Path,
    name: str,
    facts: StageFacts,
    meshes: Sequence[str],
    *,
    rest: float | None,
    times: Sequence[float],
    option: str = "--pin",
) -> tuple[Region, ...]:
    """The regions of a weight map, with their motion; other arguments as of `read_regions`.

    name : "paint:PRIMVAR" or "joint:NAME", with the joint's path or its last element.
    meshes : prim paths.

    Raises InputError where no mesh has that weight map, or no weight reaches HALF.
    """
    label = f"{option} {name}"
    with reading(file):
        stage = open_stage(file)
        first = Usd.TimeCode(first_time_code(facts, rest))
        made: list[Region] = []
        known: list[str] = []  # of all meshes: primvars on points, or joints
        largest = -np.inf
        for path in meshes:
            prim = named_prim(stage, facts.path, path)
            if name.startswith(PAINT):
                weight = _painted(prim, name.removeprefix(PAINT), first)
                known += _paintings(prim)
            else:
                weight, joints = _of_joint(prim, name.removeprefix(JOINT))
                known += joints
            if weight is None:
                continue
            if bad := int((~np.isfinite(weight)).sum()):
                raise InputError(
                    f"{facts.path}: {label}: {counted(bad, 'weight of', 'weights of')} <{path}>"
                    f" {'is' if bad == 1 else 'are'} not finite",
                    "paint finite weights",
                )
            points, triangles = _triangles([prim], facts, first, label)
            if len(weight) != len(points):
                raise InputError(
                    f"{facts.path}: {label}: <{path}> has {len(weight)} weights for"
                    f" {len(points)} points",
                    "paint a weight for each point",
                )
            largest = max(largest, float(weight.max(initial=-np.inf)))
            chosen = triangles[weight[triangles].min(1) >= HALF]
            if not len(chosen):
                continue
            moving = _posed([prim], facts, times)
            if moving is not None:
                moving[0] = points
            used, renumbered = np.unique(chosen, return_inverse=True)
            whole = points[None] if moving is None else moving
            made.append(
                Region(
                    name=name,
                    kind="patch",
                    points=points[used],
                    triangles=renumbered.reshape(-1, 3),
                    path=whole[:, used],
                    body=path,
                )
            )
        if not made and largest == -np.inf:
            every = [named_prim(stage, facts.path, path) for path in meshes]
            raise _without_weights(f"{facts.path}: {label}", name, every, sorted({*known}))
    if not made:
        raise InputError(
            f"{facts.path}: {label}: no face of {counted(len(meshes), 'mesh', 'meshes')} has a"
            f" weight of at least {HALF:g} at each of its points: the largest weight is"
            f" {largest:g}",
            f"paint weights of {HALF:g} or more at all points of some faces, or name another"
            " primvar or joint",
        )
    return tuple(made)


def _without_weights(
    where: str, name: str, meshes: Sequence[Usd.Prim], known: Sequence[str]
) -> InputError:
    """The error where no mesh has a weight map.

    known : primvars on points, or joints, of the meshes.
    """
    kind = PAINT if name.startswith(PAINT) else JOINT
    bare = name.removeprefix(kind).removeprefix("primvars:")
    close = similar(bare, (one.rpartition("/")[2] for one in known))
    count = counted(len(meshes), "mesh has", "meshes have")
    if not bare.strip():
        what = "primvar" if kind == PAINT else "joint"
        listed = f"{what}s{' on points' if kind == PAINT else ''} are {', '.join(known)}"
        none = "such as paint:held" if kind == PAINT else "no mesh has joints"
        return InputError(
            f"{where}: no {what} is named",
            f"give its name after {kind} ({listed if known else none})",
        )
    if kind == JOINT:
        message = f"{count} no weights of a joint {bare}"
        hint = (
            f"joints are {', '.join(known)}"
            if known
            else "no mesh has joints: name a prim or a box"
        )
    else:
        message = (
            f"{count} no primvar of numbers named {bare} on"
            f" {'its' if len(meshes) == 1 else 'their'} points"
        )
        hint = "paint the weights as a float or int primvar with the interpolation vertex"
        if known:
            hint += f"; primvars on points are {', '.join(known)}"
        for prim in meshes:
            other = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(bare)
            if other and other.HasValue():
                close = []
                message = (
                    f"<{prim.GetPath()}> has {bare} as {other.GetTypeName()} with the"
                    f" interpolation {other.GetInterpolation()}"
                )
    if close and close[0] != bare:
        hint = meant([f"{kind}{close[0]}"]).strip()
    return InputError(f"{where}: {message}", hint)


def _paintings(prim: Usd.Prim) -> list[str]:
    """The names of the primvars of a mesh that could be a weight map."""
    found = UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance()
    return [primvar.GetPrimvarName() for primvar in found if _is_painting(primvar)]


def _is_painting(primvar: UsdGeom.Primvar) -> bool:
    """Whether a primvar has a number for each point."""
    numbers = primvar.GetTypeName().scalarType in WEIGHTS
    return numbers and primvar.GetInterpolation() in ON_POINTS


def _painted(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> Floats | None:
    """(V,) values of a primvar on points; None where the mesh has no such primvar."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue() or not _is_painting(primvar):
        return None
    values = primvar.ComputeFlattened(time)  # None: indices outside its values
    return None if values is None else np.atleast_1d(np.asarray(values, np.float64))


def _of_joint(prim: Usd.Prim, name: str) -> tuple[Floats | None, list[str]]:
    """(V,) skinning weights of a joint, or None where there is no such; and all joints' names."""
    binding = UsdSkel.BindingAPI(prim)
    skeleton = UsdSkel.Skeleton(binding.GetInheritedSkeleton())
    joints: list[str] = list(binding.GetJointsAttr().Get() or ())
    if not joints and skeleton:
        joints = list(skeleton.GetJointsAttr().Get() or ())
    indices, weights = binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()
    if not joints or not indices.HasValue() or not weights.HasValue():
        return None, joints
    mine = [k for k, joint in enumerate(joints) if name in (joint, joint.rpartition("/")[2])]
    wide = max(1, indices.GetElementSize())
    of = np.asarray(indices.ComputeFlattened()).reshape(-1, wide)
    by = np.asarray(weights.ComputeFlattened(), float).reshape(-1, wide)
    if not mine or of.shape != by.shape:
        return None, joints
    return np.where(np.isin(of, mine), by, 0.0).sum(1), joints


def _region(
    stage: Usd.Stage,
    facts: StageFacts,
    name: str,
    rest: Usd.TimeCode,
    times: Sequence[float],
    option: str,
    without: Collection[str] = (),
) -> Region:
    label = f"{option} {name}"
    prim = named_prim(stage, facts.path, name)
    subset = UsdGeom.Subset(prim)
    if subset:
        prims = [prim.GetParent()]
    else:
        every = (p for p in Usd.PrimRange(prim, PROXIES) if has_surface(p))
        prims = [p for p in every if p == prim or str(p.GetPath()) not in without]
    if not prims:
        raise InputError(
            f"{facts.path}: {label}: <{prim.GetPath()}> is a {prim.GetTypeName() or 'prim'}"
            " without a mesh under it",
            "name a GeomSubset, a mesh or an ancestor of meshes, or give a box:"
            f" {option} box:x0,y0,z0,x1,y1,z1",
        )
    points, triangles = _triangles(prims, facts, rest, label)
    moving = _posed(prims, facts, times)
    path = points[None]
    if moving is not None:
        moving[0] = points
        path = moving
    if not subset:
        return Region(name=name, kind="volume", points=points, triangles=triangles, path=path)
    chosen = _chosen(subset, prims[0], triangles, rest, facts, label)
    used, renumbered = np.unique(chosen, return_inverse=True)
    return Region(
        name=name,
        kind="patch",
        points=points[used],
        triangles=renumbered.reshape(-1, 3),
        path=path[:, used],
        body=str(prims[0].GetPath()),
    )


def _triangles(
    prims: Sequence[Usd.Prim], facts: StageFacts, rest: Usd.TimeCode, label: str
) -> tuple[Floats, Ints]:
    """The concatenated points (V, 3) [m] and triangles (T, 3) of some prims."""
    context, points, triangles, count = bare_reading(facts, rest), [], [], 0
    for prim in prims:
        try:
            surface = read_surface(prim, context)
        except SkippedPrim as reason:
            raise InputError(
                f"{facts.path}: {label}: <{prim.GetPath()}> {reason}", "name other prims"
            ) from reason
        points.append(surface.points)
        triangles.append(surface.triangles + count)
        count += len(surface.points)
    return np.concatenate(points), np.concatenate(triangles)


def _posed(prims: Sequence[Usd.Prim], facts: StageFacts, times: Sequence[float]) -> Floats | None:
    """(F, V, 3) [m] points at the time codes; None where they are static."""
    readings = [bare_reading(facts, Usd.TimeCode(time)) for time in times]
    if not any(transform_varies(p) or shape_varies(p, readings[0]) for p in prims):
        return None
    path = np.stack(
        [np.concatenate([posed_points(prim, reading) for prim in prims]) for reading in readings]
    )
    return None if np.array_equal(path, np.broadcast_to(path[0], path.shape)) else path


def _faces_of(prim: Usd.Prim, n_triangles: int, rest: Usd.TimeCode) -> Ints:
    """(T,) the authored face of each triangle."""
    if not prim.IsA(UsdGeom.Mesh):
        return np.arange(n_triangles)
    mesh = UsdGeom.Mesh(prim)
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get(rest), np.int64)
    per_face = np.maximum(counts - 2, 0)
    per_face[np.asarray(mesh.GetHoleIndicesAttr().Get(rest) or [], np.int64)] = 0
    return np.repeat(np.arange(len(counts)), per_face)


def _chosen(
    subset: UsdGeom.Subset,
    mesh: Usd.Prim,
    triangles: Ints,
    rest: Usd.TimeCode,
    facts: StageFacts,
    label: str,
) -> Ints:
    """Triangles (n, 3) of the mesh that belong to a subset of its faces or points."""
    indices = np.asarray(subset.GetIndicesAttr().Get(rest) or [], dtype=np.int64)
    kind = subset.GetElementTypeAttr().Get()
    if kind == UsdGeom.Tokens.point:
        mine = np.isin(triangles, indices).all(1)
    elif kind == UsdGeom.Tokens.face:
        mine = np.isin(_faces_of(mesh, len(triangles), rest), indices)
    else:
        raise InputError(
            f"{facts.path}: {label} is a subset of elementType {kind!r}",
            "name a subset of faces or points",
        )
    if not mine.any():
        raise InputError(
            f"{facts.path}: {label} holds {len(indices)} indices but contains no face of its mesh",
            "name a subset that contains faces",
        )
    return triangles[mine]
