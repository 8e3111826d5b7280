"""Flattens a bake with its source into one file, a layer or a usdz package.

Only the selected variants remain: the baked material, and those of the source.  The display
variants are authored again, so that the file can still switch between its shapes.  The files that
the layer refers to stay where they are, or are copied into the package.
"""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Usd, UsdShade, UsdUtils

from gf_usd.core import PACKAGE_SUFFIX
from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.choices import Choices
from gf_usd.layers.root import RootSummary
from gf_usd.layers.stage import find_home, open_source
from gf_usd.layers.variants import hidden
from gf_usd.system.atomic_files import absolute_note, asset_path, partial_path

NOWHERE = "nowhere"


def write_flat(
    path: Path,
    root: RootSummary,
    asset: Asset,
    *,
    source: Path,
    choices: Choices,
    moved: Mapping[Path, Path] | None = None,
) -> tuple[str, ...]:
    """Write the file under its partial name, ready to be published.

    Parameters
    ----------
    path : final name; .usdz becomes a package with every file it needs, anything else a layer
        that refers to textures by relative paths.
    root : the root layer over source and cache, with the bake selected.
    asset, source, choices : of the bake, as for `root.write_root`.
    moved : files that go with the result, from where they are now to where they will be.

    Returns
    -------
    Notes as text: files that could not be found.

    Raises
    ------
    BakeError : the folder or a file cannot be written.
    """
    stage = Usd.Stage.Open(str(root.path), Usd.Stage.LoadAll)
    session = stage.GetSessionLayer()
    for switch in root.switches:
        # a variant that does not exist, so that no prim is hidden by the selection
        Sdf.CreatePrimInLayer(session, switch).variantSelections[root.display_set] = NOWHERE
    layer = stage.Flatten(addSourceFileComment=False)
    anchor_tiles(stage, layer)
    _restore_displays(layer, root, asset, source, choices)
    if path.suffix == PACKAGE_SUFFIX:
        shorten_info(layer)
    return write_placed(layer, path, moved=moved)


def _restore_displays(
    layer: Sdf.Layer, root: RootSummary, asset: Asset, source: Path, choices: Choices
) -> None:
    """Variants that hide prims of a display; the visibility of these prims moves into them."""
    home = find_home(open_source(source), asset, choices)
    for switch in map(Sdf.Path, root.switches):
        spec = layer.GetPrimAtPath(switch)
        spec.variantSetNameList.prependedItems = [root.display_set]
        spec.variantSelections[root.display_set] = choices.shapes[0]
        modes = Sdf.VariantSetSpec(spec, root.display_set)
        hides = {mode: hidden(mode, switch, asset, home, choices) for mode in choices.shapes}
        # in order, so that the same bake gives the same bytes: the order of a set of paths varies
        every = list(dict.fromkeys(path for paths in hides.values() for path in paths))
        for mode, paths in hides.items():
            inner = Sdf.VariantSpec(modes, mode).primSpec.path
            for path in every:
                mine = inner.AppendPath(path.MakeRelativePath(switch)).AppendProperty("visibility")
                authored = path.AppendProperty("visibility")
                if path in paths:
                    prim = Sdf.CreatePrimInLayer(layer, mine.GetPrimOrPrimVariantSelectionPath())
                    spec_of = Sdf.AttributeSpec(prim, "visibility", Sdf.ValueTypeNames.Token)
                    spec_of.default = "invisible"
                elif layer.GetPropertyAtPath(authored):
                    Sdf.CreatePrimInLayer(layer, mine.GetPrimOrPrimVariantSelectionPath())
                    Sdf.CopySpec(layer, authored, layer, mine)
        for path in every:
            authored = layer.GetPropertyAtPath(path.AppendProperty("visibility"))
            if authored:
                layer.GetPrimAtPath(path).RemoveProperty(authored)


FOLDER = "files"  # in a package
TILES = "<UDIM>"
MADE = (2000, 1, 1, 12, 0, 0, 0, 1, 0)  # local time, as the times in a zip archive are
# file types allowed in a usdz besides layers (OpenUSD's specification)
ALLOWED = {".png", ".jpg", ".jpeg", ".exr", ".avif", ".m4a", ".mp3", ".wav"}


