"""A mesh file made into USD: read at once, written beside the results when they are.

The layer is first made in a temporary folder and read from there, so that a file which is refused,
or a dry run, leaves nothing behind.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pxr import Sdf, Tf, UsdUtils

from gf_usd.assets.mesh_data import MeshFile
from gf_usd.assets.usd import read_usd
from gf_usd.assets.usd_source_layer import write_layer
from gf_usd.errors import BakeError
from gf_usd.model import Asset
from gf_usd.publish import partial_path, publish

RECORD = "convertedFrom"  # in customLayerData


class Folder:
    """A temporary folder that goes when the object does, or at the end of the program."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="gf-usd-")).resolve()
        # Windows will not remove a file that USD still maps.
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)

    @property
    def layer(self) -> Path:
        """The USD form of a file."""
        return self.path / "source.usdc"

    @property
    def pictures(self) -> Path:
        """What was inside the file, or came out of it."""
        return self.path / "textures"


class MeshSource:
    """The USD layer of a file that is not USD.

    Parameters
    ----------
    path : the file as the user named it.
    folder : holds its USD form and what is to be extracted beside that.
    record : what the layer was made of, to be found again in it.
    notes : what was assumed or left out on the way.
    """

    def __init__(
        self,
        path: Path,
        folder: Folder,
        record: dict[str, str],
        notes: tuple[str, ...],
    ) -> None:
        self.path = path
        self.notes = notes
        self._folder = folder
        self._record = record

    @classmethod
    def of(
        cls, file: MeshFile, *, meters_per_unit: float, up_axis: str, notes: tuple[str, ...]
    ) -> MeshSource:
        """Make the layer of a mesh file."""
        folder = Folder()
        write_layer(
            file, folder.layer, folder.pictures, meters_per_unit=meters_per_unit, up_axis=up_axis
        )
        record = record_of(file.path, file.inputs, meters_per_unit, up_axis)
        return cls(file.path, folder, record, notes)

    @property
    def layer(self) -> Path:
        """The USD form, until the object goes."""
        return self._folder.layer

    def asset(self, *, prims: Sequence[str] = (), time_code: float | None = None) -> Asset:
        """The surfaces and facts; `facts.path` is the original.  See `gf_usd.assets.read_asset`."""
        asset = read_usd(self._folder.layer, prims=prims, time_code=time_code, named=self.path)
        return replace(asset, facts=replace(asset.facts, notes=(*self.notes, *asset.facts.notes)))

    def is_at(self, target: Path) -> bool:
        """Whether `target` was made of the same bytes in the same way, and is whole."""
        if not target.is_file():
            return False
        try:
            there = Sdf.Layer.OpenAsAnonymous(str(target))
        except Tf.ErrorException:
            return False
        if there is None or dict(there.customLayerData.get(RECORD, {})) != self._record:
            return False
        return all(picture.is_file() for picture in self.textures(target))

    def textures(self, target: Path) -> tuple[Path, ...]:
        """Pictures that are written beside a layer of that name."""
        return tuple(textures_folder(target) / name for name in self._names())

    def write(self, target: Path) -> Path:
        """Write the layer as `target`, pictures first, each whole or not at all; returns target.

        Nothing is done where it `is_at` target already.  Raises BakeError where the disk refuses.
        """
        if self.is_at(target):
            return target
        extracted = textures_folder(target)
        self.extract(target)
        layer = Sdf.Layer.OpenAsAnonymous(str(self._folder.layer))
        layer.customLayerData = {**layer.customLayerData, RECORD: self._record}

        def moved(path: str) -> str:
            file = Path(path)
            if not file.is_absolute():
                return path
            if file.is_relative_to(self._folder.pictures):
                file = extracted / file.relative_to(self._folder.pictures)
            return _relative(file, target.parent)

        UsdUtils.ModifyAssetPaths(layer, moved)
        partial = partial_path(target)
        try:
            exported = layer.Export(str(partial))
        except Tf.ErrorException as error:
            raise _refused(partial) from error
        if not exported:
            raise _refused(partial)
        publish(target)
        if open_already := Sdf.Layer.Find(str(target.absolute())):
            open_already.Reload(force=True)
        return target

    def extract(self, target: Path) -> dict[Path, Path]:
        """Write the pictures beside a layer of that name; returns from where to where."""
        folder = textures_folder(target)
        placed = {self._folder.pictures / name: folder / name for name in self._names()}
        for picture, place in placed.items():
            _write_bytes(place, picture.read_bytes())
        return placed

    def _names(self) -> list[str]:
        """Pictures that came out of the file, as paths in their folder."""
        files = (p for p in self._folder.pictures.rglob("*") if p.is_file())
        return sorted(p.relative_to(self._folder.pictures).as_posix() for p in files)


def record_of(
    path: Path, inputs: Sequence[Path], meters_per_unit: float | None, up_axis: str | None
) -> dict[str, str]:
    """What a layer was made of: the same words mean the same layer."""
    content = hashlib.sha256()
    for file in inputs:
        content.update(file.read_bytes())
    return {
        "file": path.name,
        "sha256": content.hexdigest(),
        "metersPerUnit": str(meters_per_unit),
        "upAxis": str(up_axis),
    }


def textures_folder(target: Path) -> Path:
    """``duck.source.usdc`` -> ``duck.textures``, beside it."""
    return target.with_name(f"{target.stem.removesuffix('.source')}.textures")


def _relative(file: Path, folder: Path) -> str:
    try:
        relative = Path(os.path.relpath(file.absolute(), folder.absolute())).as_posix()
    except ValueError:  # another drive on Windows
        return file.as_posix()
    return relative if relative.startswith("../") else f"./{relative}"


def _write_bytes(path: Path, data: bytes) -> None:
    partial = partial_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data)
    except OSError as error:
        raise _refused(partial) from error
    publish(path)


def _refused(partial: Path) -> BakeError:
    return BakeError(
        f"{partial} could not be written.",
        f"check that {partial.parent} exists, is writable and has space left",
    )
