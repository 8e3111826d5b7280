"""Instances that a bake would free, and whether they can be.

Opinions on what is inside of an instance are ignored by USD as long as it is one.  In a bake an
instance with a baked mesh is an ordinary prim, on which such opinions would take effect: another
transform, say, under points that were written for the one before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from pxr import Sdf, Usd

EVERYTHING = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)


def instances_above(prim: Usd.Prim) -> list[Usd.Prim]:
    """The instances that make a prim a proxy, the innermost first."""
    found = []
    while prim.IsInstanceProxy():
        prim = prim.GetParent()
        if prim.IsInstance():
            found.append(prim)
    return found


def not_to_be_freed(stage: Usd.Stage, prims: Iterable[Usd.Prim]) -> dict[Sdf.Path, str]:
    """Paths of the prims whose instances hide opinions, with the reason in words."""
    above = {prim.GetPath(): instances_above(prim) for prim in prims if prim.IsInstanceProxy()}
    if not above:
        return {}
    session = Sdf.Layer.CreateAnonymous(".usda")
    for instances in above.values():
        for instance in instances:
            Sdf.CreatePrimInLayer(session, instance.GetPath()).SetInfo("instanceable", False)
    freed = Usd.Stage.Open(stage.GetRootLayer(), session, Usd.Stage.LoadAll)
    outermost = {instances[-1].GetPath() for instances in above.values()}
    hidden = {path: _first_hidden(stage, freed, path) for path in outermost}
    reasons = {}
    for path, instances in above.items():
        at = instances[-1].GetPath()
        if where := hidden[at]:
            reasons[path] = (
                f"the instance <{at}> hides opinions on <{where}>, which would show if it were"
                " freed: delete them, or make it an ordinary prim"
            )
    return reasons


def _first_hidden(stage: Usd.Stage, freed: Usd.Stage, path: Sdf.Path) -> Sdf.Path | None:
    for prim in Usd.PrimRange(freed.GetPrimAtPath(path), EVERYTHING):
        theirs = stage.GetPrimAtPath(prim.GetPath())
        mine = list(_says(prim, freed.GetSessionLayer()))
        if not theirs or mine != list(_says(theirs, None)):
            return prim.GetPath()
    return None


def _says(prim: Usd.Prim, besides: Sdf.Layer | None) -> Iterator[Sdf.PrimSpec]:
    """The specs of a prim that say anything."""
    for spec in prim.GetPrimStack():
        empty = not spec.properties and spec.ListInfoKeys() == ["specifier"]
        if spec.layer != besides and not (empty and spec.specifier == Sdf.SpecifierOver):
            yield spec
