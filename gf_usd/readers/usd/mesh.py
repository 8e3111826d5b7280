"""Reading of a Mesh, an implicit shape, a TetMesh or Points prim at one time, as a `Surface`.

Also its authored normals, in world space (`read_normals`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Kind, Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError, counted
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.core.neighbors import kd_tree
from gf_usd.readers.mesh.divide.cages import cage_of, limit_surface
from gf_usd.readers.notes import ANIMATED, Notes
from gf_usd.readers.usd.implicit import IMPLICIT, SIZES, tessellate
from gf_usd.readers.usd.primvars import Corners
from gf_usd.readers.usd.shading import ShadingReader, colors
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.solids.points import cover, widths
from gf_usd.readers.usd.solids.poses import BrokenPose, bound_points
from gf_usd.readers.usd.solids.tets import BrokenTets, Tets, surface_of
from gf_usd.readers.usd.stage import CHANGES, Placement, SkippedPrim


@dataclass(frozen=True, kw_only=True)
class Reading:
    """The context of reading prims of one stage at one time."""

    path: Path  # the file, for messages
    time: Usd.TimeCode
    meters_per_unit: float
    xforms: UsdGeom.XformCache
    skins: Skins
    shadings: ShadingReader
    notes: Notes


@dataclass(frozen=True, kw_only=True)
class Polygons:
    """A mesh as authored, in stage units and local space."""

    points: Floats  # (V, 3)
    counts: Ints  # (P,)
    indices: Ints  # (C,)
    holes: Ints  # (H,) faces that are holes (holeIndices)
    left_handed: bool
    carriers: Ints | None = None  # (V,) the authored point that each point follows; None: itself


def has_surface(prim: Usd.Prim) -> bool:
    """Whether the prim has faces, authored or by tessellation."""
    meshes = prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.TetMesh)
    return meshes or str(prim.GetTypeName()) in IMPLICIT


def read_surface(prim: Usd.Prim, reading: Reading) -> Surface:
    """The `Surface` of a Mesh, TetMesh, Points or implicit prim, in meters, world space.

    Raises InputError for invalid data, and SkippedPrim for a prim without a surface.
    """
    surface, place, where = _faces(prim, reading)
    normals = read_normals(
        prim, place, surface.points, where, surface.face_counts, surface.face_indices,
        reading.time, reading.notes,
    )  # fmt: skip
    shading = colors(prim, where, reading.shadings, reading.time, reading.notes)
    return replace(
        surface,
        normals=normals.values,
        normals_interpolation=normals.interpolation,
        normal_points=normals.carriers,
        triangle_colors=shading.colors,
        triangle_uvs=shading.uvs,
        triangle_materials=shading.indices,
        materials=shading.materials,
    )


def read_faces(prim: Usd.Prim, reading: Reading) -> Surface:
    """The surface of a prim without normals, colors and materials; errors as `read_surface`."""
    return _faces(prim, reading)[0]


def _faces(prim: Usd.Prim, reading: Reading) -> tuple[Surface, Placement, Corners]:
    """See `read_faces`; also the placement of the prim, and the corners of its triangles."""
    polygons = _polygons(prim, reading)
    if prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.TetMesh):
        polygons = replace(polygons, points=_bound(prim, polygons.points, reading))
    place = _placement(prim, reading)
    points = place.points(polygons.points) * reading.meters_per_unit
    if not np.isfinite(points).all():
        raise _broken(prim, reading, "the world coordinates of its points are too large")
    triangles, corners, faces = triangulate(points, polygons.counts, polygons.indices)
    kept = ~np.isin(faces, polygons.holes)
    triangles, corners, faces = triangles[kept], corners[kept], faces[kept]
    if len(triangles) == 0:
        raise SkippedPrim("has no face with at least three corners")
    if polygons.left_handed != place.mirrored:
        triangles, corners = triangles[:, ::-1], corners[:, ::-1]
    carriers = polygons.carriers
    authored = len(points) if carriers is None else int(carriers.max()) + 1
    where = Corners(
        n_points=authored,
        n_corners=len(polygons.indices),
        n_faces=len(polygons.counts),
        triangles=triangles if carriers is None else carriers[triangles],
        corners=corners,
        faces=faces,
    )
    surface = Surface(
        path=str(prim.GetPath()),
        type_name=str(prim.GetTypeName()),
        points=points,
        face_counts=polygons.counts,
        face_indices=polygons.indices,
        triangles=np.ascontiguousarray(triangles),
        triangle_corners=np.ascontiguousarray(corners),
        skinned=place.skinned,
        own_points=None if carriers is None else authored,
        origin=_origin(prim, reading),
        component=_component(prim),
        hole_faces=int(np.isin(np.arange(len(polygons.counts)), polygons.holes).sum()),
    )
    return surface, place, where


def world_box(prim: Usd.Prim, reading: Reading) -> Floats:
    """(2, 3) [m] the corners of the box around the points of a Mesh prim; its faces are not read.

    Raises InputError for invalid points, and SkippedPrim for a prim without any.
    """
    local = _finite_points(UsdGeom.Mesh(prim), prim, reading)
    if len(local) == 0:
        raise SkippedPrim("has no points")
    points = _placement(prim, reading).points(_bound(prim, local, reading))
    return np.array([points.min(0), points.max(0)]) * reading.meters_per_unit


def _component(prim: Usd.Prim) -> str:
    """Path of the outermost prim of kind component that contains a prim or is it; "": none."""
    found = ""
    while prim:
        if Kind.Registry.IsA(Usd.ModelAPI(prim).GetKind(), Kind.Tokens.component):
            found = str(prim.GetPath())
        prim = prim.GetParent()
    return found


def with_limit(prim: Usd.Prim, surface: Surface) -> Surface:
    """The surface of a prim, with the limit surface of a subdivision cage that is far from it."""
    if not prim.IsA(UsdGeom.Mesh):
        return surface
    points = surface.points
    cage = cage_of(UsdGeom.Mesh(prim), surface.face_counts, surface.face_indices, len(points))
    return surface if cage is None else replace(surface, limit=limit_surface(cage, points))


def posed_points(prim: Usd.Prim, reading: Reading) -> Floats:
    """World points (V, 3) [m] of a prim with a surface; errors as `read_surface`.

    For a Points prim these are its own points, without the surface around them.
    """
    if prim.IsA(UsdGeom.Points):
        local = _finite_points(UsdGeom.Points(prim), prim, reading)
    else:
        local = _polygons(prim, reading).points
    return _placement(prim, reading).points(local) * reading.meters_per_unit


def _origin(prim: Usd.Prim, reading: Reading) -> tuple[float, float, float]:
    """[m] the origin of the space in which the points of a prim are written."""
    x, y, z = reading.xforms.GetLocalToWorldTransform(prim).ExtractTranslation()
    return x * reading.meters_per_unit, y * reading.meters_per_unit, z * reading.meters_per_unit


def _bound(prim: Usd.Prim, points: Floats, reading: Reading) -> Floats:
    """See `bound_points`."""
    try:
        bound, note = bound_points(prim, points, reading.time)
    except BrokenPose as fault:
        raise _broken(prim, reading, str(fault)) from fault
    if note:
        reading.notes.add(note, str(prim.GetPath()))
    return bound


def _placement(prim: Usd.Prim, reading: Reading) -> Placement:
    posed = reading.skins.placement(prim) if prim.IsA(UsdGeom.Mesh) else None
    return posed or Placement.of(reading.xforms.GetLocalToWorldTransform(prim))


def _broken(prim: Usd.Prim, reading: Reading, what: str) -> InputError:
    return InputError(
        f"{reading.path}: <{prim.GetPath()}>: {what}",
        "repair this mesh in the program that made it, or choose other prims with --prim",
    )


def _polygons(prim: Usd.Prim, reading: Reading) -> Polygons:
    if str(prim.GetTypeName()) in IMPLICIT:
        points, counts, indices = tessellate(prim, reading.time)
        sizes = (attribute for name in SIZES if (attribute := prim.GetAttribute(name)))
        if any(attribute.ValueMightBeTimeVarying() for attribute in sizes):
            reading.notes.add(ANIMATED, str(prim.GetPath()))
        none = np.zeros(0, dtype=np.int64)
        return Polygons(
            points=points, counts=counts, indices=indices, holes=none, left_handed=False
        )
    if prim.IsA(UsdGeom.TetMesh):
        return _tets(UsdGeom.TetMesh(prim), prim, reading)
    if prim.IsA(UsdGeom.Points):
        return _cloud(UsdGeom.Points(prim), prim, reading)
    mesh, time = UsdGeom.Mesh(prim), reading.time
    counts = _ints(mesh.GetFaceVertexCountsAttr(), prim, reading)
    indices = _ints(mesh.GetFaceVertexIndicesAttr(), prim, reading)
    points = _points(mesh.GetPointsAttr(), prim, reading)
    if len(points) == 0 or len(counts) == 0:
        raise SkippedPrim(f"has {len(points)} points and {len(counts)} faces")
    _require_sound(prim, reading, points, counts, indices)
    if mesh.GetPointsAttr().ValueMightBeTimeVarying():
        reading.notes.add(ANIMATED, str(prim.GetPath()))
    if mesh.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying():
        reading.notes.add(CHANGES, str(prim.GetPath()))
    return Polygons(
        points=points,
        counts=counts,
        indices=indices,
        holes=_ints(mesh.GetHoleIndicesAttr(), prim, reading),
        left_handed=mesh.GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded,
    )


def _tets(mesh: UsdGeom.TetMesh, prim: Usd.Prim, reading: Reading) -> Polygons:
    """The surface of the tetrahedra, with all points: interior ones move with the body."""
    points, where = _finite_points(mesh, prim, reading), str(prim.GetPath())
    tets = _rows(mesh.GetTetVertexIndicesAttr(), 4, prim, reading)
    if len(points) == 0 or len(tets) == 0:
        raise SkippedPrim(f"has {len(points)} points and {len(tets)} tetrahedra")
    body = Tets(
        points=points,
        tets=tets,
        surface=_rows(mesh.GetSurfaceFaceVertexIndicesAttr(), 3, prim, reading),
        left_handed=mesh.GetOrientationAttr().Get(reading.time) == UsdGeom.Tokens.leftHanded,
        rest_points=_points(_first(prim, REST_POINTS), prim, reading),
        rest_tets=_rows(_first(prim, REST_TETS), 4, prim, reading),
    )
    try:
        triangles = surface_of(body, lambda text: reading.notes.add(text, where))
    except BrokenTets as fault:
        raise _broken(prim, reading, str(fault)) from fault
    if mesh.GetPointsAttr().ValueMightBeTimeVarying():
        reading.notes.add(ANIMATED, where)
    return _triangular(points, triangles)


# Of the AOUSD proposal's volume API, and of Omniverse's.
REST_POINTS = ("physics:restShapePoints", "omniphysics:restShapePoints")
REST_TETS = ("physics:restTetVertexIndices", "omniphysics:restTetVtxIndices")


def _first(prim: Usd.Prim, names: tuple[str, ...]) -> Usd.Attribute:
    """The first of the attributes that is authored, else an invalid one."""
    found = (prim.GetAttribute(name) for name in names)
    return next((one for one in found if one and one.HasAuthoredValue()), Usd.Attribute())


def _cloud(cloud: UsdGeom.Points, prim: Usd.Prim, reading: Reading) -> Polygons:
    """The points of a Points prim, followed by those of a surface around their balls."""
    points = _finite_points(cloud, prim, reading)
    if len(points) == 0:
        raise SkippedPrim("has no points")
    wide = widths(prim, points, reading.time, reading.notes)
    around, triangles = cover(points, wide)
    reading.notes.add(
        f"a surface was constructed around its {counted(len(points), 'point')}", str(prim.GetPath())
    )
    if cloud.GetPointsAttr().ValueMightBeTimeVarying():
        reading.notes.add(ANIMATED, str(prim.GetPath()))
    nearest = kd_tree(points).query(around)[1]
    whole = _triangular(np.concatenate([points, around]), triangles + len(points))
    return replace(whole, carriers=np.concatenate([np.arange(len(points)), nearest]))


def _triangular(points: Floats, triangles: Ints) -> Polygons:
    return Polygons(
        points=points,
        counts=np.full(len(triangles), 3),
        indices=np.asarray(triangles, dtype=np.int64).reshape(-1),
        holes=np.zeros(0, dtype=np.int64),
        left_handed=False,
    )


def _finite_points(shape: UsdGeom.PointBased, prim: Usd.Prim, reading: Reading) -> Floats:
    points = _points(shape.GetPointsAttr(), prim, reading)
    _require_finite(prim, reading, points)
    return points


def _rows(attribute: Usd.Attribute, width: int, prim: Usd.Prim, reading: Reading) -> Ints:
    """(n, width) of an array of whole numbers; none for an attribute that is not there."""
    values = _values(attribute, reading)
    if len(values) and (values.dtype.kind not in "iu" or values.shape[1:] != (width,)):
        raise _mistyped(attribute, prim, reading, f"int{width}[]")
    return values.astype(np.int64).reshape(-1, width)


def _ints(attribute: Usd.Attribute, prim: Usd.Prim, reading: Reading) -> Ints:
    values = _values(attribute, reading)
    if len(values) and (values.dtype.kind not in "iu" or values.ndim != 1):
        raise _mistyped(attribute, prim, reading, "int[]")
    return values.astype(np.int64).reshape(-1)


def _points(attribute: Usd.Attribute, prim: Usd.Prim, reading: Reading) -> Floats:
    values = _values(attribute, reading)
    if len(values) and (values.dtype.kind not in "fiu" or values.shape[1:] != (3,)):
        raise _mistyped(attribute, prim, reading, "point3f[]")
    return values.astype(np.float64).reshape(-1, 3)


def _values(attribute: Usd.Attribute, reading: Reading) -> np.ndarray:
    """The values of an attribute, whose type may differ from the schema's."""
    values = attribute.Get(reading.time) if attribute else None
    return np.atleast_1d(np.asarray([] if values is None else values))


