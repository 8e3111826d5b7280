"""Division of meshes with long edges, in a USD layer over the stage.

A large face remains flat when the body bends in which its points are embedded.  The layer
overrides such meshes with more points and faces.  The surface does not change, and data on points,
faces and corners (primvars, normals, velocities, holes, GeomSubsets) is interpolated or inherited.
Cages of Catmull-Clark surfaces are refined by the subdivision rules, which preserve the limit
surface.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError, counted
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.subdivision import EDGE
from gf_usd.readers.mesh.divide import skinned
from gf_usd.readers.mesh.divide.cages import FIRST, RefinedCage, cage_of, refine_until, unknown_rule
from gf_usd.readers.mesh.divide.faces import (
    CORNERS,
    FACES,
    POINTS,
    VARYING,
    DividedFaces,
    divide_faces,
    long_faces,
)
from gf_usd.readers.mesh.to_usd import Folder, MeshSource, record_of

MOST = 4_000_000  # triangles of a mesh: more need too much memory
ELEMENTS = {"vertex": POINTS, "varying": VARYING, "uniform": FACES, "faceVarying": CORNERS}


def fine_edge(surfaces: Sequence[Surface], particles: int) -> float:
    """[m] EDGE spacings of so many particles in all surfaces; infinite for zero volume."""
    volume = sum(
        one.limit.volume if one.limit else abs(signed_volume(one.points, one.triangles))
        for one in surfaces
    )
    return EDGE * float(np.cbrt(volume / particles)) if volume > 0.0 else float("inf")


def divided(
    path: Path,
    surfaces: Sequence[Surface],
    longest: float,
    *,
    given: bool,
    of: MeshSource | None,
    unit: float,
    note: Callable[[str, str], None],
) -> MeshSource:
    """The layer over a file in which no mesh has an edge longer than this [m].

    surfaces : of the file.
    given : whether the user gave the length, rather than `fine_edge`.
    of : the converted layer, where the file is not USD.
    unit : [m] of the stage.
    note : called with a note on a mesh and its path.

    Raises InputError where a mesh would have more than MOST triangles with a length of the user.
    """
    folder = of.folder if of else Folder()
    if of is None:
        _lie_over(path, folder.layer)
    stage = Usd.Stage.Open(str(folder.layer))
    for surface in surfaces:
        if surface.type_name != "Mesh":
            continue
        prim = stage.GetPrimAtPath(surface.path)
        polygons = surface.points, surface.face_counts, surface.face_indices
        if not (count := int(long_faces(*polygons, longest).sum())):
            continue
        if why := _refusal(prim, polygons):
            faces = counted(count, "face longer", "faces longer")
            note(f"{faces} than --max-edge-length, not divided: {why}", surface.path)
            continue
        made = _shortened(prim, polygons, longest)
        if made is None and not given:
            note(
                f"{counted(count, 'face')} not divided: with edges of {longest / unit:.3g} units it"
                f" would have more than {MOST:,} triangles; give a larger --max-edge-length",
                surface.path,
            )
            continue
        if made is None:
            raise InputError(
                f"{path}: <{surface.path}>: with edges of at most {longest / unit:g} units it would"
                f" have more than {MOST:,} triangles",
                "give a larger --max-edge-length",
            )
        for name in _author(prim, made, polygons):
            note(f"{name} does not fit the faces that were divided, and is left out", surface.path)
        skinned.author_skin(prim, made, len(surface.points))
        what = (
            f"longer edges in {counted(count, 'face')} of the subdivision cage: it is refined"
            if isinstance(made, RefinedCage)
            else f"{made.divided} of {len(surface.face_counts)} faces are divided"
        )
        note(
            f"{what}: no edge is longer"
            f" than {longest / unit:g} units, and there are {len(made.counts)} faces now",
            surface.path,
        )
    layer = stage.GetRootLayer()
    layer.Save()
    record = of.record if of else record_of(path, [path], None, None)
    text = hashlib.sha256(layer.ExportToString().encode()).hexdigest()
    record = {**record, "maxEdgeLength": f"{longest / unit:.9g}", "layer": text}
    return MeshSource(path, folder, record, of.notes if of else (), of.sources if of else {})


def _lie_over(path: Path, target: Path) -> None:
    """Make an empty layer over a USD file, with the metadata of that file's root layer."""
    theirs = Sdf.Layer.FindOrOpen(str(path))
    layer = Sdf.Layer.CreateNew(str(target))
    for key in set(theirs.pseudoRoot.ListInfoKeys()) - {"subLayers", "subLayerOffsets"}:
        layer.pseudoRoot.SetInfo(key, theirs.pseudoRoot.GetInfo(key))
    layer.subLayerPaths.append(path.absolute().as_posix())
    layer.Save()


