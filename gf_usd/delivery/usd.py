"""A bake as a USD file of joints or blend shapes, over its source or in a package with it.

The root layer of the bake is kept, with the references to the source and all its variants, and a
variant for each baked material.  The payload of each, the cache, is replaced by the joints.  A bake
in one flattened file keeps its flattened content.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pxr import Ar, Sdf, Usd, UsdGeom, UsdUtils

from gf_usd.core import USD_SUFFIXES
from gf_usd.core.asset import COLLIDER_HASHES, COLLIDERS
from gf_usd.core.errors import UsageError
from gf_usd.delivery.skeleton import bind_meshes, skel_roots
from gf_usd.delivery.splats.usd import author_samples, keep_at_rest
from gf_usd.delivery.variants import BakedVariant
from gf_usd.layers.flatten import Package, export, write_placed
from gf_usd.readers.inputs import digest, layer_files
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.extent import is_ever_visible, sample_times
from gf_usd.readers.pictures.recording import select_variant, world_points
from gf_usd.readers.usd.mesh import has_surface
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.splats import is_captured
from gf_usd.readers.usd.stage import is_bake_scope, open_stage, reading
from gf_usd.system.atomic_files import same_place

VARIANTS, NONE = "gaussianFlesh", "none"

MOVING = ("points", "normals", "velocities", "accelerations", "extent")


def write_usd(
    bake: Path, target: Path, variants: Sequence[BakedVariant], error: float = 0.0
) -> tuple[str, ...]:
    """Write `target` under its partial name; returns notes as text.

    error : of positions of Gaussians, in radii.
    bake : root layer or flattened file.  target : .usdz becomes a package with all that the file
    needs, .usda and .usdc refer to the source and its textures by relative paths.

    Raises
    ------
    InputError : a mesh has no parent that could be a SkelRoot.
    BakeError : a file cannot be written.
    """
    with reading(bake):
        layer = _without_motion(bake, variants)
        stage = Usd.Stage.Open(layer, Usd.Stage.LoadAll)
        for variant in variants:
            _author(stage, variant, variants)
            _hide_left_out(stage, bake, variant)
            _author_splats(stage, bake, variant, error)
        return write_placed(layer, target, package=LayerPackage)


def error_of(target: Path, variant: BakedVariant) -> float:
    """The largest distance of a written file to its bake over points and frames, in radii.

    The points are evaluated by UsdSkel.
    """
    largest = 0.0
    with reading(target):
        stage = open_stage(target)
        select_variant(stage, target, variant.name or None)
        for frame, code in enumerate(variant.time_codes):
            time = Usd.TimeCode(code)
            xforms = UsdGeom.XformCache(time)
            skins = Skins(time, xforms, Notes())
            for rig in variant.rigs:
                for mesh in rig.body.meshes:
                    prim = stage.GetPrimAtPath(variant.meshes[mesh])
                    found = world_points(prim, time, xforms, skins) * variant.unit
                    off = found - rig.body.frames[frame, rig.body.points_of(mesh)]
                    distance = float(np.sqrt((off**2).sum(axis=1).max()))
                    largest = max(largest, distance / rig.body.radius)
    return largest


def require_no_layer_of_bake(bake: Path, *targets: Path) -> None:
    """Raise UsageError where a file that is to be written is one that a bake is composed of.

    Or where it has the contents of the asset that was baked, which need not be a layer: the bake of
    `duck.glb` lies over `duck.source.usdc`.
    """
    there = [target for target in targets if target.exists()]
    if not there or not bake.is_file():
        return
    with reading(bake):
        stage = open_stage(bake)  # holds its layers
        layers = stage.GetUsedLayers()
        read = [*(Path(layer.realPath) for layer in layers if layer.realPath), *layer_files(bake)]
        about = (layer.customLayerData.get(VARIANTS) for layer in layers)
        hashes = {data.get("inputHash") for data in about if isinstance(data, dict)}
    for target in there:
        if any(same_place(path, target) for path in read):
            raise UsageError(f"{target} is an input of the bake", "choose another -o")
        if target.is_file() and digest(target) in hashes:
            raise UsageError(f"{target} is the asset that was baked", "choose another -o")


def _without_motion(bake: Path, variants: Sequence[BakedVariant]) -> Sdf.Layer:
    """A copy of the root layer without caches and particles, its paths absolute."""
    stage = open_stage(bake)
    switches = [
        prim.GetName()
        for prim in stage.GetPseudoRoot().GetChildren()
        if prim.GetVariantSets().HasVariantSet(VARIANTS)
    ]
    if not switches:
        select_variant(stage, bake, variants[0].name or None)
        layer = stage.Flatten(addSourceFileComment=False)
        _drop_samples(layer, variants[0])
        return layer
    root = stage.GetRootLayer()
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(root)
    UsdUtils.ModifyAssetPaths(layer, lambda path: absolute(root, path))
    names = {variant.name for variant in variants}
    for name in switches:
        spec = layer.GetPrimAtPath(f"/{name}")
        authored = spec.variantSets[VARIANTS].variants
        for variant in list(authored.values()):
            if variant.name == NONE:
                continue
            if variant.name in names:
                _empty(variant.primSpec)
            else:
                spec.variantSets[VARIANTS].RemoveVariant(variant)
        spec.variantSelections[VARIANTS] = variants[0].name
        if not spec.referenceList.prependedItems and not spec.specializesList.prependedItems:
            del layer.rootPrims[name]  # held nothing but particles
    _tell(layer, names)
    return layer


def _tell(layer: Sdf.Layer, names: set[str]) -> None:
    """Keep only the metadata of the variants in `names`, without obstacle files."""
    data = layer.customLayerData
    about = dict(data.get(VARIANTS, {}))
    looks = about.get("looks", {})
    about["looks"] = {name: values for name, values in looks.items() if name in names}
    for name in (COLLIDERS, COLLIDER_HASHES):  # a delivery refers to no other files
        about.pop(name, None)
    layer.customLayerData = {**data, VARIANTS: about}


def _empty(spec: Sdf.PrimSpec) -> None:
    """Remove payload, particles, health and displays from a variant."""
    spec.ClearPayloadList()
    for child in list(spec.nameChildren):
        del spec.nameChildren[child.name]
    for prop in list(spec.properties):
        spec.RemoveProperty(prop)
    for name in [one.name for one in spec.variantSets.values()]:
        del spec.variantSets[name]
        spec.variantSelections.pop(name)
    spec.ClearInfo("variantSetNames")
    spec.ClearInfo("apiSchemas")


def _drop_samples(layer: Sdf.Layer, variant: BakedVariant) -> None:
    stage = Usd.Stage.Open(layer)
    scopes = [prim.GetPath() for prim in stage.TraverseAll() if is_bake_scope(prim)]
    del stage  # which would follow every change
    for path in scopes:
        parent = layer.GetPrimAtPath(path.GetParentPath()) or layer.pseudoRoot
        del parent.nameChildren[path.name]
    for name in {Sdf.Path(mesh).GetPrefixes()[0].name for mesh in variant.meshes}:
        spec = layer.GetPrimAtPath(f"/{name}")
        for prop in [p for p in spec.properties if p.name.startswith(f"{VARIANTS}:")]:
            spec.RemoveProperty(prop)
        for display in [
            one.name for one in spec.variantSets.values() if one.name.lower().endswith("display")
        ]:
            del spec.variantSets[display]
            spec.variantSelections.pop(display)
            spec.variantSetNameList.RemoveItemEdits(display)
    for mesh in (variant.meshes[i] for rig in variant.rigs for i in rig.body.meshes):
        for name in MOVING:
            attribute = layer.GetAttributeAtPath(Sdf.Path(mesh).AppendProperty(name))
            if attribute is None or not layer.GetNumTimeSamplesForPath(attribute.path):
                continue
            first = layer.ListTimeSamplesForPath(attribute.path)[0]
            if name in ("points", "normals"):
                attribute.default = layer.QueryTimeSample(attribute.path, first)
                attribute.ClearInfo("timeSamples")
            else:
                layer.GetPrimAtPath(mesh).RemoveProperty(attribute)


def _author(stage: Usd.Stage, variant: BakedVariant, variants: Sequence[BakedVariant]) -> None:
    """Author the rigs of one of the variants, which have their SkelRoots in common."""
    every = [tuple(one.meshes[m] for m in r.body.meshes) for one in variants for r in one.rigs]
    roots = {
        str(Sdf.Path(variant.meshes[m]).GetPrefixes()[0])
        for r in variant.rigs
        for m in r.body.meshes
    }
    for path in sorted(roots):
        rigs = [r for r in variant.rigs if variant.meshes[r.body.meshes[0]].startswith(f"{path}/")]
        rigs = rigs or [r for r in variant.rigs if variant.meshes[r.body.meshes[0]] == path]
        with _variant_of(stage.GetPrimAtPath(path), variant.name):
            for mesh in (m for rig in rigs for m in rig.body.meshes):
                _end_instances(stage, variant.meshes[mesh])
            below = [body for body in every if Sdf.Path(body[0]).HasPrefix(path)]
            homes = skel_roots(stage, below)
            for home in dict.fromkeys(homes.values()):
                mine = [r for r in rigs if homes[variant.meshes[r.body.meshes[0]]] == home]
                if mine:
                    bind_meshes(
                        stage, mine, variant.meshes, variant.triangles, variant.time_codes,
                        variant.unit, stage.GetPrimAtPath(home),
                    )  # fmt: skip


def _hide_left_out(stage: Usd.Stage, bake: Path, variant: BakedVariant) -> None:
    """Hide meshes that particles or a surface replace in the bake, since they would be shown at
    rest.

    The bake hides them by its displays and its caches, which the file does not contain.
    """
    source = open_stage(bake)
    select_variant(source, bake, variant.name or None)
    for root in source.GetPseudoRoot().GetChildren():
        if target := stage.GetPrimAtPath(root.GetPath()):
            # selected before visibility is read: other variants hide other meshes
            with _variant_of(target, variant.name):
                _hide_left_out_below(root, stage, variant)


def _hide_left_out_below(root: Usd.Prim, stage: Usd.Stage, variant: BakedVariant) -> None:
    start = Usd.TimeCode(variant.time_codes[0])
    for there in Usd.PrimRange(root, Usd.TraverseInstanceProxies()):
        prim = stage.GetPrimAtPath(there.GetPath())
        if not has_surface(there) or not prim or not is_ever_visible(prim, start):
            continue
        if str(there.GetPath()) in variant.left_out or not is_ever_visible(there, start):
            _end_instances(stage, str(there.GetPath()))
            visibility = UsdGeom.Imageable(stage.GetPrimAtPath(there.GetPath()))
            visibility.GetVisibilityAttr().Clear()  # of samples, which a default is weaker than
            visibility.GetVisibilityAttr().Set(UsdGeom.Tokens.invisible)


def _author_splats(stage: Usd.Stage, bake: Path, variant: BakedVariant, error: float) -> None:
    """The captured Gaussians of a variant; those that are not delivered stay at rest."""
    source = open_stage(bake)
    select_variant(source, bake, variant.name or None)
    for prim in [one for one in source.Traverse() if is_captured(one)]:
        radius = {c.name: r for c, r in zip(variant.clouds, variant.radii)}.get(str(prim.GetPath()))
        root = stage.GetPrimAtPath(prim.GetPath().GetPrefixes()[0])
        with _variant_of(root, variant.name):
            _end_instances(stage, str(prim.GetPath()))
            target = stage.GetPrimAtPath(prim.GetPath())
            if radius is None:
                if not root.GetVariantSets().HasVariantSet(VARIANTS):
                    keep_at_rest(target)
                continue
            if not sample_times([prim]):
                continue  # the bake left it at rest
            author_samples(target, prim, variant.time_codes, error * radius / variant.unit)


def _end_instances(stage: Usd.Stage, path: str) -> None:
    """End every instance above a prim, which the bake ended in its cache.

    From the outermost inward, because prims inside an instance cannot be changed before.
    """
    for above in Sdf.Path(path).GetPrefixes():
        prim = stage.GetPrimAtPath(above)
        if prim.IsInstance():
            prim.SetInstanceable(False)


@contextmanager
def _variant_of(root: Usd.Prim, name: str) -> Iterator[None]:
    """Edits go to a variant of a root prim that has variants of a bake."""
    sets = root.GetVariantSets()
    if not sets.HasVariantSet(VARIANTS):
        yield
        return
    chosen = sets.GetVariantSet(VARIANTS)
    before = chosen.GetVariantSelection()
    chosen.SetVariantSelection(name)
    with chosen.GetVariantEditContext():
        yield
    chosen.SetVariantSelection(before)


def absolute(layer: Sdf.Layer, path: str) -> str:
    """A path of a layer as an absolute path; a URI is unchanged."""
    if not path or re.match(r"\w[\w.+-]+:", path):
        return path
    return layer.ComputeAbsolutePath(path)


class LayerPackage(Package):
    """A package that also contains layers, as crates, whose paths are changed.

    All files are in one folder, so that a path is the same in each of them.
    """

    def __init__(self, scratch: Path) -> None:
        super().__init__(scratch)
        self._layers: dict[str, str] = {}  # layer -> name in the package

    def _name(self, file: Path) -> str:
        number = self._numbers.setdefault(file, len(self._numbers))
        return f"{number}_{file.name}"

    def _placed(self, file: Path, inner: str) -> str:
        path = Ar.JoinPackageRelativePath(str(file), inner) if inner else str(file)
        last = Path(Ar.SplitPackageRelativePathInner(path)[1] if inner else file)
        if last.suffix.lower() in USD_SUFFIXES:
            return f"./{self._layer(file, path, last)}"
        return f"./{super()._placed(file, inner)}"

    def _layer(self, file: Path, key: str, last: Path) -> str:
        """The name of a layer in the package, which is put there.

        key : its path; file : of the outermost package, or of the layer; last : its own file name.
        """
        if key in self._layers:
            return self._layers[key]
        if not file.exists():
            return last.name  # it does not compose in the bake either, which is noted there
        source = Sdf.Layer.FindOrOpen(key)
        if source is None:
            self.notes[f"{key} could not be opened: it is not in the package"] = None
            return last.name
        name = f"layer{len(self._layers)}_{last.stem}.usdc"
        self._layers[key] = name
        copy = Sdf.Layer.CreateAnonymous(".usda")
        copy.TransferContent(source)
        UsdUtils.ModifyAssetPaths(copy, lambda path: self.place(absolute(source, path)))
        made = self._scratch / name
        export(copy, made)
        self._files[name] = made
        return name
