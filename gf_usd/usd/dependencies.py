"""The files that a flattened layer refers to: kept where they are, or put into a package."""

from __future__ import annotations

import re
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd, UsdShade

from gf_usd.errors import BakeError
from gf_usd.usd.stage import asset_path

FOLDER = "files"  # in a package
TILES = "<UDIM>"
# what a usdz may hold beside layers (OpenUSD's specification of the format)
ALLOWED = {".png", ".jpg", ".jpeg", ".exr", ".avif", ".m4a", ".mp3", ".wav"}


class Files(ABC):
    """Says what becomes of each path; `place` is for ``UsdUtils.ModifyAssetPaths``."""

    def __init__(self) -> None:
        self.notes: dict[str, None] = {}  # in words, each once and in order

    def place(self, path: str) -> str:
        """The new path; what is no file of this machine, a URI for instance, is left as it is."""
        outer, inner = path, ""
        if Ar.IsPackageRelativePath(path):
            outer, inner = Ar.SplitPackageRelativePathOuter(path)
        file = Path(outer)
        return self._placed(file, inner) if file.is_absolute() else path

    @abstractmethod
    def _placed(self, file: Path, inner: str) -> str: ...


class Beside(Files):
    """Files stay where they are; paths are relative to the folder of the result.

    moved : files that go with the result, from where they are to where they will be.
    """

    def __init__(self, folder: Path, moved: Mapping[Path, Path]) -> None:
        super().__init__()
        self._folder, self._moved = folder, moved

    def _placed(self, file: Path, inner: str) -> str:
        placed = asset_path(self._moved.get(file, file), self._folder)
        return Ar.JoinPackageRelativePath(placed, inner) if inner else placed


class Package(Files):
    """Files go into a usdz.

    scratch : a folder for what has to be taken out of other packages, and that stays until the
        package is written: packages within packages are not allowed.
    """

    def __init__(self, scratch: Path) -> None:
        super().__init__()
        self._scratch = scratch
        self._names: dict[Path, str] = {}  # file -> name in the package

    def _placed(self, file: Path, inner: str) -> str:
        if inner:
            file = self._taken_out(file, inner)
        if TILES in file.name:
            pattern = re.escape(file.name).replace(re.escape(TILES), r"\d{4}")
            tiles = sorted(p for p in file.parent.glob("*") if re.fullmatch(pattern, p.name))
            if tiles:
                for tile in tiles:
                    self._add(tile, file)
                return self._name(file)
        if not file.is_file():
            self.notes[f"{file} could not be found: it is not in the package"] = None
            return file.name
        return self._add(file, file)

    def _add(self, file: Path, named: Path) -> str:
        name = self._name(named).removesuffix(named.name) + file.name
        self._names[file] = name
        if file.suffix.lower() not in ALLOWED:
            self.notes[f"{file.name} is in the package, where AR clients allow no such file"] = None
        return name

    def _name(self, file: Path) -> str:
        """One folder for each folder that files come from: names stay apart."""
        folders = list(dict.fromkeys([*(p.parent for p in self._names), file.parent]))
        return f"{FOLDER}/{folders.index(file.parent)}/{file.name}"

    def _taken_out(self, package: Path, inner: str) -> Path:
        target = self._scratch / f"{package.stem}{len(self._names)}" / Path(inner).name
        try:
            with zipfile.ZipFile(package) as archive:
                data = archive.read(inner)
        except (OSError, KeyError, zipfile.BadZipFile):
            return package / inner  # which is no file, and said so
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
        return target

    def write(self, path: Path, layer: Path) -> None:
        """Write the package, uncompressed and aligned, with the layer as its first file.

        Raises BakeError where the disk refuses.
        """
        try:
            writer = Sdf.ZipFileWriter.CreateNew(str(path))
            done = bool(writer) and writer.AddFile(str(layer), layer.name)
            for file, name in self._names.items():
                done = done and writer.AddFile(str(file), name)
            done = done and writer.Save()
        except Tf.ErrorException as error:
            raise refused(path) from error
        if not done:
            raise refused(path)


def anchor_tiles(stage: Usd.Stage, flat: Sdf.Layer) -> None:
    """Make the paths of UDIM textures absolute that flattening leaves as they were authored.

    It resolves every path but those without ./ whose file has another name, which UDIMs are; once
    the layer that says them is gone they would mean nothing.
    """
    for prim in stage.Traverse():
        for attribute in prim.GetAuthoredAttributes():
            spec = flat.GetAttributeAtPath(attribute.GetPath())
            value = attribute.Get() if attribute.GetTypeName() == Sdf.ValueTypeNames.Asset else None
            if value is None or spec is None or TILES not in value.path:
                continue
            layers = (opinion.layer for opinion in attribute.GetPropertyStack())
            found = (UsdShade.UdimUtils.ResolveUdimPath(value.path, layer) for layer in layers)
            if path := next((path for path in found if path), ""):
                spec.default = Sdf.AssetPath(path)


def refused(path: Path) -> BakeError:
    """The disk did not take a file."""
    return BakeError(
        f"{path} could not be written.",
        f"check that {path.absolute().parent} is writable and has space left",
    )
