"""The source's root prims in the root layer, each referenced under its own name.

A root prim that others inherit from needs care.  If ``</duck/wing>`` inherits from ``</_wing>``,
then USD looks for ``</_wing>`` in every layer above as well: were it referenced there directly, its
opinions would come in as those of an inherit, which are stronger than a variant's, and the source's
points would win over the baked ones.  As the weakest arc, a specialize, they come last:

    class "_gaussianFleshSource"
        class "_wing" (references = the source's </_wing>)
    class "_wing" (specializes = </_gaussianFleshSource/_wing>)
"""

from __future__ import annotations

from pxr import Pcp, Sdf, Usd

from gf_usd.model import Asset

HOLDER = "_gaussianFleshSource"
CLASSES = (Pcp.ArcTypeInherit, Pcp.ArcTypeSpecialize)


def reference_roots(layer: Sdf.Layer, source: Usd.Stage, asset: Asset, reference: str) -> None:
    """Bring every root prim of the source into ``layer``.

    reference : the source's file as the layer refers to it.
    """
    inherited = _inherited(source, asset)
    holder = _holder(layer, source) if inherited else None
    for prim in source.GetPseudoRoot().GetAllChildren():
        name = prim.GetName()
        spec = Sdf.PrimSpec(layer.pseudoRoot, name, prim.GetSpecifier())
        if holder is not None and name in inherited:
            spec.specializesList.prependedItems = [holder.path.AppendChild(name)]
            spec = Sdf.PrimSpec(holder, name, prim.GetSpecifier())
        spec.referenceList.prependedItems = [Sdf.Reference(reference, prim.GetPath())]


def _inherited(source: Usd.Stage, asset: Asset) -> set[str]:
    """Names of the root prims that a surface in another root prim inherits from."""
    found = set()
    for surface in asset.surfaces:
        own = Sdf.Path(surface.path).GetPrefixes()[0].name
        query = Usd.PrimCompositionQuery(source.GetPrimAtPath(surface.path))
        for arc in query.GetCompositionArcs():
            name = arc.GetTargetNode().path.GetPrefixes()[0].name
            if arc.GetArcType() in CLASSES and name != own:
                found.add(name)
    return {name for name in found if source.GetPrimAtPath(f"/{name}")}


def _holder(layer: Sdf.Layer, source: Usd.Stage) -> Sdf.PrimSpec:
    name, count = HOLDER, 0
    while source.GetPrimAtPath(f"/{name}"):
        count += 1
        name = f"{HOLDER}{count}"
    return Sdf.PrimSpec(layer.pseudoRoot, name, Sdf.SpecifierClass)
