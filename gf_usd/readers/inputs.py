"""Dependencies of an asset: all layers, buffers and textures, with hashes, and missing files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Usd, UsdShade, UsdUtils

from gf_usd.core.errors import InputError
from gf_usd.readers.formats import MESH, USD, format_of
from gf_usd.readers.usd.stage import open_stage, reading
from gf_usd.system.atomic_files import relative, require_utf8


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """The files that an asset depends on."""

    asset: Path
    files: tuple[tuple[str, str], ...]  # (path relative to the asset's folder, sha256), sorted
    missing: tuple[str, ...] = ()  # referenced files that do not exist; relative as well


def read_inputs(path: Path) -> Inputs:
    """The files that an asset depends on, with their hashes.

    For USD these are all layers of all variants, clips and payloads, and all textures, as USD
    resolves them; for a mesh file, those that its reader opens.

    Raises InputError where the file cannot be read.
    """
    try:
        files, missing = _files(path)
    except OSError as error:
        raise _unreadable(path, error) from error
    folder = path.absolute().parent
    rows = {relative(file, folder): digest(file) for file in files}
    return Inputs(
        asset=path,
        files=tuple(sorted(rows.items())),
        # search paths are not relative to the asset
        missing=tuple(
            sorted({relative(Path(n), folder) if Path(n).is_absolute() else n for n in missing})
        ),
    )


def digest(path: Path) -> str:
    """sha256 of a file's bytes.  Raises InputError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError) -> InputError:
    return InputError(
        f"{path} cannot be read: {error.strerror or error}",
        "check the spelling of the path and the permissions of the file",
    )


def _files(path: Path) -> tuple[Sequence[Path], Sequence[str]]:
    if not path.is_file():
        raise InputError(f"{path} does not exist", "check the spelling of the path")
    require_utf8(path)
    if format_of(path, USD):
        return usd_inputs(path)
    from gf_usd.readers.splats.convert import is_splat_file

    row = format_of(path, MESH)
    if row and not is_splat_file(path):
        read = row.function(path)
        # image files are not opened by the reader, but referenced by the converted layer
        slots = (slot for material in read.materials for slot in material.texture_slots)
        pictures = (slot.picture.path for slot in slots if slot.picture.path)
        return [*read.inputs, *pictures], ()
    return [path], ()


def usd_inputs(path: Path) -> tuple[list[Path], list[str]]:
    """(files, missing): all layers and assets that a file depends on, and unresolved paths.

    All variants, payloads, value clips and UDIM tiles are included, selected or not.  For files in
    a usdz package, the package is listed.  Raises InputError for a damaged file or dependency.
    """
    with reading(path):
        layers, assets, missing = UsdUtils.ComputeAllDependencies(str(path))
        names = [layer.realPath or layer.identifier for layer in layers] + list(assets)
    files = {Path(Ar.SplitPackageRelativePathOuter(name)[0]) for name in names}
    return sorted(file for file in files if file.is_file()), list(missing)


def require_packable(file: Path, named: Path) -> None:
    """Raise InputError where the composed stage of a USD file refers to an empty file.

    USD cannot put a file of 0 bytes into a package.

    named : the asset, as messages name it; `file` may be a layer converted from it.
    """
    with reading(file):
        stage = open_stage(file)  # an object that must outlive its range of prims
        for where, found in _all_packed(stage):
            if _is_empty(found):
                raise InputError(
                    f"{named}: {found} is empty (0 bytes), and USD cannot put it into a package;"
                    f" {where} refers to it",
                    "export it again, or write layers instead of a .usdz: -o NAME.usda",
                )


def _all_packed(stage: Usd.Stage) -> Iterator[tuple[str, str]]:
    """The results of `_packed` of what a flattened layer has: also of overs and classes, and of
    what instances share; and the files of the metadata of the layer itself.
    """
    for key, value in stage.GetPseudoRoot().GetAllAuthoredMetadata().items():
        for path in _in_metadata(value):
            yield f"{key} of the stage", path
    for prim in stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimIsActive)):
        yield from _packed(prim)


def _packed(prim: Usd.Prim) -> Iterator[tuple[str, str]]:
    """The property of a prim that refers to a packaged file, as text, and the file's path."""
    for key, value in prim.GetAllAuthoredMetadata().items():
        if key == "assetInfo":  # of its files a package has only the names: `shorten_info`
            value = {name: inner for name, inner in value.items() if isinstance(inner, dict)}
        for path in _in_metadata(value):
            yield f"{key} of <{prim.GetPath()}>", path
    for owner in prim.GetAuthoredProperties():
        for key, value in owner.GetAllAuthoredMetadata().items():
            for path in _in_metadata(value):
                yield f"{key} of <{owner.GetPath()}>", path
    for attribute in prim.GetAuthoredAttributes():
        for path in _resolved(attribute):
            yield f"<{attribute.GetPath()}>", path


def _in_metadata(value: object) -> Iterator[str]:
    """The paths of the files that a value of metadata refers to."""
    if isinstance(value, dict):
        for one in value.values():
            yield from _in_metadata(one)
    elif isinstance(value, Sdf.AssetPath):
        if value.resolvedPath:
            yield value.resolvedPath
    elif isinstance(value, Sdf.AssetPathArray):
        paths: Any = value  # iterable, which its type does not say
        for one in paths:
            yield from _in_metadata(one)


def _resolved(attribute: Usd.Attribute) -> Iterator[str]:
    """The paths of the files that an attribute refers to, over all its samples."""
    if attribute.GetTypeName().scalarType != Sdf.ValueTypeNames.Asset:
        return
    for time in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
        value = attribute.Get(time)
        for one in [value] if isinstance(value, Sdf.AssetPath) else value or ():
            if one.resolvedPath:
                yield one.resolvedPath
            elif "<UDIM>" in one.path:
                for spec in attribute.GetPropertyStack():
                    tiles = UsdShade.UdimUtils.ResolveUdimTilePaths(one.path, spec.layer)
                    yield from (path for path, _ in tiles)


def _is_empty(path: str) -> bool:
    """Whether a file, which may be in a package, has 0 bytes."""
    opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
    return bool(opened) and opened.GetSize() == 0


def layer_files(path: Path) -> list[Path]:
    """The layer of a file and all that it names, in any variant, also through other layers.

    Unlike `usd_inputs` it lists a damaged layer, which an asset may name in a variant that it does
    not show, and reads neither value clips nor textures.
    """
    found = {path.absolute()}
    todo = list(found)
    while todo:
        try:
            layer = Sdf.Layer.FindOrOpen(str(todo.pop()))
        except Tf.ErrorException:
            continue
        names = layer.GetCompositionAssetDependencies() if layer else ()
        named = (Sdf.ComputeAssetPathRelativeToLayer(layer, name) for name in names)
        fresh = {Path(Ar.SplitPackageRelativePathOuter(name)[0]) for name in named} - found
        found |= fresh
        todo += fresh
    return sorted(found)
