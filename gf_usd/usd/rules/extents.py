"""The rule that bounds bound."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.rows import corners
from gf_usd.usd.rules.base import Finding, about, once, rule
from gf_usd.usd.rules.read import (
    Array,
    authored,
    numbers,
    position_attribute,
    prims,
    times,
    vectors,
)

# Extents are floats, often computed in doubles or printed with six digits: what sticks out by less
# than 1e-5 of the largest coordinate is rounding, not a point outside.
ROUNDING = 1e-5


@rule("extent", "extent encloses the points at every sample")
def extent(stage: Usd.Stage) -> Iterator[Finding]:
    """Required: min and max of the points, for Points those of their balls (width / 2 around).

    For particle fields the centers have to be inside; how far their kernels reach is left to the
    author.  Without an extent USD computes one for meshes and points (slowly), for particle fields
    it takes an empty box.  Curves and patches bend away from their points and are not judged.
    """
    for prim in prims(stage):
        position = position_attribute(prim)
        curved = prim.IsA(UsdGeom.PointBased) and not (
            prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.Points)
        )
        if position is None or curved:
            continue
        speak = about("extent", prim)
        box = authored(prim, "extent")
        if box is None:
            if prim.GetTypeName():
                yield speak.warning(
                    f"no extent is authored around {position.GetName()}",
                    "author extent at every time sample of the points",
                )
            continue
        if problem := once(_outside(prim, position, box)):
            yield speak.error(
                f"extent {problem}", "compute extent from the points at every time sample"
            )


def _outside(
    prim: Usd.Prim, position: Usd.Attribute, box: Usd.Attribute
) -> Iterator[tuple[Usd.TimeCode, str]]:
    for time in times(position, box):
        points, ends = vectors(position, time), vectors(box, time)
        if points is None or ends is None or not len(points):
            continue
        if len(ends) != 2:
            yield time, f"has {len(ends)} corners instead of 2"
            continue
        radius = _radius(prim, time, len(points))
        low, high = corners(points - radius)[0], corners(points + radius)[1]
        # NaN is named by the rule ``finite``
        slack = ROUNDING * max(np.abs(low).max(), np.abs(high).max())
        box_low, box_high = ends.astype(np.float64)
        out = np.maximum(box_low - low, high - box_high).max()
        if out > slack:
            yield time, f"leaves points up to {out:.3g} outside"


def _radius(prim: Usd.Prim, time: Usd.TimeCode, count: int) -> Array | float:
    """Radius of the ball around each point: (N, 1), or one number."""
    if not prim.IsA(UsdGeom.Points):
        return 0.0
    widths = numbers(authored(prim, "primvars:widths", "widths"), time)
    if widths is None or widths.ndim != 1 or len(widths) not in (1, count):
        return 0.0
    return widths[:, None] * 0.5