class Files(ABC):
    """The new path of each file; `place` is for ``UsdUtils.ModifyAssetPaths``."""

    def __init__(self) -> None:
        self.notes: dict[str, None] = {}  # unique notes, in order

    def place(self, path: str) -> str:
        """The new path; anything that is not a file of this machine, such as a URI, is
        unchanged.
        """
        outer, inner = path, ""
        if Ar.IsPackageRelativePath(path):
            outer, inner = Ar.SplitPackageRelativePathOuter(path)
        file = Path(outer)
        return self._placed(file, inner) if file.is_absolute() else path

    @abstractmethod
    def _placed(self, file: Path, inner: str) -> str: ...


class FolderFiles(Files):
    """Leaves files in place; paths are relative to the folder of the result.

    moved : files that move with the result, from current to future path.
    """

    def __init__(self, folder: Path, moved: Mapping[Path, Path]) -> None:
        super().__init__()
        self._folder, self._moved = folder, moved
        self.targets: list[Path] = []

    def _placed(self, file: Path, inner: str) -> str:
        target = self._moved.get(file, file)
        self.targets.append(target)
        placed = asset_path(target, self._folder)
        return Ar.JoinPackageRelativePath(placed, inner) if inner else placed


class Package(Files):
    """Puts files into a usdz.

    scratch : a folder for files that are extracted from other packages, which must exist until the
        package is written: packages cannot contain packages.
    """

    def __init__(self, scratch: Path) -> None:
        super().__init__()
        self._scratch = scratch
        self._files: dict[str, Path] = {}  # name in the package -> file
        self._numbers: dict[Path, int] = {}  # of folders, in names

    def _placed(self, file: Path, inner: str) -> str:
        found = self._extracted(file, inner) if inner else file
        if found is not None and TILES in found.name:
            pattern = re.escape(found.name).replace(re.escape(TILES), r"\d{4}")
            tiles = sorted(p for p in found.parent.glob("*") if re.fullmatch(pattern, p.name))
            name = self._name(found)
            for tile in tiles:
                self._add(tile, name.removesuffix(found.name) + tile.name)
            if tiles:
                return name
        if found is None or not found.is_file():
            lost = Ar.JoinPackageRelativePath(str(file), inner) if inner else file
            self.notes[f"{lost} could not be found: it is not in the package"] = None
            return Path(inner.rstrip("]") or file).name
        return self._add(found, self._name(found))

    def _add(self, file: Path, name: str) -> str:
        self._files[name] = file
        if file.suffix.lower() not in ALLOWED:
            self.notes[
                f"{file.name} is in the package, but AR clients do not allow this type of file"
            ] = None
        return name

    def _name(self, file: Path) -> str:
        """The name in the package: one folder per source folder keeps names unique."""
        number = self._numbers.setdefault(file.parent, len(self._numbers))
        return f"{FOLDER}/{number}/{file.name}"

    def _extracted(self, package: Path, inner: str) -> Path | None:
        """The file, or the pattern of tiles, in a folder of scratch; None where there is none.

        Each folder of a package is one of scratch.  USD reads the package: it also finds files in
        packages within packages, and names that are not ASCII, which it stores as UTF-8 without the
        flag of the zip format that says so.
        """
        path = Ar.JoinPackageRelativePath(str(package), inner)
        within, name = Ar.SplitPackageRelativePathInner(path)
        key = hashlib.sha256(f"{within}[{Path(name).parent}".encode()).hexdigest()
        folder = self._scratch / key[:16]
        tiles = UsdShade.UdimUtils.ResolveUdimTilePaths(path, None) if TILES in name else ()
        for one in [tile for tile, _ in tiles] or [path]:
            target = folder / Path(Ar.SplitPackageRelativePathInner(one)[1]).name
            if target.exists():
                continue
            asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(one))
            if not asset:
                return None
            folder.mkdir(exist_ok=True)
            target.write_bytes(asset.GetBuffer())
        return folder / Path(name).name

    def write(self, path: Path, layer: Path) -> None:
        """Write the package, uncompressed and aligned, with the layer as its first file.

        A zip archive has the time of each file: files made for the package get a fixed one, so
        that equal contents are equal bytes.

        Raises BakeError where a file cannot be written, or one for the package is empty.
        """
        for file in self._files.values():
            if file.stat().st_size == 0:
                raise BakeError(
                    f"{file} is empty (0 bytes), and USD cannot put it into a package",
                    "export that file again, or write layers instead of a .usdz",
                )
        made = time.mktime(MADE)
        for file in (layer, *self._files.values()):
            if file.is_relative_to(self._scratch):
                os.utime(file, (made, made))
        try:
            writer = Sdf.ZipFileWriter.CreateNew(str(path))
            done = bool(writer) and writer.AddFile(str(layer), layer.name)
            for name, file in self._files.items():
                done = done and writer.AddFile(str(file), name)
            done = done and writer.Save()
        except Tf.ErrorException as error:
            raise _refused(path) from error
        if not done:
            raise _refused(path)


