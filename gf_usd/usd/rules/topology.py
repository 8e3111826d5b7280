"""Rules about meshes: faces that fit their points and normals that fit their faces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pxr import Usd, UsdGeom

from gf_usd.usd.rules.base import Finding, about, once, rule
from gf_usd.usd.rules.read import Array, Track, authored, joint_times, lengths, prims


@dataclass(frozen=True)
class Span:
    """What a topology array comes down to."""

    count: int
    total: int
    low: int
    high: int


def span(array: Array) -> Span:
    """Length, sum and limits of an integer array."""
    if not array.size:
        return Span(0, 0, 0, 0)
    return Span(array.size, int(array.sum(dtype="int64")), int(array.min()), int(array.max()))


@dataclass(frozen=True)
class Faces:
    """The topology of one mesh over time."""

    counts: Track[Span]  # of faceVertexCounts
    indices: Track[Span]  # of faceVertexIndices
    points: Track[int]

    @staticmethod
    def of(prim: Usd.Prim) -> Faces:
        return Faces(
            Track(authored(prim, "faceVertexCounts"), span),
            Track(authored(prim, "faceVertexIndices"), span),
            lengths(authored(prim, "points")),
        )


@rule("mesh-topology", "faceVertexIndices are as many as faces want and lead to points")
def mesh_topology(stage: Usd.Stage) -> Iterator[Finding]:
    """A vertex that no face uses is no error; a face without its vertex is one."""
    for prim in prims(stage):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        if problem := once(_face_problems(Faces.of(prim))):
            yield about("mesh-topology", prim).error(
                problem, "author faces whose corners are points of this mesh, at every time sample"
            )


def _face_problems(faces: Faces) -> Iterator[tuple[Usd.TimeCode, str]]:
    for time in joint_times(faces.counts, faces.indices, faces.points):
        counts, indices = faces.counts.at(time), faces.indices.at(time)
        if counts is None or indices is None:
            continue
        points = faces.points.at(time) if faces.points else 0
        if counts.count and counts.low < 3:
            yield time, f"faceVertexCounts has a face of {counts.low} corners"
        elif counts.total != indices.count:
            yield (
                time,
                f"faceVertexCounts add up to {counts.total}, "
                f"faceVertexIndices has {indices.count} elements",
            )
        elif points is not None and indices.count and not 0 <= indices.low <= indices.high < points:
            yield (
                time,
                f"faceVertexIndices run from {indices.low} to {indices.high}, "
                f"the mesh has {points} points",
            )


@rule("point-count", "a mesh of constant topology has as many points in every sample")
def point_count(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        faces = Faces.of(prim)
        if len(faces.counts.codes) > 1 or len(faces.indices.codes) > 1:
            continue
        sizes = faces.points.facts
        first = next(iter(sizes), 0)
        changes = (
            (Usd.TimeCode(code), f"{size} points where the first sample has {first}")
            for code, size in zip(faces.points.codes, sizes)
            if size != first
        )
        if problem := once(changes):
            yield about("point-count", prim).error(
                f"points has {problem}, with one topology for all",
                "author the same points in every sample, or topology samples that go with them",
            )


@rule("normals-length", "normals are as many as their interpolation wants")
def normals_length(stage: Usd.Stage) -> Iterator[Finding]:
    """primvars:normals, where authored, is what USD reads instead of normals."""
    for prim in prims(stage):
        if not prim.IsA(UsdGeom.PointBased):
            continue
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
        if primvar and primvar.HasAuthoredValue():
            name, interpolation = "primvars:normals", primvar.GetInterpolation()
            attribute = primvar.GetIndicesAttr() if primvar.IsIndexed() else primvar.GetAttr()
        else:
            name, attribute = "normals", authored(prim, "normals")
            interpolation = UsdGeom.PointBased(prim).GetNormalsInterpolation()
        mesh = prim.IsA(UsdGeom.Mesh)
        if attribute is None or (not mesh and interpolation not in ("vertex", "constant")):
            continue
        if problem := once(_normal_problems(lengths(attribute), Faces.of(prim), interpolation)):
            yield about("normals-length", prim).error(
                f"{name} has {problem}",
                "author as many normals as the interpolation wants, or set the one that fits",
            )


def _normal_problems(
    normals: Track[int], faces: Faces, interpolation: str
) -> Iterator[tuple[Usd.TimeCode, str]]:
    for time in joint_times(normals, faces.points, faces.indices):
        have = normals.at(time)
        counts, indices = faces.counts.at(time), faces.indices.at(time)
        want = {
            "constant": 1,
            "uniform": counts.count if counts else None,
            "varying": faces.points.at(time),
            "vertex": faces.points.at(time),
            "faceVarying": indices.count if indices else None,
        }.get(interpolation)
        # an empty array means that there are no normals
        if have and want is not None and have != want:
            yield time, f"{have} elements, interpolation {interpolation} wants {want}"
