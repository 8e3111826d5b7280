"""Rules about array lengths, which are compared at every time sample of either array.

Also rules about meshes: faces must match points, and normals must match faces.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from pxr import Usd, UsdGeom, UsdVol

from gf_usd.core.materials.laws import law_internals
from gf_usd.layers.check.base import Finding, about, first_problem, rule
from gf_usd.layers.check.read import (
    Array,
    Track,
    authored,
    joint_times,
    lengths,
    numbers,
    position_attribute,
    prims,
)

PARTICLE_ARRAYS = tuple(
    f"gaussianFlesh:{name}"
    for name in (
        "restPositions",
        "restOrientations",
        "restScales",
        "restVolumes",
        "masses",
        "materialIndices",
        "youngsModulus",
        "poissonsRatio",
        "densities",
        "velocities",
        "deformationGradients",
        "vonMisesStress",
        *(one.attribute for one in law_internals()),
    )
)
FIELD_ARRAYS = (
    ("orientations", "orientationsh"),
    ("scales", "scalesh"),
    ("opacities", "opacitiesh"),
)
POINT_ARRAYS = ("velocities", "accelerations", "ids")
HARMONICS = "radiance:sphericalHarmonics"
Mismatch = tuple[Usd.TimeCode, int, int]


def mismatches(count: Track[int], points: Track[int]) -> Iterator[Mismatch]:
    """(time, length, expected length) wherever two lengths differ; none where one has no value."""
    for time in joint_times(count, points):
        have, want = count.at(time), points.at(time)
        if have is not None and want is not None and have != want:
            yield time, have, want


def mismatch_text(found: Iterable[Mismatch]) -> str:
    """Mismatches as text; "" where there are none."""
    return first_problem((time, f"{have} elements but {want} points") for time, have, want in found)


@rule("particle-lengths", "every array of GaussianFleshParticlesAPI has one element per particle")
def particle_lengths(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        arrays = [a for name in PARTICLE_ARRAYS if (a := authored(prim, name))]
        if not arrays:
            continue
        points = lengths(position_attribute(prim))
        for attribute in arrays:
            if problem := mismatch_text(mismatches(lengths(attribute), points)):
                yield about("particle-lengths", prim, attribute.GetName()).error(
                    f"{attribute.GetName()} has {problem}",
                    "author one element per particle, in the order of the positions",
                )


@rule("point-lengths", "the per-point arrays that USD defines have one element per point")
def point_lengths(stage: Usd.Stage) -> Iterator[Finding]:
    """Empty arrays count as not authored, as in USD.

    Renderers truncate an array of a particle field that is too long (a warning), and ignore one
    that is too short.  Velocities, accelerations and ids of a point-based prim are ignored unless
    their length matches.
    """
    for prim in prims(stage):
        position = position_attribute(prim)
        if position is None:
            continue
        field = prim.IsA(UsdVol.ParticleField)
        arrays = list(_field_arrays(prim) if field else _point_arrays(prim))
        if not arrays:
            continue
        points = lengths(position)
        for attribute in arrays:
            found = [m for m in mismatches(lengths(attribute), points) if m[1] > 0]
            if not found:
                continue
            cut_off = field and all(have > want for _, have, want in found)
            speak = about("point-lengths", prim, attribute.GetName())
            say = speak.warning if cut_off else speak.error
            yield say(
                f"{attribute.GetName()} has {mismatch_text(found)}",
                "author one element per point at every time sample",
            )


def _field_arrays(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    for names in FIELD_ARRAYS:
        if attribute := authored(prim, *names):
            yield attribute


def _point_arrays(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    for name in POINT_ARRAYS:
        if attribute := authored(prim, name):
            yield attribute
    if prim.IsA(UsdGeom.Points):
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("widths")
        widths = UsdGeom.Points(prim).GetWidthsAttr()
        if primvar and primvar.HasAuthoredValue():
            interpolation, widths = primvar.GetInterpolation(), primvar.GetAttr()
        else:
            interpolation = UsdGeom.Points(prim).GetWidthsInterpolation()
        per_point = interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)
        if widths.HasAuthoredValue() and per_point:
            yield widths


@rule("sh-count", "spherical harmonics of degree d have (d + 1)^2 coefficients per particle")
def sh_count(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        coefficients = authored(prim, f"{HARMONICS}Coefficients", f"{HARMONICS}Coefficientsh")
        position = position_attribute(prim)
        if coefficients is None or position is None:
            continue
        degree = _degree(prim)
        speak = about("sh-count", prim)
        if degree < 0:
            yield speak.error(f"{HARMONICS}Degree is {degree}", "author the degree as 0, 1, 2 or 3")
            continue
        if problem := first_problem(_sh_problems(lengths(coefficients), lengths(position), degree)):
            yield speak.error(
                f"{coefficients.GetName()} has {problem}",
                f"author {(degree + 1) ** 2} coefficients per particle, or correct the degree",
            )


def _degree(prim: Usd.Prim) -> int:
    """The degree of a particle field's harmonics; USD's fallback 3 where none is authored."""
    value = numbers(authored(prim, f"{HARMONICS}Degree"), Usd.TimeCode.Default())
    return 3 if value is None or value.ndim else int(value)


def _sh_problems(
    count: Track[int], points: Track[int], degree: int
) -> Iterator[tuple[Usd.TimeCode, str]]:
    each = (degree + 1) ** 2
    for time in joint_times(count, points):
        have, particles = count.at(time), points.at(time)
        if have and particles is not None and have != each * particles:
            yield (
                time,
                f"{have} coefficients, degree {degree} with {particles} particles needs "
                f"{each * particles}",
            )


@dataclass(frozen=True)
class Span:
    """The length, sum and range of a topology array."""

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


@rule("mesh-topology", "faceVertexIndices match faceVertexCounts and index existing points")
def mesh_topology(stage: Usd.Stage) -> Iterator[Finding]:
    """A face with an invalid vertex index is an error; an unused vertex is not."""
    for prim in prims(stage):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        if problem := first_problem(_face_problems(Faces.of(prim))):
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
                f"faceVertexCounts add up to {counts.total}, but faceVertexIndices has "
                f"{indices.count} elements",
            )
        elif points is not None and indices.count and not 0 <= indices.low <= indices.high < points:
            yield (
                time,
                f"faceVertexIndices range from {indices.low} to {indices.high}, but the mesh "
                f"has {points} points",
            )


@rule("point-count", "a mesh of constant topology has the same number of points in every sample")
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
            (Usd.TimeCode(code), f"{size} points, but the first sample has {first}")
            for code, size in zip(faces.points.codes, sizes)
            if size != first
        )
        if problem := first_problem(changes):
            yield about("point-count", prim).error(
                f"points has {problem}, but the topology is constant",
                "author the same number of points in every sample, or matching samples of the "
                "topology",
            )


@rule("normals-length", "normals have the count that their interpolation requires")
def normals_length(stage: Usd.Stage) -> Iterator[Finding]:
    """Where primvars:normals is authored, USD uses it instead of normals."""
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
        if problem := first_problem(
            _normal_problems(lengths(attribute), Faces.of(prim), interpolation)
        ):
            yield about("normals-length", prim).error(
                f"{name} has {problem}",
                "author as many normals as the interpolation needs, or set a matching "
                "interpolation",
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
            yield time, f"{have} elements, but interpolation {interpolation} needs {want}"
