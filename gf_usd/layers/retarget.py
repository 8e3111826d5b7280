"""Relationships and connections that are lost in a reference.

A reference to ``</root>`` ignores every target outside ``</root>``.  The root layer references all
root prims under their own names, so the lost targets are valid there and only need to be authored
again: each edit of such a property is repeated in the root layer, at the same path and inside the
same variant of the source, so that its strength relative to the source's other opinions is
unchanged.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pxr import Sdf, Usd, UsdUtils

from gf_usd.layers.stage import VARIANT_SET

EVERYTHING = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
LISTS = ("explicitItems", "prependedItems", "appendedItems", "deletedItems")
LISTS += ("addedItems", "orderedItems")  # of old files


@dataclass(frozen=True)
class _Edit:
    """A target list at one site, and the strongest spec that defines the kind of the property."""

    spec: Sdf.PropertySpec
    targets: Sdf.PathListOp


def repeat_edits(source: Usd.Stage, layer: Sdf.Layer, unskinned: frozenset[Sdf.Path]) -> int:
    """Repeat in ``layer`` every edit of a property that has a target outside its root prim.

    Parameters
    ----------
    source : the stage whose root prims ``layer`` references.
    layer : the root layer, with those references.
    unskinned : meshes of which a bake empties ``skel:`` relationships; theirs are repeated in the
        variant ``none``, where they cannot win over the bake.

    Returns
    -------
    Number of properties repeated.
    """
    repeated = 0
    for path, edits in _edits(source).items():
        if not any(_leaves(path, edit.targets) for edit in edits.values()):
            continue
        for site, edit in edits.items():
            if path.GetPrimPath() in unskinned and path.name.startswith("skel:"):
                site = _in_none(site)
            _author(layer, site, edit)
        repeated += 1
    return repeated


def restore_rest(source: Usd.Stage, result: Usd.Stage) -> tuple[str, ...]:
    """Author the source's composed targets in ``result`` wherever they still differ.

    They differ for targets that reach a prim through a reference within the source, for example
    from a prototype under another root prim.  On instances this requires ending the instancing.

    Returns
    -------
    Notes: instances that were ended, and targets that could not be restored.
    """
    notes: list[str] = []
    with _quiet():
        lost = list(_differences(source, result))
        for path in sorted({p for lost_at, _ in lost for p in _instances_above(result, lost_at)}):
            result.GetPrimAtPath(path).SetInstanceable(False)
            notes.append(
                f"<{path}> is no longer an instance: its relationships have targets outside its "
                f"root prim, which only an ordinary prim can have"
            )
        for path, targets in lost:
            _point(result, source.GetPropertyAtPath(path), targets)
        if lost:
            still = _differences(source, result)
            notes += [f"<{path}>: its targets could not be kept" for path, _ in still]
    return tuple(notes)


def _point(result: Usd.Stage, prop: Usd.Property, targets: list[Sdf.Path]) -> None:
    prim = result.OverridePrim(prop.GetPrimPath())
    if isinstance(prop, Usd.Relationship):
        prim.CreateRelationship(prop.GetName(), prop.IsCustom()).SetTargets(targets)
        return
    attribute = prim.CreateAttribute(
        prop.GetName(), prop.GetTypeName(), prop.IsCustom(), prop.GetVariability()
    )
    attribute.SetConnections(targets)


def _edits(source: Usd.Stage) -> dict[Sdf.Path, dict[Sdf.Path, _Edit]]:
    """Edits of targets in the source's own layers: by property path, then by site.

    A site is the property path with variant selections.
    """
    found: dict[Sdf.Path, dict[Sdf.Path, _Edit]] = defaultdict(dict)
    for layer in reversed(source.GetLayerStack(includeSessionLayers=False)):
        sites: list[Sdf.Path] = []
        layer.Traverse(Sdf.Path.absoluteRootPath, sites.append)
        for site in sites:
            if not site.IsPrimPropertyPath():
                continue
            spec = layer.GetPropertyAtPath(site)
            key = "targetPaths" if isinstance(spec, Sdf.RelationshipSpec) else "connectionPaths"
            if not spec.HasInfo(key):
                continue
            sites_of, targets = found[site.StripAllVariantSelections()], spec.GetInfo(key)
            if site in sites_of:
                # None if the two cannot be merged; restore_rest then finds the difference
                targets = targets.ApplyOperations(sites_of[site].targets) or targets
            sites_of[site] = _Edit(spec, targets)
    return found


def _leaves(path: Sdf.Path, targets: Sdf.PathListOp) -> bool:
    root = path.GetPrefixes()[0]
    return any(not item.HasPrefix(root) for name in LISTS for item in getattr(targets, name))


def _in_none(site: Sdf.Path) -> Sdf.Path:
    root = site.GetPrefixes()[0]
    return site.ReplacePrefix(root, root.AppendVariantSelection(VARIANT_SET, "none"))


def _author(layer: Sdf.Layer, site: Sdf.Path, edit: _Edit) -> None:
    prim, spec = Sdf.CreatePrimInLayer(layer, site.GetPrimOrPrimVariantSelectionPath()), edit.spec
    if isinstance(spec, Sdf.RelationshipSpec):
        mine = Sdf.RelationshipSpec(prim, site.name, spec.custom, spec.variability)
        targets = mine.targetPathList
    else:
        mine = Sdf.AttributeSpec(prim, site.name, spec.typeName, spec.variability, spec.custom)
        targets = mine.connectionPathList
    if edit.targets.isExplicit:
        targets.ClearEditsAndMakeExplicit()
        targets.explicitItems = edit.targets.explicitItems
        return
    for name in LISTS[1:]:
        setattr(targets, name, getattr(edit.targets, name))


def _differences(source: Usd.Stage, result: Usd.Stage) -> Iterator[tuple[Sdf.Path, list[Sdf.Path]]]:
    """Property paths whose targets differ, with the source's."""
    for prim in Usd.PrimRange.Stage(source, EVERYTHING):
        twin = result.GetPrimAtPath(prim.GetPath())
        if not twin:
            continue
        for rel in prim.GetAuthoredRelationships():
            targets = rel.GetTargets()
            if targets and targets != twin.GetRelationship(rel.GetName()).GetTargets():
                yield rel.GetPath(), targets
        for attr in prim.GetAuthoredAttributes():
            if not attr.HasAuthoredConnections():
                continue
            targets = attr.GetConnections()
            if targets and targets != twin.GetAttribute(attr.GetName()).GetConnections():
                yield attr.GetPath(), targets


def _instances_above(stage: Usd.Stage, path: Sdf.Path) -> list[Sdf.Path]:
    """Instances that make the prim of a property a proxy."""
    prim = stage.GetPrimAtPath(path.GetPrimPath())
    above = []
    while prim.IsInstanceProxy():
        prim = prim.GetParent()
        if prim.IsInstance():
            above.append(prim.GetPath())
    return above


@contextmanager
def _quiet() -> Iterator[None]:
    # USD warns on the terminal of each ignored target; they are found here and corrected
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    finally:
        delegate.TakeUncoalescedDiagnostics()
