"""The rule that numbers are numbers."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

import numpy as np
from pxr import Usd

from gf_usd.usd.rules.base import Finding, about, once, rule
from gf_usd.usd.rules.read import array_of, prims, times

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
    """Only attributes that mean geometry: elsewhere infinity may be a value, as in UsdPhysics."""
    for prim in prims(stage):
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if name not in NAMES and not name.startswith(PREFIXES):
                continue
            if problem := once(_problems(attribute)):
                yield about("finite", prim).error(
                    f"{name} holds {problem}",
                    "write the file again from finite numbers; after a bake this means that the "
                    "simulation went wrong: try a smaller step or a softer material",
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
                f"{len(bad)} of {len(elements)} elements that are not finite, "
                f"the first is [{bad[0]}]",
            )
