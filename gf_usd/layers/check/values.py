"""Rules about the valid range of values, and about values that are not finite."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics, UsdVol

from gf_usd.core.arrays import columns
from gf_usd.core.materials.laws import law_internals, law_parameters
from gf_usd.core.units import StageUnits
from gf_usd.layers.check.base import Finding, about, first_problem, rule
from gf_usd.layers.check.read import Array, array_of, authored, prims, samples, times

# Half floats round to 2^-11 = 4.9e-4 of a component, so a rounded unit quaternion is within that
# of unit length; a larger error means that the quaternion is not normalized.
UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Interval:
    """Numbers from low to high; an open end is excluded."""

    low: float
    high: float
    open_low: bool = False
    open_high: bool = False

    def outside(self, values: Array) -> np.ndarray:
        """True where a value lies outside; NaN does not (the rule ``finite`` names it)."""
        below = values <= self.low if self.open_low else values < self.low
        above = values >= self.high if self.open_high else values > self.high
        return below | above

    def __str__(self) -> str:
        left, right = "(" if self.open_low else "[", ")" if self.open_high else "]"
        return f"{left}{self.low:g}, {self.high:g}{right}"


INF = float("inf")
POSITIVE = Interval(0.0, INF, open_low=True)
NOT_NEGATIVE = Interval(0.0, INF)
UNIT = Interval(0.0, 1.0)
POISSON = Interval(-1.0, 0.5, open_low=True, open_high=True)

LIMITS: dict[str, Interval] = {
    "opacities": UNIT,
    "opacitiesh": UNIT,
    "scales": POSITIVE,
    "scalesh": POSITIVE,
    "widths": NOT_NEGATIVE,
    "gaussianFlesh:restScales": POSITIVE,
    "gaussianFlesh:restVolumes": POSITIVE,
    "gaussianFlesh:masses": POSITIVE,
    "gaussianFlesh:youngsModulus": POSITIVE,
    "gaussianFlesh:densities": POSITIVE,
    "gaussianFlesh:poissonsRatio": POISSON,
    "gaussianFlesh:vonMisesStress": NOT_NEGATIVE,
    "gaussianFlesh:dampingTime": NOT_NEGATIVE,
    "gaussianFlesh:spacing": NOT_NEGATIVE,
    "gaussianFlesh:particles": NOT_NEGATIVE,
    "gaussianFlesh:seed": NOT_NEGATIVE,
    "physics:youngsModulus": NOT_NEGATIVE,  # 0: not stated
    "physics:poissonsRatio": POISSON,
    "physics:density": NOT_NEGATIVE,  # 0: not stated
    "physics:staticFriction": NOT_NEGATIVE,
    "physics:dynamicFriction": NOT_NEGATIVE,
    "physics:restitution": UNIT,
}


def limits(stage: Usd.Stage) -> dict[str, Interval]:
    """LIMITS, and the ranges of the laws' parameters in units of the stage."""
    meters, kilograms = (
        UsdGeom.GetStageMetersPerUnit(stage),
        UsdPhysics.GetStageKilogramsPerUnit(stage),
    )
    if not (meters > 0.0 and kilograms > 0.0):  # `stage-units` says so
        return LIMITS
    units = StageUnits(meters_per_unit=meters, kilograms_per_unit=kilograms)
    own = {}
    for p in law_parameters():
        factor = units.factor(p.unit)
        own[f"gaussianFlesh:{p.attribute}"] = Interval(p.low / factor, p.high / factor)
    remembered = {f"gaussianFlesh:{one.attribute}": NOT_NEGATIVE for one in law_internals()}
    return LIMITS | own | remembered


# other prims have attributes of these names too: a PointInstancer mirrors with negative scales
FIELD_ONLY = frozenset(("opacities", "opacitiesh", "scales", "scalesh"))


@rule("value-range", "opacities, sizes, masses and material parameters are within their ranges")
def value_range(stage: Usd.Stage) -> Iterator[Finding]:
    ranges = limits(stage)
    for prim in prims(stage):
        field = prim.IsA(UsdVol.ParticleField)
        for name, interval in ranges.items():
            attribute = authored(prim, name)
            if attribute is None or (name in FIELD_ONLY and not field):
                continue
            if problem := first_problem(_outside(attribute, interval)):
                yield about("value-range", prim, name).error(
                    f"{name} has {problem}", f"author values in {interval}"
                )


