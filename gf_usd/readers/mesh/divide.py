"""Divide the long faces of meshes, in a USD layer over the stage that has them.

A face is flat between its points however the body bends that they are embedded in.  The layer gives
such meshes more points and faces: the surface stays where it is, and what hangs on points, faces
and corners (primvars, normals, velocities, holes, GeomSubsets) is interpolated or handed on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError
from gf_usd.core.mesh import EDGE, Division, divide_edges, signed_volume, triangulate
from gf_usd.readers.mesh.to_usd import Folder, MeshSource, record_of

MOST = 4_000_000  # triangles of a mesh: more take the memory of a workstation
SKINNED = "primvars:skel:jointIndices"
POINTS, FACES, CORNERS = "points", "faces", "corners"
ELEMENTS = {"vertex": POINTS, "varying": POINTS, "uniform": FACES, "faceVarying": CORNERS}


@dataclass(frozen=True, kw_only=True)
class DividedFaces:
    """Polygons of which those with long edges are triangles with short ones."""

    counts: Ints  # (P',) corners of each face
    indices: Ints  # (C',) points of the corners
    face: Ints  # (P',) the face that each lies in
    corners: Ints  # (C', 3) three corners of that face ...
    weights: Floats  # (C', 3) ... and theirs at each corner
    division: Division  # of the points
    divided: int  # faces that had long edges

    def values(self, given: Any, elements: str, width: int = 1) -> Any:
        """Values (n, ...) of points, faces or corners, of those that there are now.

        Numbers with a fraction are interpolated; of others the nearest is taken.  width : values
        that belong to each element.
        """
        given = given.reshape(-1, width, *given.shape[1:])
        if elements == FACES:
            out = given[self.face]
        elif given.dtype.kind != "f":
            out = given[self._nearest(elements, len(given))]
        elif elements == POINTS:
            out = self.division.extended(given.astype(float))
        else:
            out = np.einsum("ck,ck...->c...", self.weights, given[self.corners].astype(float))
        return out.reshape(-1, *given.shape[2:]).astype(given.dtype)

    def faces(self, given: Ints) -> Ints:
        """The faces that lie in some of those before."""
        return np.flatnonzero(np.isin(self.face, given))

    def _nearest(self, elements: str, count: int) -> Ints:
        """(n,) for each point or corner one of the `count` before."""
        if elements == CORNERS:
            return np.take_along_axis(self.corners, self.weights.argmax(1)[:, None], 1)[:, 0]
        nearest = np.arange(count)
        for ends in self.division.halves:
            nearest = np.concatenate([nearest, nearest[ends[:, 0]]])
        return nearest


def long_faces(points: Floats, counts: Ints, indices: Ints, longest: float) -> Ints:
    """(P,) whether a polygon has an edge longer than this; lines have no triangles, and stay."""
    face = np.repeat(np.arange(len(counts)), counts)
    start = np.cumsum(counts) - counts
    after = np.arange(1, len(indices) + 1)
    after = np.where(after == (start + counts)[face], start[face], after)
    edge = lengths(points[indices[after]] - points[indices])
    return (np.bincount(face, edge > longest, len(counts)) > 0) & (np.asarray(counts) >= 3)


def divide_faces(points: Floats, counts: Ints, indices: Ints, longest: float) -> DividedFaces:
    """Divide polygons with an edge longer than this; the others stay, and meet them at their edges.

    points : (V, 3); counts : (P,); indices : (C,); longest : of the points' unit.
    """
    counts, indices = np.asarray(counts, np.int64), np.asarray(indices, np.int64)
    long, start = long_faces(points, counts, indices, longest), np.cumsum(counts) - counts
    triangles, corner, of = triangulate(points, counts, indices)
    cut = np.flatnonzero(long[of])
    division = divide_edges(points, triangles[cut], longest, MOST)
    # Corners stand in one table: those of the faces before, then those of the triangles.
    kept, made = np.flatnonzero(~long), of[cut][division.of]
    first = np.concatenate([start[kept], len(indices) + 3 * np.arange(len(made))])
    size = np.concatenate([counts[kept], np.full(len(made), 3)])
    home = np.concatenate([kept, made])
    order = np.argsort(home, kind="stable")
    size, home = size[order], home[order]
    begin = np.cumsum(size) - size
    rows = np.arange(int(size.sum())) - np.repeat(begin - first[order], size)
    same = np.arange(len(indices))
    sources = np.concatenate([
        np.stack([same, same, same], 1),
        np.repeat(corner[cut][division.of], 3, axis=0),
    ])  # fmt: skip
    alone = np.tile([1.0, 0.0, 0.0], (len(indices), 1))
    weights = np.concatenate([alone, division.weights.reshape(-1, 3)])
    return DividedFaces(
        counts=size,
        indices=np.concatenate([indices, division.triangles.ravel()])[rows],
        face=home,
        corners=sources[rows],
        weights=weights[rows],
        division=division,
        divided=int(long.sum()),
    )


def fine_edge(surfaces: Sequence[Surface], particles: int) -> float:
    """[m] EDGE spacings of so many particles in all surfaces; infinite: they hold nothing."""
    volume = sum(abs(signed_volume(one.points, one.triangles)) for one in surfaces)
    return EDGE * float(np.cbrt(volume / particles)) if volume > 0.0 else float("inf")


def divided(
    path: Path,
    surfaces: Sequence[Surface],
    longest: float,
    *,
    of: MeshSource | None,
    unit: float,
    note: Callable[[str, str], None],
) -> MeshSource:
    """The layer of a file whose meshes have no face with an edge longer than this [m].

    surfaces : of the file; of : its USD form, where it is no USD file; unit : [m] of the stage's.
    note : takes what is said of a mesh, and its path.

    Raises InputError where a mesh would have more than MOST triangles.
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
        if why := _refusal(prim):
            note(f"{count} faces longer than --max-edge-length stay: {why}", surface.path)
            continue
        made = divide_faces(*polygons, longest)
        if len(made.division.triangles) >= MOST:
            raise InputError(
                f"{path}: {surface.path}: with edges of at most {longest / unit:g} units it would"
                f" have more than {MOST:,} triangles",
                "give a larger --max-edge-length",
            )
        _author(prim, made)
        note(
            f"{made.divided} of {len(surface.face_counts)} faces are divided: no edge is longer"
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


def _refusal(prim: Usd.Prim) -> str:
    """Why the faces of a mesh are not divided; "" where they are."""
    mesh = UsdGeom.Mesh(prim)
    if prim.IsInstanceProxy():
        return "it is part of an instance, which a layer cannot change"
    if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
        return "it is the cage of a subdivision surface; subdivide it where it was made"
    if prim.GetAttribute(SKINNED).HasAuthoredValue():
        return "it is skinned, by weights of its points"
    topology = (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    if any(one.ValueMightBeTimeVarying() for one in topology):
        return "its topology changes over time"
    return ""


def _author(prim: Usd.Prim, made: DividedFaces) -> None:
    mesh = UsdGeom.Mesh(prim)
    normals = str(mesh.GetNormalsInterpolation())
    for attribute in (mesh.GetPointsAttr(), mesh.GetVelocitiesAttr(), mesh.GetAccelerationsAttr()):
        _change(attribute, lambda values: made.values(values, POINTS))
    if normals in ELEMENTS:
        _change(mesh.GetNormalsAttr(), lambda values: _unit(made.values(values, ELEMENTS[normals])))
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues():
        if primvar.GetInterpolation() in ELEMENTS:
            _change_primvar(primvar, made)
    _change(mesh.GetHoleIndicesAttr(), made.faces)
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
        if subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face:
            _change(subset.GetIndicesAttr(), made.faces)
    mesh.GetFaceVertexCountsAttr().Set(made.counts.astype(np.int32))
    mesh.GetFaceVertexIndicesAttr().Set(made.indices.astype(np.int32))


def _change_primvar(primvar: UsdGeom.Primvar, made: DividedFaces) -> None:
    """The values of a primvar, or only its indices where those do: faces keep their values."""
    elements, width = ELEMENTS[str(primvar.GetInterpolation())], primvar.GetElementSize()
    attribute = primvar.GetAttr()
    value = attribute.Get(Usd.TimeCode.EarliestTime())
    fraction = value is not None and np.asarray(value).dtype.kind == "f"
    if primvar.IsIndexed() and (elements == FACES or not fraction):
        _change(primvar.GetIndicesAttr(), lambda values: made.values(values, elements))
        return
    unit = primvar.GetPrimvarName() == "normals"

    def change(values: Any) -> Any:
        out = made.values(values, elements, width)
        return _unit(out) if unit else out

    if not primvar.IsIndexed():
        _change(attribute, change)
        return
    times = sorted({*attribute.GetTimeSamples(), *primvar.GetIndicesAttr().GetTimeSamples()})
    flat = {time: primvar.ComputeFlattened(time) for time in times or [Usd.TimeCode.Default()]}
    for time, values in flat.items():
        attribute.Set(_as(values, change(np.asarray(values))), time)
    primvar.BlockIndices()


def _change(attribute: Usd.Attribute, change: Callable[[Any], Any]) -> None:
    """Author what becomes of the value of an attribute, and of its time samples; none has none."""
    if not attribute or not attribute.HasAuthoredValue():
        return
    times = [*attribute.GetTimeSamples(), Usd.TimeCode.Default()]
    seen = {time: attribute.Get(time) for time in times}
    for time, values in seen.items():
        if values is not None and len(values):
            attribute.Set(_as(values, change(np.asarray(values))), time)


def _as(like: Any, values: Any) -> Any:
    """An array of the type of another."""
    if hasattr(type(like), "FromNumpy"):
        return type(like).FromNumpy(np.ascontiguousarray(values))
    return type(like)(values.tolist())


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
