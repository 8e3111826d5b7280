"""Writes a bake at another speed: a root layer like its own, over resampled caches.

Nothing is simulated.  The animation of the source, such as that of a character or an obstacle, is
retimed with the bodies: for a constant speed by a layer offset on the references to the source, for
keys (several speeds) by samples in the root layer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdUtils, Vt

from gf_usd.core import CACHE_SUFFIX
from gf_usd.core.asset import COLLIDERS
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.units import code_text
from gf_usd.delivery.resample import SAME, Warp, most_samples, resample, sample_as_played
from gf_usd.delivery.usd import VARIANTS, absolute, require_no_layer_of_bake
from gf_usd.layers.flatten import export, write_placed
from gf_usd.readers.usd.stage import open_stage, reading
from gf_usd.system.atomic_files import asset_path, partial_path, publish

SUFFIXES = (".usda", ".usdc", ".usd")
MOST_FRAMES = 100_000


@dataclass(frozen=True, kw_only=True)
class Retimed:
    """A retimed bake."""

    path: Path  # root layer
    caches: tuple[Path, ...]  # one per variant
    frames: int  # samples of the longest
    start: float  # time code of the first frame
    end: float  # time code of the last
    notes: tuple[str, ...] = ()  # missing files, and prims that keep their speed, as text


def retime(
    bake: Path,
    target: Path,
    *,
    speed: float | None = None,
    keys: Sequence[tuple[float, float]] | None = None,
) -> Retimed:
    """Write a bake at another speed; see `gf_usd.retime`.

    speed : times as fast.  keys : (time code of the result, time code of the bake).

    Raises
    ------
    UsageError : not one of speed and keys, values that make no sense, or a target that is an input.
    InputError : the file cannot be read, or is no root layer of a bake with caches.
    BakeError : a file cannot be written.
    """
    keys = None if keys is None else tuple(keys)
    _require(target, speed, keys)
    if not bake.is_file():
        what = "is a folder" if bake.is_dir() else "does not exist"
        raise InputError(f"{bake} {what}", "give the root layer of a bake")
    with reading(bake):
        root = open_stage(bake).GetRootLayer()
        caches = _caches(root, bake)
        made = {cache: _named(target, name, len(caches)) for name, cache in caches.items()}
        require_no_layer_of_bake(bake, target, *made.values())
        if keys is not None:
            _require_no_samples_in_other_variants(root, bake)
        try:
            codes = [_retimed(cache, new, speed, keys) for cache, new in made.items()]
            span = min(each[0] for each in codes), max(each[-1] for each in codes)
            layer = _root(root, target, made, speed, keys, span)
            notes = ()
            if keys is not None:
                notes = _retime_source(layer, bake, caches, keys, max(codes, key=len))
            notes = (*notes, *write_placed(layer, target))
            for path in (*made.values(), target):
                publish(path)
        finally:
            for path in (*made.values(), target):
                partial_path(path).unlink(missing_ok=True)
    return Retimed(
        path=target,
        caches=tuple(made.values()),
        frames=max(len(each) for each in codes),
        start=span[0],
        end=span[1],
        notes=notes,
    )


def _require(
    target: Path, speed: float | None, keys: tuple[tuple[float, float], ...] | None
) -> None:
    if (speed is None) == (keys is None):
        raise UsageError(
            "either --speed or --keys is needed, but not both",
            "--speed 0.5 plays at half the speed; --keys 1:1,48:24,60:48 changes the speed "
            "along the way",
        )
    if speed is not None and not (np.isfinite(speed) and 1e-3 <= speed <= 1e3):
        raise UsageError(f"--speed is {speed:g}", "give a number from 0.001 to 1000, such as 0.5")
    if keys is not None:
        out = [key[0] for key in keys]
        if len(keys) < 2 or not np.isfinite(keys).all() or not (np.diff(out) > 0.0).all():
            raise UsageError(
                "--keys is " + ",".join(f"{a:g}:{b:g}" for a, b in keys),
                "give at least two pairs NEW:OLD of time codes, with NEW increasing: 1:1,48:24",
            )
    if target.suffix.lower() not in SUFFIXES:
        raise UsageError(
            f"{target} does not end in {', '.join(SUFFIXES)}",
            "the output is the root layer of a bake: -o slow.usda",
        )
    if not target.parent.is_dir():
        raise UsageError(f"{target.parent} is not a folder", "choose a folder that exists, with -o")
    if target.is_dir():
        raise UsageError(f"{target} is a folder", "name the file: -o slow.usda")


def _switches(root: Sdf.Layer) -> Iterator[Sdf.VariantSpec]:
    """The variants of the bake, of each root prim."""
    for prim in root.rootPrims:
        found = prim.variantSets.get(VARIANTS)
        yield from found.variants.values() if found else ()


def _payloads(variant: Sdf.VariantSpec) -> list[Sdf.Payload]:
    return list(variant.primSpec.payloadList.GetAddedOrExplicitItems())


def _caches(root: Sdf.Layer, bake: Path) -> dict[str, Path]:
    """The cache of each variant."""
    found = {
        variant.name: Path(root.ComputeAbsolutePath(payload.assetPath))
        for variant in _switches(root)
        for payload in _payloads(variant)
    }
    if not found:
        raise InputError(
            f"{bake}: it has no caches to retime",
            "give the root layer of a bake that was not flattened, and flatten the result",
        )
    for cache in found.values():
        if not cache.is_file():
            raise InputError(
                f"{bake}: its cache {cache} does not exist",
                "move the root layer, the cache and the asset of a bake together",
            )
    return found


def _named(target: Path, variant: str, several: int) -> Path:
    """slow.usda -> slow.cache.usdc, or slow.rubber.cache.usdc of several variants."""
    middle = f".{variant}" if several > 1 else ""
    return target.with_name(f"{target.stem}{middle}{CACHE_SUFFIX}")


def _retimed(
    cache: Path,
    target: Path,
    speed: float | None,
    keys: tuple[tuple[float, float], ...] | None,
) -> list[float]:
    """Write a cache under its partial name; returns its time codes."""
    with reading(cache):
        stage = open_stage(cache)
    times = np.array(_times(stage, cache))
    first, last = float(times[0]), float(times[-1])
    if keys is None:
        assert speed is not None
        keys = ((first, first), (first + (last - first) / speed, last))
    else:
        _require_within(keys, first, last, cache)
    step = float(np.median(np.diff(times)))
    count = int((keys[-1][0] - keys[0][0]) / step + SAME) + 1
    if count > MOST_FRAMES:
        raise UsageError(
            f"{count} samples were requested, but the limit is {MOST_FRAMES}",
            "choose a higher --speed, or retime a part with --keys",
        )
    codes = [keys[0][0] + k * step for k in range(count)]
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    UsdUtils.ModifyAssetPaths(layer, lambda path: absolute(stage.GetRootLayer(), path))
    for prim in layer.rootPrims:
        prim.ClearInfo("clips")  # value clips: their samples go into the one file
    layer.customLayerData = {k: v for k, v in layer.customLayerData.items() if k != VARIANTS}
    resample(stage, layer, Warp(keys), codes)
    layer.startTimeCode, layer.endTimeCode = codes[0], codes[-1]
    export(layer, partial_path(target))
    return codes


def _times(stage: Usd.Stage, cache: Path) -> list[float]:
    """Time codes of the samples, those of the attribute that has most."""
    most = most_samples(stage)
    if len(most) < 2:
        raise InputError(
            f"{cache}: it has {len(most)} time samples and no motion to retime",
            "give a bake of more than one frame",
        )
    return most


def _require_within(
    keys: Sequence[tuple[float, float]], first: float, last: float, cache: Path
) -> None:
    for out, source in keys:
        if not first - SAME <= source <= last + SAME:
            raise UsageError(
                f"--keys {code_text(out)}:{code_text(source)} is outside the time codes"
                f" {code_text(first)} to {code_text(last)} of {cache}",
                "in NEW:OLD, NEW is a time code of the result and OLD one of the bake",
            )


def _retime_source(
    layer: Sdf.Layer,
    bake: Path,
    caches: Mapping[str, Path],
    keys: tuple[tuple[float, float], ...],
    codes: Sequence[float],
) -> tuple[str, ...]:
    """Sample the animation of the source in a root layer, at the times of the result; returns
    notes.

    A layer offset on the references has one speed only, and keys have several.  Attributes that a
    cache replaces are sampled inside the variants without that cache: outside, they would also
    override the cache.
    """
    stage, warp = open_stage(bake), Warp(keys)
    baked = {variant: _in_cache(cache) for variant, cache in caches.items()}
    own = set(_animated(layer))
    held = {path for path in own if path.ContainsPrimVariantSelection()}
    apart = {path.StripAllVariantSelections() for path in held}.union(*baked.values()) - own
    written: set[Sdf.Path] = set()
    inside: dict[str, list[str]] = {}  # variants in which it is
    stage.SetEditTarget(stage.GetSessionLayer())
    variants = tuple(dict.fromkeys(variant.name for variant in _switches(layer)))
    for variant in variants:
        for root in stage.GetPseudoRoot().GetChildren():
            if root.GetVariantSets().HasVariantSet(VARIANTS):
                root.GetVariantSet(VARIANTS).SetVariantSelection(variant)
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
            for attribute in prim.GetAuthoredAttributes():
                path = attribute.GetPath()
                if path in apart:
                    retimed = path in baked.get(variant, ())
                    path = _in_variant(layer, path, variant)
                    if path is None or (retimed and path not in held):
                        continue
                if path in written and not prim.IsInstanceProxy():
                    continue
                if not attribute.ValueMightBeTimeVarying():  # by samples, or by a spline
                    continue
                if prim.IsInstanceProxy():
                    among = inside.setdefault(str(prim.GetPath()), [])
                    among += [variant] if variant not in among else []
                    continue
                sample_as_played(layer, path, attribute, warp, codes)
                written.add(path)
    return tuple(
        f"<{path}>: {_where(among, variants)}its animation is inside an instance, where --keys"
        " cannot retime it; --speed can"
        for path, among in inside.items()
    )


def _where(among: Sequence[str], variants: Sequence[str]) -> str:
    """Text on the variants that have it; "" for all of them."""
    if len(among) == len(variants):
        return ""
    return f"in the variant{'s' if len(among) > 1 else ''} {', '.join(among)} "


def _in_variant(layer: Sdf.Layer, path: Sdf.Path, variant: str) -> Sdf.Path | None:
    """The path of an attribute inside a variant of the bake; None where its root lacks that one."""
    root = path.GetPrefixes()[0]
    inner = root.AppendVariantSelection(VARIANTS, variant)
    if layer.GetObjectAtPath(inner):
        return path.ReplacePrefix(root, inner)
    spec = layer.GetPrimAtPath(root)
    return None if spec and spec.variantSets.get(VARIANTS) else path


def _in_cache(cache: Path) -> set[Sdf.Path]:
    """Paths of the attributes that a cache has, also of those whose samples are in value clips."""
    stage = open_stage(cache)
    found = set(_paths(stage.GetRootLayer()))
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.PrimAllPrimsPredicate):
        found.update(attribute.GetPath() for attribute in prim.GetAuthoredAttributes())
    return found


def _require_no_samples_in_other_variants(root: Sdf.Layer, bake: Path) -> None:
    """Raise InputError where the root layer itself has samples in variants not of the bake."""
    for path in _animated(root):
        inner = [one for one in path.GetPrefixes() if one.IsPrimVariantSelectionPath()]
        if any(one.GetVariantSelection()[0] != VARIANTS for one in inner):
            raise InputError(
                f"{bake}: <{path}> is animated but not baked, and --keys cannot retime it",
                "use --speed, which changes the speed of everything",
            )


def _paths(layer: Sdf.Layer) -> list[Sdf.Path]:
    found: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, found.append)
    return sorted(found)


def _sampled(layer: Sdf.Layer) -> list[Sdf.Path]:
    """The attributes of a layer that have time samples in it."""
    return [path for path in _paths(layer) if layer.GetNumTimeSamplesForPath(path)]


def _animated(layer: Sdf.Layer) -> list[Sdf.Path]:
    """The attributes of a layer that have time samples or a spline in it."""
    attributes = (layer.GetAttributeAtPath(path) for path in _paths(layer))
    return [
        one.path
        for one in attributes
        if one and (layer.GetNumTimeSamplesForPath(one.path) or one.HasInfo("spline"))
    ]


def _root(
    root: Sdf.Layer,
    target: Path,
    caches: Mapping[Path, Path],
    speed: float | None,
    keys: Sequence[tuple[float, float]] | None,
    span: tuple[float, float],
) -> Sdf.Layer:
    """The root layer over other caches, its asset paths absolute, for a target."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(root)

    def place(path: str) -> str:
        found = absolute(root, path)
        return str(caches.get(Path(found), found)) if path else path

    UsdUtils.ModifyAssetPaths(layer, place)
    start, end = root.startTimeCode, root.endTimeCode
    if speed is not None:
        offset = Sdf.LayerOffset(start * (1.0 - 1.0 / speed), 1.0 / speed)
        for prim in layer.rootPrims:
            _offset(prim, offset)
        for path in _sampled(layer):
            samples = {
                c: layer.QueryTimeSample(path, c) for c in layer.ListTimeSamplesForPath(path)
            }
            for code in samples:
                layer.EraseTimeSample(path, code)
            for code, value in samples.items():
                layer.SetTimeSample(path, offset * code, value)
        end = start + (end - start) / speed
        layer.startTimeCode, layer.endTimeCode = min(start, span[0]), max(end, span[1])
    else:
        layer.startTimeCode, layer.endTimeCode = span
    data: dict[str, Any] = dict(layer.customLayerData)
    timing = {"speed": speed} if speed is not None else {"keys": _text(keys or ())}
    about: dict[str, Any] = {**data.get(VARIANTS, {}), "retime": timing}
    if COLLIDERS in about:
        files = [Path(absolute(root, str(name))) for name in about[COLLIDERS]]
        about[COLLIDERS] = Vt.StringArray([asset_path(file, target.parent) for file in files])
    data[VARIANTS] = about
    layer.customLayerData = data
    return layer


def _offset(prim: Sdf.PrimSpec, offset: Sdf.LayerOffset) -> None:
    """Retime the references of a prim and its children."""
    items = [
        Sdf.Reference(one.assetPath, one.primPath, offset * one.layerOffset, one.customData)
        if one.assetPath
        else one
        for one in prim.referenceList.prependedItems
    ]
    if items:
        prim.referenceList.prependedItems = items
    for child in prim.nameChildren:
        _offset(child, offset)


def _text(keys: Sequence[tuple[float, float]]) -> str:
    return ",".join(f"{a:g}:{b:g}" for a, b in keys)
