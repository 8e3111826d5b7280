"""The root layer: a drop-in replacement for the asset, with the bakes as variants.

    def "duck" (references = the source's </duck>)
        variantSet gaussianFlesh = {none, rubber, ...}
            rubber (payload = the cache's </duck>)
                variantSet display = {mesh, gaussians, points}

Every root prim of the source is referenced under its own name.  Type, kind, assetInfo and all other
opinions come through that reference, so that ``none`` is the source.  A variant is stronger than a
reference: the payload inside it overrides the source, and without loaded payloads the source is
visible.

Root prims that others inherit from are an exception.  If ``</duck/wing>`` inherits from
``</_wing>``, USD looks for ``</_wing>`` in every layer above as well.  If it were referenced there
directly, its opinions would be those of an inherit, which are stronger than a variant's, and the
points of the source would override the baked ones.  A specialize is the weakest arc:

    class "_gaussianFleshSource"
        class "_wing" (references = the source's </_wing>)
    class "_wing" (specializes = </_gaussianFleshSource/_wing>)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pxr import Pcp, Sdf, Usd, Vt

from gf_usd.core.asset import COLLIDER_HASHES, COLLIDERS, Asset
from gf_usd.core.frames.choices import SOURCE_VARIANT, Choices
from gf_usd.core.frames.settings import Settings
from gf_usd.layers.retarget import repeat_edits, restore_rest
from gf_usd.layers.stage import (
    VARIANT_SET,
    Home,
    author_facts,
    clock,
    find_home,
    new_layer,
    open_source,
    refresh,
    roots_of,
    save,
    to_metadata,
)
from gf_usd.layers.variants import (
    DISPLAY_SET,
    BakedVariant,
    add_variants,
    check_variants,
    free_display_set,
)
from gf_usd.system import usd_schema  # noqa: F401  (registers the schema before a stage is opened)
from gf_usd.system.atomic_files import (
    absolute_note,
    asset_path,
    dropped_on_failure,
    partial_path,
    publish,
)

# metadata of the source that is not copied to the root layer
OWN = {
    *("subLayers", "subLayerOffsets", "layerRelocates", "expressionVariables", "primChildren"),
    *("primOrder", "hasOwnedSubLayers", "owner", "customLayerData", "defaultPrim", "upAxis"),
    *("metersPerUnit", "timeCodesPerSecond", "framesPerSecond", "startTimeCode", "endTimeCode"),
    *("startFrame", "endFrame"),
}


@dataclass(frozen=True, kw_only=True)
class RootSummary:
    """A root layer."""

    path: Path
    default_prim: str  # name
    switches: tuple[str, ...]  # prims with the variant set
    display_set: str  # name of the nested variant set
    retargeted: int  # properties with targets outside their root prim
    notes: tuple[str, ...] = ()  # notes on changes and losses


def write_root(
    path: Path,
    asset: Asset,
    bakes: Sequence[BakedVariant],
    *,
    source: Path | None = None,
    display: str | None = None,
    choices: Choices | None = None,
    partial: bool = False,
) -> RootSummary:
    """Write and publish the root layer; the first bake is selected.

    Parameters
    ----------
    path : for example ``duck.rubber.usda``.
    asset : what was baked.
    bakes : one for each variant, with the names of their caches.
    source : the USD file to reference; default the asset's own.
    display : selected in every bake; default the first shape there is.
    choices : those of the caches; default all shapes.
    partial : leave it under its partial name, as the root layer of a bake that failed.

    Raises
    ------
    UsageError : no bakes, an unknown display, or variant names that do not do.
    InputError, BakeError : see ``open_source``, ``new_layer`` and ``publish``.
    """
    path = Path(path)
    choices = choices or Choices()
    display = display or choices.shapes[0]
    check_variants(bakes, display, choices)
    source_path = source or asset.facts.path
    stage = open_source(source_path)
    home = find_home(stage, asset, choices)
    layer = new_layer(path, source_path)
    with dropped_on_failure(path):
        files = _author_metadata(layer, stage, asset, home, bakes, settled=choices.settled)
        reference_roots(layer, stage, asset, asset_path(source_path, path.parent))
        display_set = free_display_set(stage, asset, home)
        switches = roots_of(asset, home)
        for root in switches:
            add_variants(layer, root, asset, home, bakes, display_set, display, choices)
        skinned = [s.path for s in asset.surfaces if s.skinned and choices.drawn(s.path)]
        unskinned = frozenset(map(Sdf.Path, skinned))
        retargeted = repeat_edits(stage, layer, unskinned)
        notes = _restore(stage, layer, switches)
        if display_set != DISPLAY_SET:
            notes = (
                *notes,
                f"the asset already has a variant set {DISPLAY_SET!r}: that of gf-usd is named"
                f" {display_set!r}",
            )
        if not partial:
            notes = (*notes, *absolute_note(path, [source_path, *files]))
        save(layer)
        del layer
        if not partial:
            publish(path)
            refresh(path)
    return RootSummary(
        path=partial_path(path) if partial else path,
        default_prim=home.root.name,
        switches=tuple(str(root) for root in switches),
        display_set=display_set,
        retargeted=retargeted,
        notes=notes,
    )


def _author_metadata(
    layer: Sdf.Layer,
    stage: Usd.Stage,
    asset: Asset,
    home: Home,
    bakes: Sequence[BakedVariant],
    *,
    settled: bool,
) -> list[Path]:
    """Author the metadata of the layer; returns the files to which it refers."""
    files: list[Path] = []
    theirs = stage.GetRootLayer()
    for key in set(theirs.pseudoRoot.ListInfoKeys()) - OWN:
        value = theirs.pseudoRoot.GetInfo(key)
        if isinstance(value, Sdf.AssetPath) and value.path.startswith("."):
            file = Path(theirs.ComputeAbsolutePath(value.path))
            value = Sdf.AssetPath(asset_path(file, Path(layer.realPath).parent))
            files.append(file)
        layer.pseudoRoot.SetInfo(key, value)
    settings = bakes[0].info.settings
    author_facts(layer, asset.facts, settings, stage)
    layer.defaultPrim = home.root.name
    times = [clock(stage, bake.info.settings) for bake in bakes]
    scale = times[0].rate / times[0].source_rate
    starts, ends = [t.start for t in times], [t.end for t in times]
    if theirs.HasStartTimeCode():
        starts.append(theirs.startTimeCode * scale)
    if theirs.HasEndTimeCode():
        ends.append(theirs.endTimeCode * scale)
    if not settled:
        layer.startTimeCode, layer.endTimeCode = min(starts), max(ends)
    layer.customLayerData = {
        **theirs.customLayerData,
        VARIANT_SET: {
            "command": bakes[0].info.command,
            "version": bakes[0].info.version,
            "inputHash": bakes[0].info.input_hash,
            **_collider_metadata(bakes[0].info.colliders, Path(layer.realPath).parent),
            "looks": {bake.name: _bake_metadata(bake) for bake in bakes},
        },
    }
    return files


def _collider_metadata(colliders: Mapping[Path, str], folder: Path) -> dict[str, object]:
    """The obstacle files as paths from the folder of the layer; nothing where there are none."""
    if not colliders:
        return {}
    return {
        COLLIDERS: Vt.StringArray([asset_path(file, folder) for file in colliders]),
        COLLIDER_HASHES: Vt.StringArray(list(colliders.values())),
    }


def _metadata_settings(settings: Settings) -> dict[str, object]:
    """The settings as metadata, with fields by number: metadata has no list of dictionaries."""
    values = asdict(settings)
    if fields := values.pop("fields"):
        each = [{**f, "values": [g for one in f["values"] for g in one]} for f in fields]
        values["fields"] = {
            str(k): {name: value for name, value in one.items() if value not in ((), [])}
            for k, one in enumerate(each)
        }
    return values


def _bake_metadata(bake: BakedVariant) -> dict[str, object]:
    materials = {f"{i}": to_metadata(m.values) for i, m in enumerate(bake.info.materials)}
    return {
        "materials": materials,
        "settings": to_metadata(_metadata_settings(bake.info.settings)),
        "health": to_metadata(bake.health),
        **({"warnings": to_metadata(bake.warnings)} if bake.warnings else {}),
        **({"failure": bake.failure} if bake.failure else {}),
        **({"storage": _storage_metadata(bake.storage)} if bake.storage else {}),
    }


def _storage_metadata(storage: Mapping[str, Any]) -> object:
    """The saved space in total, without the samples of each prim."""
    return to_metadata({key: value for key, value in storage.items() if key != "samples"})


def _restore(stage: Usd.Stage, layer: Sdf.Layer, switches: Sequence[Sdf.Path]) -> tuple[str, ...]:
    session = Sdf.Layer.CreateAnonymous(".usda")
    for root in switches:
        Sdf.CreatePrimInLayer(session, root).variantSelections[VARIANT_SET] = SOURCE_VARIANT
    return restore_rest(stage, Usd.Stage.Open(layer, session, load=Usd.Stage.LoadAll))


HOLDER = "_gaussianFleshSource"
CLASSES = (Pcp.ArcTypeInherit, Pcp.ArcTypeSpecialize)


def reference_roots(layer: Sdf.Layer, source: Usd.Stage, asset: Asset, reference: str) -> None:
    """Reference every root prim of the source in ``layer``.

    reference : the path of the source in the layer.
    """
    inherited = _inherited(source, asset)
    pin_constraint = _holder(layer, source) if inherited else None
    for prim in source.GetPseudoRoot().GetAllChildren():
        name = prim.GetName()
        spec = Sdf.PrimSpec(layer.pseudoRoot, name, prim.GetSpecifier())
        if pin_constraint is not None and name in inherited:
            spec.specializesList.prependedItems = [pin_constraint.path.AppendChild(name)]
            spec = Sdf.PrimSpec(pin_constraint, name, prim.GetSpecifier())
        spec.referenceList.prependedItems = [Sdf.Reference(reference, prim.GetPath())]


def _inherited(source: Usd.Stage, asset: Asset) -> set[str]:
    """Names of the root prims that a surface in another root prim inherits from.

    The index of a prim in an instance lacks the arcs of what is above the instance, so that those
    of all ancestors are read.
    """
    found = set()
    for path in {
        prefix for surface in asset.surfaces for prefix in Sdf.Path(surface.path).GetPrefixes()
    }:
        own = path.GetPrefixes()[0].name
        query = Usd.PrimCompositionQuery(source.GetPrimAtPath(path))
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
