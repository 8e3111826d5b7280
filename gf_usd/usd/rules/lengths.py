"""Rules about how many elements arrays have, compared at every time where either has a sample."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from pxr import Usd, UsdGeom, UsdVol

from gf_usd.usd.rules.base import Finding, about, once, rule
from gf_usd.usd.rules.read import (
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
    """(time, have, want) wherever two lengths differ; nothing where one has no value."""
    for time in joint_times(count, points):
        have, want = count.at(time), points.at(time)
        if have is not None and want is not None and have != want:
            yield time, have, want


def told(found: Iterable[Mismatch]) -> str:
    """Mismatches in words; empty where there are none."""
    return once((time, f"{have} elements for {want} points") for time, have, want in found)


@rule("particle-lengths", "every array of GaussianFleshParticlesAPI has one element per particle")
def particle_lengths(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        arrays = [a for name in PARTICLE_ARRAYS if (a := authored(prim, name))]
        if not arrays:
            continue
        points = lengths(position_attribute(prim))
        for attribute in arrays:
            if problem := told(mismatches(lengths(attribute), points)):
                yield about("particle-lengths", prim).error(
                    f"{attribute.GetName()} has {problem}",
                    "author one element per particle, in the order of the positions",
                )


@rule("point-lengths", "the per-point arrays that USD defines are as long as the points")
def point_lengths(stage: Usd.Stage) -> Iterator[Finding]:
    """Empty arrays count as not authored, as in USD.

    A particle field's array that is too long is cut off by renderers (a warning); one that is too
    short is thrown away whole.  A point-based prim's velocities, accelerations and ids are unused
    unless they fit.
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
            speak = about("point-lengths", prim)
            say = speak.warning if cut_off else speak.error
            yield say(
                f"{attribute.GetName()} has {told(found)}",
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
        if problem := once(_sh_problems(lengths(coefficients), lengths(position), degree)):
            yield speak.error(
                f"{coefficients.GetName()} has {problem}",
                f"author {(degree + 1) ** 2} coefficients per particle, or the degree that fits",
            )


def _degree(prim: Usd.Prim) -> int:
    """The degree of a particle field; USD's fallback 3 where none is authored."""
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
                f"{have} coefficients, degree {degree} with {particles} particles wants "
                f"{each * particles}",
            )
