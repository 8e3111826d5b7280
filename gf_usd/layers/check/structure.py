"""Rules about relationships, indices into them, schemas, prim types, layer metadata and time."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pxr import Usd, UsdGeom, UsdShade

from gf_usd.core.errors import counted
from gf_usd.core.units import code_text
from gf_usd.layers.check.base import Finding, about, first_problem, rule
from gf_usd.layers.check.read import applied_names, authored, prims, samples
from gf_usd.system.usd_schema import APIS

MATERIALS = "gaussianFlesh:materials"
INDICES = "gaussianFlesh:materialIndices"
TARGET_TYPES = {
    MATERIALS: ("a Material", UsdShade.Material),
    "gaussianFlesh:sourceMeshes": ("a geometric prim", UsdGeom.Gprim),
}
PREFIX = "GaussianFlesh"


@rule(
    "dangling-relationship",
    "relationships of our schema target prims of the right type",
    reads_samples=False,
)
def dangling_relationship(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        for relationship in prim.GetAuthoredPropertiesInNamespace("gaussianFlesh"):
            if not isinstance(relationship, Usd.Relationship):
                continue
            name = relationship.GetName()
            speak = about("dangling-relationship", prim, name)
            for path in relationship.GetTargets():
                target = stage.GetPrimAtPath(path)
                if not target:
                    yield speak.error(
                        f"{name} refers to <{path}>, which does not exist",
                        "author the path of a prim on this stage, or remove the target",
                    )
                elif name in TARGET_TYPES and not _may_be(target, TARGET_TYPES[name][1]):
                    wanted = TARGET_TYPES[name][0]
                    yield speak.error(
                        f"{name} refers to <{path}>, a {target.GetTypeName()}, not {wanted}",
                        f"author the path of {wanted}",
                    )


def _may_be(prim: Usd.Prim, schema: type[Usd.SchemaBase]) -> bool:
    """Whether the prim has this type, or an unknown type (an over, or a plugin's)."""
    return prim.GetPrimTypeInfo().GetSchemaType().isUnknown or prim.IsA(schema)


@rule("material-indices", "material indices are within the targets of gaussianFlesh:materials")
def material_indices(stage: Usd.Stage) -> Iterator[Finding]:
    for prim in prims(stage):
        indices = authored(prim, INDICES)
        if indices is None:
            continue
        relationship = prim.GetRelationship(MATERIALS)
        targets = len(relationship.GetTargets()) if relationship else 0
        if problem := first_problem(_beyond(indices, targets)):
            yield about("material-indices", prim).error(
                f"{INDICES} has {problem}, but {MATERIALS} has {targets} targets",
                "author the missing materials as targets, or indices of existing targets",
            )


def _beyond(attribute: Usd.Attribute, targets: int) -> Iterator[tuple[Usd.TimeCode, str]]:
    for time, array in samples(attribute):
        if array.size and (array.min() < 0 or array.max() >= targets):
            yield time, f"values from {array.min()} to {array.max()}"


@rule(
    "applied-schema",
    "API schemas are applied only to prim types that they allow",
    reads_samples=False,
)
def applied_schema(stage: Usd.Stage) -> Iterator[Finding]:
    """USD keeps the limits of every API but never enforces them on a file.

    A prim without a type here (an over, or a plugin's type) may have the right one elsewhere.
    """
    for prim in prims(stage):
        for name in applied_names(prim):
            speak = about("applied-schema", prim)
            family, instance = Usd.SchemaRegistry.GetTypeNameAndInstance(name)
            api = Usd.SchemaRegistry.GetAPITypeFromSchemaTypeName(family)
            if api.isUnknown:
                if family.startswith(PREFIX):
                    yield speak.error(
                        f"apiSchemas lists {name}, which is not in the schema library",
                        f"apply one of {', '.join(APIS)}",
                    )
                continue
            if prim.GetPrimTypeInfo().GetSchemaType().isUnknown:
                continue
            able = prim.CanApplyAPI(api, instance) if instance else prim.CanApplyAPI(api)
            if not able:
                types = Usd.SchemaRegistry.GetAPISchemaCanOnlyApplyToTypeNames(family, instance)
                made_for = f"made for {', '.join(types)}" if types else "not made for it"
                yield speak.error(
                    f"{name} is applied to a {prim.GetTypeName()}; it is {made_for}",
                    "remove the API from this prim and apply it to a prim of such a type",
                )


TIME_CODES = "time-codes-per-second"


@rule(
    TIME_CODES,
    "timeCodesPerSecond and framesPerSecond of every layer are positive and finite",
    reads_samples=False,
)
def time_codes_per_second(stage: Usd.Stage) -> Iterator[Finding]:
    """Zero or NaN over a sublayer makes USD search for samples forever, so this rule is first."""
    for layer in stage.GetUsedLayers():
        for key, present in (
            ("timeCodesPerSecond", layer.HasTimeCodesPerSecond()),
            ("framesPerSecond", layer.HasFramesPerSecond()),
        ):
            value = getattr(layer, key)
            if present and not (math.isfinite(value) and value > 0.0):
                yield about(TIME_CODES, "/").error(
                    f"layer {layer.identifier} authors {key} = {value:g}",
                    f"author a positive {key} in that layer, for example 24",
                )


@rule("stage-units", "metersPerUnit and kilogramsPerUnit are positive", reads_samples=False)
def stage_units(stage: Usd.Stage) -> Iterator[Finding]:
    """Missing values are allowed: USD's fallbacks are 0.01 and 1."""
    for key in ("metersPerUnit", "kilogramsPerUnit"):
        if not stage.HasAuthoredMetadata(key):
            continue
        value = stage.GetMetadata(key)
        usable = isinstance(value, (int, float)) and math.isfinite(value) and value > 0.0
        if not usable:
            yield about("stage-units", "/", key).error(
                f"the stage authors {key} = {value}",
                f"author a positive number, for example {key} = 1",
            )


@rule("time-range", "every time sample is between startTimeCode and endTimeCode")
def time_range(stage: Usd.Stage) -> Iterator[Finding]:
    """Samples outside the range are allowed: a shot may use part of a longer animation."""
    speak = about("time-range", "/")
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    bounded = stage.HasAuthoredTimeCodeRange()
    if bounded and not start <= end:
        yield speak.error(
            f"startTimeCode {code_text(start)} is after endTimeCode {code_text(end)}",
            "author the first and the last time code of the animation",
        )
        return
    animated = 0
    for prim in prims(stage):
        outside: list[str] = []
        low, high = math.inf, -math.inf
        for attribute in prim.GetAuthoredAttributes():
            codes = attribute.GetTimeSamples()
            if not codes:
                continue
            animated += 1
            if codes[0] < start or codes[-1] > end:
                outside.append(attribute.GetName())
                low, high = min(low, codes[0]), max(high, codes[-1])
        if bounded and outside:
            yield about("time-range", prim).warning(
                f"{counted(len(outside), 'attribute has', 'attributes have')} samples from"
                f" {code_text(low)} to {code_text(high)}, but the stage runs from"
                f" {code_text(start)} to {code_text(end)}:"
                f" {', '.join(outside[:3])}{', ...' if len(outside) > 3 else ''}",
                "extend the range from startTimeCode to endTimeCode, or delete the samples "
                "outside it",
            )
    if animated and not bounded:
        yield speak.warning(
            f"{counted(animated, 'attribute has', 'attributes have')} time samples, but the stage"
            " has no time range",
            "author startTimeCode and endTimeCode in the root layer",
        )
