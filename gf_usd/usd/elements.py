"""Arrays of a mesh with one element for each point, face or corner, under a topology that changes.

A bake keeps the topology of its first frame.  Arrays that grow or shrink with the source's would no
longer fit it, so they are held at that frame too; those of constant length go on as they are.
"""

from __future__ import annotations

from collections.abc import Iterator

from pxr import Usd, UsdGeom

NORMALS = "primvars:normals"  # the bake has its own
TAGS = (
    *("holeIndices", "creaseIndices", "creaseLengths", "creaseSharpnesses"),
    *("cornerIndices", "cornerSharpnesses"),
)


def hold_elements(cache: Usd.Stage, prim: Usd.Prim, time: Usd.TimeCode) -> None:
    """Author in ``cache`` the value at ``time`` of every array of the mesh whose length changes."""
    for attribute in _arrays(prim):
        value = attribute.Get(time)
        if value is None or not _length_changes(attribute):
            continue
        over = cache.OverridePrim(attribute.GetPrimPath())
        mine = over.CreateAttribute(
            attribute.GetName(),
            attribute.GetTypeName(),
            attribute.IsCustom(),
            attribute.GetVariability(),
        )
        mine.Set(value)


def _arrays(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    yield from (prim.GetAttribute(name) for name in TAGS)
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues():
        if primvar.GetInterpolation() != UsdGeom.Tokens.constant and primvar.GetName() != NORMALS:
            yield primvar.GetAttr()
            if primvar.IsIndexed():
                yield primvar.GetIndicesAttr()
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
        yield subset.GetIndicesAttr()


def _length_changes(attribute: Usd.Attribute) -> bool:
    lengths = (len(attribute.Get(time) or ()) for time in attribute.GetTimeSamples())
    first = next(lengths, 0)
    return any(length != first for length in lengths)