def _mistyped(
    attribute: Usd.Attribute, prim: Usd.Prim, reading: Reading, wanted: str
) -> InputError:
    return _broken(prim, reading, f"the values of {attribute.GetName()} are not of type {wanted}")


def _require_sound(
    prim: Usd.Prim, reading: Reading, points: Floats, counts: Ints, indices: Ints
) -> None:
    """Raise InputError for invalid points or topology."""
    _require_finite(prim, reading, points)
    if counts.min() < 0:
        raise _broken(prim, reading, f"a face has {counts.min()} corners")
    if counts.sum() != len(indices):
        raise _broken(
            prim,
            reading,
            f"faceVertexCounts add up to {counts.sum()} corners, "
            f"but there are {len(indices)} faceVertexIndices",
        )
    outside = (indices < 0) | (indices >= len(points))
    if outside.any():
        raise _broken(
            prim,
            reading,
            f"{int(outside.sum())} faceVertexIndices do not refer to any of its {len(points)} "
            f"points; the first is {indices[outside][0]}",
        )


def _require_finite(prim: Usd.Prim, reading: Reading, points: Floats) -> None:
    lost = int((~np.isfinite(points)).any(axis=1).sum())
    if lost:
        raise _broken(
            prim, reading, f"{lost} of {len(points)} points are not finite (NaN or infinity)"
        )