def _refusal(prim: Usd.Prim, polygons: tuple[Floats, Ints, Ints]) -> str:
    """The reason why the faces of a mesh are not divided; "" where they are."""
    mesh = UsdGeom.Mesh(prim)
    if prim.IsInstanceProxy():
        return "it is part of an instance, which a layer cannot change"
    if mesh.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.loop:
        return "it is the cage of a Loop subdivision surface; subdivide it where it was made"
    topology = (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    if any(one.ValueMightBeTimeVarying() for one in topology):
        return "its topology changes over time"
    points, counts, _ = polygons
    posed = mesh.GetPointsAttr()
    if any(len(posed.Get(time) or ()) != len(points) for time in posed.GetTimeSamples()):
        return "it has another number of points at some time"
    return unknown_rule(mesh, counts) or skinned.refusal(prim, len(points))


def _shortened(
    prim: Usd.Prim, polygons: tuple[Floats, Ints, Ints], longest: float
) -> DividedFaces | RefinedCage | None:
    """A mesh without long edges; None: it would have more than MOST triangles."""
    points, counts, indices = polygons
    if cage := cage_of(UsdGeom.Mesh(prim), counts, indices, len(points)):
        return refine_until(
            cage, points, lambda p, c, i: not long_faces(p, c, i, longest).any(), MOST // 2
        )
    made = divide_faces(points, counts, indices, longest, MOST)
    return None if len(made.division.triangles) >= MOST else made


def _author(
    prim: Usd.Prim, made: DividedFaces | RefinedCage, polygons: tuple[Floats, Ints, Ints]
) -> list[str]:
    """Author the divided mesh; returns the attributes of invalid size, which are blocked.

    polygons : the original ones.
    """
    mesh = UsdGeom.Mesh(prim)
    points, counts, indices = polygons
    sizes = {POINTS: len(points), VARYING: len(points), FACES: len(counts), CORNERS: len(indices)}
    normals = ELEMENTS.get(str(mesh.GetNormalsInterpolation()))
    misfits = []

    def change(attribute: Usd.Attribute, elements: str, to: Callable[[Any], Any]) -> None:
        if not _change(attribute, to, sizes[elements]):
            misfits.append(attribute.GetName())

    for attribute in (mesh.GetPointsAttr(), mesh.GetVelocitiesAttr(), mesh.GetAccelerationsAttr()):
        change(attribute, POINTS, lambda values: made.values(values, POINTS))
    if normals:
        change(mesh.GetNormalsAttr(), normals, lambda values: _unit(made.values(values, normals)))
    linear = str(mesh.GetFaceVaryingLinearInterpolationAttr().Get(FIRST))
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues():
        elements = ELEMENTS.get(str(primvar.GetInterpolation()))
        if elements is None or primvar.GetPrimvarName() in skinned.SKIN:
            continue
        if not _change_primvar(primvar, made, linear, sizes[elements]):
            primvar.GetAttr().Block()
            primvar.BlockIndices()
            misfits.append(primvar.GetName())
    _change(mesh.GetHoleIndicesAttr(), made.faces)
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
        if subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face:
            _change(subset.GetIndicesAttr(), made.faces)
    mesh.GetFaceVertexCountsAttr().Set(made.counts.astype(np.int32))
    mesh.GetFaceVertexIndicesAttr().Set(made.indices.astype(np.int32))
    if isinstance(made, RefinedCage):
        made.author(mesh)
    return misfits


def _change_primvar(
    primvar: UsdGeom.Primvar, made: DividedFaces | RefinedCage, linear: str, count: int
) -> bool:
    """Write the values of a primvar, or only its indices where those do: faces keep their values.

    linear : faceVaryingLinearInterpolation of the mesh; count : its elements.  Returns False, and
    may have written some, where it has not as many.
    """
    elements, width = ELEMENTS[str(primvar.GetInterpolation())], primvar.GetElementSize()
    attribute = primvar.GetAttr()
    value = attribute.Get(FIRST)
    fraction = value is not None and np.asarray(value).dtype.kind == "f"
    if primvar.IsIndexed() and (elements == FACES or not fraction):
        return _change(primvar.GetIndicesAttr(), lambda at: made.values(at, elements), count)
    unit = primvar.GetPrimvarName() == "normals"
    smooth = isinstance(made, RefinedCage) and elements == CORNERS and width == 1 and fraction

    def change(values: Any) -> Any:
        if smooth and not unit and linear != UsdGeom.Tokens.all:
            return made.smooth_corners(values, linear)
        out = made.values(values, elements, width)
        return _unit(out) if unit else out

    if not primvar.IsIndexed():
        return _change(attribute, change, count * width)
    times = sorted({*attribute.GetTimeSamples(), *primvar.GetIndicesAttr().GetTimeSamples()})
    flat = {time: primvar.ComputeFlattened(time) for time in times or [Usd.TimeCode.Default()]}
    for time, values in flat.items():
        # None where an index is out of range
        if values is None or len(values) not in (0, count * width):
            return False
        if len(values) == 0:
            continue
        attribute.Set(_as(values, change(np.asarray(values))), time)
    primvar.BlockIndices()
    return True


def _change(
    attribute: Usd.Attribute, change: Callable[[Any], Any], count: int | None = None
) -> bool:
    """Author what becomes of the value of an attribute, and of its time samples; none has none.

    count : values that it has to have, at every time; None: any number.  Where it has not it is
    blocked, and False is returned.
    """
    if not attribute or not attribute.HasAuthoredValue():
        return True
    times = [*attribute.GetTimeSamples(), Usd.TimeCode.Default()]
    seen = {time: attribute.Get(time) for time in times}
    seen = {time: values for time, values in seen.items() if values is not None}
    if count is not None and not all(_fits(values, count) for values in seen.values()):
        attribute.Block()
        return False
    for time, values in seen.items():
        if len(values):
            attribute.Set(_as(values, change(np.asarray(values))), time)
    return True


def _fits(values: Any, count: int) -> bool:
    return hasattr(values, "__len__") and len(values) in (0, count)


def _as(like: Any, values: Any) -> Any:
    """Values as a Vt array of the type of another."""
    if hasattr(type(like), "FromNumpy"):
        return type(like).FromNumpy(np.ascontiguousarray(values))
    return type(like)(values.tolist())


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
