"""USD layer converted from a mesh file: written to a temporary folder, and saved with the results.

The temporary layer is read as the asset, so that an invalid file or a dry run leaves no files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pxr import Sdf, Tf, UsdUtils

from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError
from gf_usd.readers.mesh.data import MeshFile
from gf_usd.readers.mesh.usd_layer import write_layer
from gf_usd.readers.usd.asset import read_usd
from gf_usd.system.atomic_files import absolute_note, asset_path, dropped_on_failure, publish
from gf_usd.system.sandbox import Scratch

RECORD = "convertedFrom"  # in customLayerData
# Raise it whenever a reader or `write_layer` makes another layer of the same file: a layer with
# another number is not current, and bakes neither use nor replace it unasked.
CONVERTER = 1


class Folder:
    """A temporary folder, or a subfolder of one, which is deleted with its last reference."""

    def __init__(self, path: Path | None = None, inside: Scratch | None = None) -> None:
        self._held = inside or Scratch()
        self.path = path or self._held.path

    def release(self) -> Path:
        """The folder, which is not deleted any more."""
        self._held.release()
        return self.path

    @property
    def layer(self) -> Path:
        """The converted layer."""
        return self.path / "source.usdc"

    @property
    def pictures(self) -> Path:
        """The folder of embedded or converted images."""
        return self.path / "textures"


class MeshSource:
    """The USD layer converted from a mesh file, or over a USD file with divided faces (`divide`).

    Parameters
    ----------
    path : the file as given by the user.
    folder : contains the layer and extracted images.
    record : identifies the input of the conversion; stored in the layer.
    notes : on assumptions and omissions.
    sources : `unit_from` and `axis_from` of the facts, where they are not from the layer.
    """

    def __init__(
        self,
        path: Path,
        folder: Folder,
        record: dict[str, str],
        notes: tuple[str, ...],
        sources: Mapping[str, str],
    ) -> None:
        self.path = path
        self.notes = notes
        self.sources = sources
        self.folder = folder
        self.record = record

    @classmethod
    def of(
        cls,
        file: MeshFile,
        *,
        meters_per_unit: float,
        up_axis: str,
        notes: tuple[str, ...],
        sources: Mapping[str, str],
    ) -> MeshSource:
        """Convert a mesh file."""
        folder = Folder()
        write_layer(
            file, folder.layer, folder.pictures, meters_per_unit=meters_per_unit, up_axis=up_axis
        )
        record = record_of(file.path, file.inputs, meters_per_unit, up_axis)
        if file.fps is not None:
            record["rigged"] = f"{file.fps:g}"
        return cls(file.path, folder, record, notes, sources)

    @property
    def layer(self) -> Path:
        """The temporary layer, which exists as long as this object."""
        return self.folder.layer

    def asset(
        self,
        *,
        prims: Sequence[str] = (),
        time_code: float | None = None,
        bind_pose: bool = False,
    ) -> Asset:
        """The asset, see `readers.read_asset`; `facts.path` is the original file."""
        asset = read_usd(
            self.folder.layer, prims=prims, time_code=time_code, bind_pose=bind_pose,
            named=self.path,
        )  # fmt: skip
        notes = (*self.notes, *asset.facts.notes)
        return replace(asset, facts=replace(asset.facts, notes=notes, **self.sources))

    def is_at(self, target: Path) -> bool:
        """Whether `target` is a complete conversion of the same bytes with the same options, by
        the same version of the converter.
        """
        if _record_at(target) != self.record:
            return False
        return all(picture.is_file() for picture in self.textures(target))

    def is_of_other_version(self, target: Path) -> bool:
        """Whether `target` was made by another version of the converter."""
        record = _record_at(target)
        return bool(record) and record.get("converter") != self.record["converter"]

    def other_file(self, target: Path) -> str:
        """The name of the file of which `target` was made; "" where it has the name of this one."""
        name = _record_at(target).get("file", "")
        return "" if name == self.record["file"] else name

    def textures(self, target: Path) -> tuple[Path, ...]:
        """The image files that `write` saves next to a layer of that name."""
        return tuple(textures_folder(target) / name for name in self._names())

    def write(self, target: Path) -> Path:
        """Write the images and the layer `target`, each atomically; returns target.

        Does nothing where it `is_at` target already.  Raises BakeError where a file cannot be
        written.
        """
        if self.is_at(target):
            return target
        extracted = textures_folder(target)
        self.extract(target)
        layer = Sdf.Layer.OpenAsAnonymous(str(self.folder.layer))
        layer.customLayerData = {**layer.customLayerData, RECORD: self.record}

        def moved(path: str) -> str:
            file = Path(path)
            if not file.is_absolute():
                return path
            if self._is_extracted(file):
                file = extracted / file.relative_to(self.folder.pictures)
            return asset_path(file, target.parent)

        UsdUtils.ModifyAssetPaths(layer, moved)
        with dropped_on_failure(target) as partial:
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

    def notes_at(self, target: Path) -> tuple[str, ...]:
        """A note where a layer of that name refers to images by their absolute paths."""
        files: list[Path] = []

        def seen(path: str) -> str:
            if Path(path).is_absolute() and not self._is_extracted(Path(path)):
                files.append(Path(path))
            return path

        UsdUtils.ModifyAssetPaths(Sdf.Layer.OpenAsAnonymous(str(self.folder.layer)), seen)
        return absolute_note(target, files)

    def _is_extracted(self, file: Path) -> bool:
        return file.is_relative_to(self.folder.pictures)

    def extract(self, target: Path) -> dict[Path, Path]:
        """Write the images next to a layer of that name; returns the new path of each."""
        folder = textures_folder(target)
        placed = {self.folder.pictures / name: folder / name for name in self._names()}
        for picture, place in placed.items():
            _write_bytes(place, picture.read_bytes())
        return placed

    def _names(self) -> list[str]:
        """The images extracted from the file, as paths relative to their folder."""
        files = (p for p in self.folder.pictures.rglob("*") if p.is_file())
        return sorted(p.relative_to(self.folder.pictures).as_posix() for p in files)


def _record_at(target: Path) -> dict[str, str]:
    """The record of an existing conversion; empty where there is none."""
    if not target.is_file():
        return {}
    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(target))
    except Tf.ErrorException:
        return {}
    return {} if layer is None else dict(layer.customLayerData.get(RECORD, {}))


def record_of(
    path: Path, inputs: Sequence[Path], meters_per_unit: float | None, up_axis: str | None
) -> dict[str, str]:
    """The record that identifies a conversion: equal records mean equal layers."""
    content = hashlib.sha256()
    for file in inputs:
        content.update(file.read_bytes())
    return {
        "file": path.name,
        "sha256": content.hexdigest(),
        "metersPerUnit": str(meters_per_unit),
        "upAxis": str(up_axis),
        "converter": str(CONVERTER),
    }


def textures_folder(target: Path) -> Path:
    """``duck.source.usdc`` -> ``duck.textures``, next to it."""
    return target.with_name(f"{target.stem.removesuffix('.source')}.textures")


def _write_bytes(path: Path, data: bytes) -> None:
    with dropped_on_failure(path) as partial:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            partial.write_bytes(data)
        except OSError as error:
            raise _refused(partial) from error
        publish(path)


def _refused(partial: Path) -> BakeError:
    return BakeError(
        f"{partial} could not be written",
        f"check that {partial.parent} exists, is writable and has space left",
    )