@dataclass(frozen=True, kw_only=True)
class Normals:
    """Unit normals (K, 3) and the points (K,) that they belong to, or none."""

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
    """Authored normals in world space; none, with a note, where their number is invalid.

    `primvars:normals` takes precedence over `normals`, as in UsdGeom.  A zero normal is replaced by
    that of the faces around its point.
    """
    authored = _authored(prim, time)
    if authored is None:
        return Normals()
    values, interpolation = authored
    starts = np.minimum(np.cumsum(counts) - counts, len(indices) - 1)
    carriers = {
        "vertex": np.arange(where.n_points),
        "varying": np.arange(where.n_points),
        "faceVarying": indices,
        "uniform": indices[starts],
    }.get(interpolation)
    if carriers is None or len(carriers) != len(values):
        notes.add(
            f"its {len(values)} normals do not match the elements of its '{interpolation}' "
            f"interpolation: ignored",
            str(prim.GetPath()),
        )
        return Normals()
    finite = np.all(np.isfinite(values), axis=1, keepdims=True)
    world = place.normals(np.where(finite, values, 0.0), carriers)
    length = np.asarray(np.linalg.norm(world, axis=1))
    lost = np.asarray(length == 0.0)
    if lost.any():
        notes.add(
            f"{int(lost.sum())} of its {len(values)} normals have no direction: the normals of "
            f"the adjacent faces are used",
            str(prim.GetPath()),
        )
        world[lost] = _of_the_faces(points, where.triangles)[carriers[lost]]
        length = np.asarray(np.linalg.norm(world, axis=1))
    unit = world / np.where(length > 0.0, length, 1.0)[:, None]
    return Normals(values=unit, interpolation=interpolation, carriers=carriers)


def _authored(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Floats, str] | None:
    """Values (K, 3) in local space, and their interpolation; None where none are authored."""
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
    area = cross(b - a, c - a)
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, triangles[:, corner], area)
    # An arbitrary direction where the area is 0.
    total[~np.any(total, axis=1)] = (0.0, 0.0, 1.0)
    return total