def anchor_tiles(stage: Usd.Stage, flat: Sdf.Layer) -> None:
    """Make the paths of UDIM textures absolute, which flattening leaves unresolved.

    Flattening resolves every path for which a file exists; a UDIM path is a pattern.  Once the
    layer that authored it is gone, a relative pattern has no base.
    """
    for prim in stage.Traverse():
        for attribute in prim.GetAuthoredAttributes():
            spec = flat.GetAttributeAtPath(attribute.GetPath())
            value = attribute.Get() if attribute.GetTypeName() == Sdf.ValueTypeNames.Asset else None
            if value is None or spec is None or TILES not in value.path:
                continue
            layers = (opinion.layer for opinion in attribute.GetPropertyStack())
            found = (_tiles(value.path, layer) for layer in layers)
            if path := next((path for path in found if path), ""):
                spec.default = Sdf.AssetPath(path)


def _tiles(path: str, layer: Sdf.Layer) -> str:
    """The absolute path of the tiles of a UDIM path in a layer, "" where there are none.

    ``UdimUtils.ResolveUdimPath`` finds none in packages.
    """
    found = UsdShade.UdimUtils.ResolveUdimTilePaths(path, layer)
    if not found:
        return ""
    first, number = found[0]
    before, after = first.rsplit(number + path.rsplit(TILES, 1)[1], 1)
    return before + TILES + path.rsplit(TILES, 1)[1] + after


def shorten_info(layer: Sdf.Layer) -> None:
    """Reduce the paths in `assetInfo` to file names.

    They name the asset and its parts, from which a flat layer composes nothing: a package would
    hold them in vain, and AR clients accept no further layers in it.
    """

    def name(value: object) -> object:
        if isinstance(value, Sdf.AssetPath):
            return Sdf.AssetPath(Path(value.path).name)
        if isinstance(value, Sdf.AssetPathArray):
            paths: Any = value  # iterable, which its type does not say
            return Sdf.AssetPathArray([Sdf.AssetPath(Path(one.path).name) for one in paths])
        return value

    def shorten(path: Sdf.Path) -> None:
        spec = layer.GetPrimAtPath(path)
        if spec is not None and spec.HasInfo("assetInfo"):
            info = dict(spec.GetInfo("assetInfo"))
            spec.SetInfo("assetInfo", {key: name(value) for key, value in info.items()})

    layer.Traverse(Sdf.Path.absoluteRootPath, shorten)


def write_placed(
    layer: Sdf.Layer,
    path: Path,
    *,
    moved: Mapping[Path, Path] | None = None,
    package: type[Package] = Package,
) -> tuple[str, ...]:
    """Write a layer of absolute paths under the partial name of ``path``.

    Parameters
    ----------
    path : final name; .usdz becomes a package with every file the layer needs, anything else a
        layer that refers to files by relative paths.
    moved : as for `write_flat`; a package takes files from where they are now.
    package : the kind of package for a .usdz.

    Returns
    -------
    Notes as text: files that could not be found.

    Raises
    ------
    BakeError : the folder or a file cannot be written.
    """
    if path.suffix != PACKAGE_SUFFIX:
        files = FolderFiles(path.parent.absolute(), moved or {})
        UsdUtils.ModifyAssetPaths(layer, files.place)
        export(layer, partial_path(path))
        return absolute_note(path, files.targets)
    with tempfile.TemporaryDirectory(prefix="gf-usd-") as folder:
        files = package(Path(folder))
        UsdUtils.ModifyAssetPaths(layer, files.place)
        # AR clients require a crate as the first file
        first = Path(folder) / f"{path.stem}.usdc"
        export(layer, first)
        files.write(partial_path(path), first)
    return tuple(files.notes)


def export(layer: Sdf.Layer, path: Path) -> None:
    """Write a layer; raises BakeError where the file cannot be written."""
    try:
        done = layer.Export(str(path))
    except Tf.ErrorException as error:
        raise _refused(path) from error
    if not done:
        raise _refused(path)


def _refused(path: Path) -> BakeError:
    return BakeError(
        f"{path} could not be written",
        f"check that {path.absolute().parent} is writable and has space left",
    )