def _outside(attribute: Usd.Attribute, interval: Interval) -> Iterator[tuple[Usd.TimeCode, str]]:
    for time, array in samples(attribute):
        values = array.reshape(-1)
        bad = np.flatnonzero(interval.outside(values))
        if not len(bad):
            continue
        first = f"{values[bad[0]]:g}" + (f" at [{bad[0]}]" if array.ndim else "")
        many = f"{len(bad)} of {len(values)} values outside {interval}; the first is "
        yield time, (many if array.ndim else f"a value outside {interval}: ") + first


@rule("unit-quaternions", "orientations are unit quaternions")
def unit_quaternions(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        names = ["gaussianFlesh:restOrientations"]
        if prim.IsA(UsdVol.ParticleField):
            names += ["orientations", "orientationsh"]
        for attribute in (a for name in names if (a := authored(prim, name))):
            if problem := first_problem(_not_unit(attribute)):
                yield about("unit-quaternions", prim, attribute.GetName()).error(
                    f"{attribute.GetName()} has {problem}",
                    "divide each quaternion by its length",
                )


def _not_unit(attribute: Usd.Attribute) -> Iterator[tuple[Usd.TimeCode, str]]:
    for time, array in samples(attribute):
        if array.ndim != 2 or array.shape[1] != 4:
            continue
        of = columns(array)
        squares = (of * of).sum(0)
        if (np.abs(squares - 1.0) <= UNIT_TOLERANCE).all():  # the length is nearer to 1
            continue
        length = np.linalg.norm(array, axis=1)
        bad = np.flatnonzero(np.abs(length - 1.0) > UNIT_TOLERANCE)
        if len(bad):
            first = f"[{bad[0]}] has length {length[bad[0]]:g}"
            yield time, f"{len(bad)} of {len(length)} quaternions that are not unit, {first}"


@rule("allowed-tokens", "tokens of our schema have allowed values")
def allowed_tokens(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        for attribute in prim.GetAuthoredPropertiesInNamespace("gaussianFlesh"):
            if not isinstance(attribute, Usd.Attribute):
                continue
            allowed = attribute.GetMetadata("allowedTokens")
            value = attribute.Get()
            if allowed and value is not None and value not in allowed:
                yield about("allowed-tokens", prim, attribute.GetName()).error(
                    f'{attribute.GetName()} = "{value}" is not one of {", ".join(allowed)}',
                    f"author one of {', '.join(allowed)}",
                )


NAMES = frozenset(
    (
        "points",
        "positions",
        "positionsh",
        "velocities",
        "accelerations",
        "angularVelocities",
        "normals",
        "primvars:normals",
        "widths",
        "primvars:widths",
        "scales",
        "scalesh",
        "orientations",
        "orientationsh",
        "opacities",
        "opacitiesh",
        "radiance:sphericalHarmonicsCoefficients",
        "radiance:sphericalHarmonicsCoefficientsh",
        "primvars:displayColor",
        "primvars:displayOpacity",
        "extent",
        "extentsHint",
        "physics:youngsModulus",
        "physics:poissonsRatio",
    )
)
PREFIXES = ("gaussianFlesh:", "xformOp:")


@rule("finite", "no sample of a geometric attribute holds NaN or infinity")
def finite(stage: Usd.Stage) -> Iterator[Finding]:
    """Checks geometry attributes only: elsewhere infinity may be valid, as in UsdPhysics."""
    for prim in prims(stage):
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if name not in NAMES and not name.startswith(PREFIXES):
                continue
            if problem := first_problem(_problems(attribute)):
                yield about("finite", prim, name).error(
                    f"{name} holds {problem}",
                    "export the file again with finite numbers; in a bake it means that the "
                    "simulation failed: try a smaller step or a softer material",
                )


def _problems(attribute: Usd.Attribute) -> Iterator[tuple[Usd.TimeCode, str]]:
    value_at = Usd.AttributeQuery(attribute).Get
    for time in times(attribute):
        value = value_at(time)
        if isinstance(value, float) and isfinite(value):
            continue
        array = array_of(value)
        if array is None:
            continue
        if array.dtype.kind != "f":
            return
        if np.isfinite(array).all():
            continue
        elements = array.reshape(len(array), -1) if array.ndim > 1 else array.reshape(-1, 1)
        bad = np.flatnonzero(~np.isfinite(elements).all(axis=1))
        if len(bad):
            yield (
                time,
                f"{len(bad)} of {len(elements)} elements that are not finite; the first is "
                f"[{bad[0]}]",
            )
