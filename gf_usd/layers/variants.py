"""The variant sets of the root layer: the choice of the bake and, nested in each, of its visible
shapes.

A variant set acts on its own prim only.  A source with one root prim above its meshes has one.
Several root prims with meshes have one each, which are switched separately; so has the scope of the
particles next to a root prim that is itself a mesh.  The display sets are nested because two
independent sets could select nothing visible (none + gaussians).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd

from gf_usd.core.asset import Asset
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.choices import SOURCE_VARIANT as NONE
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import BakeInfo
from gf_usd.layers.stage import VARIANT_SET, Home, roots_of
from gf_usd.layers.tracks.flows import flow_name
from gf_usd.layers.tracks.health import author_certificate, author_totals, bake_root
from gf_usd.layers.tracks.particles import FLOW
from gf_usd.system.atomic_files import asset_path

DISPLAY_SET = "display"
PARTICLES = {"gaussians": "Gaussians", "points": "Points"}  # shape -> prim in the scope


@dataclass(frozen=True, kw_only=True)
class BakedVariant:
    """One variant of the root layer."""

    name: str  # of the variant, e.g. "rubber"
    cache: Path  # final name of its cache layer, which may not exist yet
    info: BakeInfo
    health: Mapping[str, object] = field(default_factory=dict)  # `HealthLog.summary`
    warnings: tuple[str, ...] = ()  # health warnings, as text
    failure: str = ""  # why it ended before its last frame; "" where it did not
    certificate: Mapping[str, Any] | None = None  # intervals of figures; None: not requested
    storage: Mapping[str, Any] | None = None  # the saved space; None: not requested


def check_variants(bakes: Sequence[BakedVariant], display: str, choices: Choices) -> None:
    """Raise UsageError for no bakes, an unknown display, or names that cannot be variants."""
    if not bakes:
        raise UsageError(
            "there is no bake for which a root layer could be written", "give a --material"
        )
    if display not in choices.shapes:
        shown = ", ".join(choices.shapes)
        raise UsageError(f"unknown display {display!r}", f"choose one of: {shown}")
    names = [bake.name for bake in bakes]
    for name in names:
        if not name or not Sdf.Path.IsValidPathString(f"/x{{v={name}}}")[0]:
            raise UsageError(
                f"{name!r} cannot be the name of a variant", "use letters, digits, _ and -"
            )
        if name == NONE or names.count(name) > 1:
            raise UsageError(
                f"the variant name {name!r} is taken", "give each variant a different name"
            )


def free_display_set(stage: Usd.Stage, asset: Asset, home: Home) -> str:
    """``display``, or a longer name where a root prim of the source has a variant set of that
    name.
    """
    # variant sets of one name on one prim share their selection
    prims = [p for p in (stage.GetPrimAtPath(r) for r in roots_of(asset, home)) if p]
    name = DISPLAY_SET
    while any(prim.GetVariantSets().HasVariantSet(name) for prim in prims):
        name = f"{VARIANT_SET}{name[0].upper()}{name[1:]}"
    return name


def add_variants(
    layer: Sdf.Layer,
    root: Sdf.Path,
    asset: Asset,
    home: Home,
    bakes: Sequence[BakedVariant],
    display_set: str,
    display: str,
    choices: Choices,
) -> None:
    """Give one root prim of the layer the variants none and one for each bake.

    Parameters
    ----------
    layer : the root layer, in its final folder.
    root : one of ``roots_of(asset, home)``.
    display_set, display : name of the nested set and what is selected in it.
    choices : the shapes that the caches hold; each has a variant.
    """
    spec = layer.GetPrimAtPath(root)
    if spec is None:
        # next to a root prim that is a mesh; defined by the payload alone, so absent under none
        spec = Sdf.PrimSpec(layer.pseudoRoot, root.name, Sdf.SpecifierOver)
    spec.variantSetNameList.prependedItems = [VARIANT_SET]
    spec.variantSelections[VARIANT_SET] = bakes[0].name
    switch = Sdf.VariantSetSpec(spec, VARIANT_SET)
    Sdf.VariantSpec(switch, NONE)
    folder = Path(layer.realPath).parent
    for bake in bakes:
        variant = Sdf.VariantSpec(switch, bake.name).primSpec
        payload = Sdf.Payload(asset_path(bake.cache, folder), root)
        variant.payloadList.prependedItems = [payload]
        variant.variantSetNameList.prependedItems = [display_set]
        variant.variantSelections[display_set] = display
        modes = Sdf.VariantSetSpec(variant, display_set)
        for mode in choices.shapes:
            inner = Sdf.VariantSpec(modes, mode).primSpec
            for path in hidden(mode, root, asset, home, choices):
                _hide(layer, inner.path.AppendPath(path.MakeRelativePath(root)))
        if bake_root(asset, home) == root:
            author_totals(variant, bake.health, asset.facts.units, bake.warnings, bake.failure)
            if bake.certificate is not None:
                author_certificate(variant, bake.certificate, asset.facts.units)
        if choices.particles and home.scope.HasPrefix(root):
            _name_meshes(layer, variant.path, root, asset, home, choices)


def hidden(mode: str, root: Sdf.Path, asset: Asset, home: Home, choices: Choices) -> list[Sdf.Path]:
    """Prims under a root prim that a display mode hides; meshes also where they do not move."""
    drawn = mode == "mesh"
    paths = [
        Sdf.Path(one.path) for one in asset.surfaces if not drawn or one.path in choices.flowing
    ]
    stand_ins = [home.scope.AppendChild(flow_name(body)) for body in choices.flows]
    if choices.mesh and choices.replaced and not stand_ins:
        stand_ins = [home.scope.AppendChild(FLOW)]
    if drawn and choices.particles and not stand_ins:
        paths.append(home.scope)
    for shape, name in PARTICLES.items():
        if mode != shape and shape in choices.shapes and (stand_ins or not drawn):
            paths.append(home.scope.AppendChild(name))
    if not drawn:
        paths += stand_ins
    return [path for path in paths if path.HasPrefix(root)]


def _hide(layer: Sdf.Layer, path: Sdf.Path) -> None:
    prim = Sdf.CreatePrimInLayer(layer, path)
    Sdf.AttributeSpec(prim, "visibility", Sdf.ValueTypeNames.Token).default = "invisible"


def _name_meshes(
    layer: Sdf.Layer,
    variant: Sdf.Path,
    root: Sdf.Path,
    asset: Asset,
    home: Home,
    choices: Choices,
) -> None:
    # a payload cannot refer to prims outside its root prim, the root layer can
    meshes = [Sdf.Path(surface.path) for surface in asset.surfaces]
    if all(mesh.HasPrefix(root) for mesh in meshes):
        return
    for shape, name in PARTICLES.items():
        if shape not in choices.shapes:
            continue
        path = home.scope.AppendChild(name).MakeRelativePath(root)
        prim = Sdf.CreatePrimInLayer(layer, variant.AppendPath(path))
        rel = Sdf.RelationshipSpec(prim, "gaussianFlesh:sourceMeshes", False)
        rel.targetPathList.explicitItems = meshes
