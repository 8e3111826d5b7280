"""Value clips: the samples of a cache in several files, each with a given number of frames.

    duck.rubber.cache.usdc       the constant values, and on its root prims the metadata ``clips``
    duck.rubber.clips/
        manifest.usda            which attributes vary
        0001.usdc, 0002.usdc     their samples

A clip also contains the first sample of the next one.  Values between its last two samples are then
interpolated within one file, and both clips have the same values at their border: the composed
stage has the samples and values of a single file, bit by bit.

A clip gets its final name as soon as it is full, and the cache, which still has its partial name,
then lists it.  Memory therefore does not grow, and full clips survive an interrupt.  An existing
folder is never written to: the clips of an earlier bake remain complete until no file refers to
them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Gf, Sdf, Tf, Usd, Vt

from gf_usd.core.errors import BakeError
from gf_usd.layers.stage import VARIANT_SET, new_layer, refresh, save
from gf_usd.layers.tracks.storage import AdaptiveSamples, take_samples
from gf_usd.system.atomic_files import asset_path, publish

FOLDER = "clips"  # key in the cache's customLayerData: where its clips are
MANIFEST = "manifest.usda"
PARTIAL = ".partial."  # in the name of a file that is not complete
# a killed process leaves the temporary file NAME.partial.XXXXXX of USD
OURS = re.compile(
    r"(\d{4,}(\.partial)?\.usdc|manifest(\.partial)?\.usda|(\d{4,}|manifest)\.partial\.\w{6})"
)


@dataclass
class _Clip:
    """One file that is being written."""

    path: Path  # final
    layer: Sdf.Layer
    first: float  # time code of its first sample
    times: list[float] = field(default_factory=list)


class ClipStore:
    """Takes the samples that exceed the size of a cache file.

    Samples are authored on `stage`, whose edit target is a layer in memory; `keep` moves them on.

    Parameters
    ----------
    path : final name of the cache.
    cache : its layer, with the metadata of the bake; constant values are authored there.
    samples : of a clip, the repeated one not counted.
    since : a `state` to continue from; its clips are kept.

    Raises
    ------
    BakeError : the folder or a file cannot be written.
    """

    def __init__(
        self, path: Path, cache: Sdf.Layer, samples: int, since: Mapping[str, Any] | None = None
    ) -> None:
        self.adaptive: AdaptiveSamples | None = None  # chooses the samples; None: all are written
        self._cache, self._samples = cache, samples
        self.folder = path.with_name(since["folder"]) if since else _free(folder_of(path))
        self._moving = moving_layer(cache)
        self.stage = Usd.Stage.Open(cache, self._moving)
        self.stage.SetEditTarget(cache)
        self._done: list[_Clip] = []
        self._clip: _Clip | None = None
        self._roots: list[Sdf.Path] = []
        self._border: dict[Sdf.Path, object] = {}  # values of the last sample of the last clip
        if since:
            self._restore(since["clips"])
        try:
            self.folder.mkdir(parents=True, exist_ok=since is not None)
        except OSError as error:
            raise BakeError(
                f"{self.folder} cannot be created: {error.strerror}",
                f"check that {self.folder.absolute().parent} is writable and has space left",
            ) from error
        where = asset_path(self.folder, path.parent)
        cache.customLayerData = {**cache.customLayerData, VARIANT_SET: {FOLDER: where}}

    @property
    def files(self) -> tuple[Path, ...]:
        """Final names of what is complete: the manifest and the clips."""
        return (self.folder / MANIFEST, *(clip.path for clip in self._done)) if self._done else ()

    def begin(self) -> None:
        """From now on samples are authored, not constants."""
        self.stage.SetEditTarget(self._moving)
        if self._done:
            self._list()
            if self.adaptive is not None:
                self.adaptive.begin(self._done[-1].times[-1], self._border)

    @property
    def full(self) -> bool:
        """Whether the last sample completed a clip."""
        return self._clip is None and bool(self._done)

    def state(self) -> dict[str, Any]:
        """The state from which another store continues, if this one is `full`."""
        return {
            "folder": self.folder.name,
            "clips": [[clip.times[0], clip.times[-1]] for clip in self._done],
        }

    def _restore(self, clips: Sequence[Sequence[float]]) -> None:
        """Take over the clips with these first and last time codes, and what the next repeats."""
        for left in sorted(self.folder.iterdir()):
            if PARTIAL in left.name and OURS.fullmatch(left.name):
                left.unlink()
        for count, times in enumerate(clips, 1):
            path = self.folder / f"{count:04d}.usdc"
            self._done.append(
                _Clip(path=path, layer=self._moving, first=times[0], times=list(times))
            )
        manifest = _open_complete(self.folder / MANIFEST)
        self._roots = sorted({p.GetPrefixes()[0] for p in _attributes(manifest)})
        last = self._done[-1]
        self._border = _values(_open_complete(last.path), last.times[-1])

    def keep(self, time_code: float) -> None:
        """Move the samples at this time code into the clip; complete it if it is full."""
        if self._clip is None and not self._done:
            self._write_manifest()
            self._clip = self._open(time_code)
        elif self._clip is None:
            self._clip = self._open(self._done[-1].times[-1])
            for path, value in self._border.items():
                self._put(path, self._clip.first, value)
            self._clip.times.append(self._clip.first)
        self._clip.times.append(time_code)
        values = take_samples(self._moving, time_code)
        if self.adaptive is None:
            chosen = ((path, time_code, value) for path, value in values.items())
        else:
            last = len(self._clip.times) > self._samples
            chosen = self.adaptive.take(time_code, values, last=last)
        for path, code, value in chosen:
            self._put(path, code, value)
        if len(self._clip.times) > self._samples:
            self._border = _values(self._clip.layer, time_code)
            self._finish(self._clip)
            self._clip = None

    def save(self) -> None:
        """Write unsaved samples to the disk."""
        if self._clip is not None:
            save(self._clip.layer)

    def close(self) -> None:
        """Complete the last clip, full or not."""
        if self._clip is not None:
            for path, code, value in self.adaptive.close() if self.adaptive else ():
                self._put(path, code, value)
            self._finish(self._clip)
            self._clip = None

    def _put(self, path: Sdf.Path, time_code: float, value: object) -> None:
        layer = self._clip.layer if self._clip else None
        assert layer is not None
        if layer.GetAttributeAtPath(path) is None:
            _declare(layer, self._moving.GetAttributeAtPath(path))
        layer.SetTimeSample(path, time_code, value)

    def _open(self, first: float) -> _Clip:
        path = self.folder / f"{len(self._done) + 1:04d}.usdc"
        # it may exist: of a bake that was killed before it listed it, and is resumed
        layer = new_layer(path, self.folder)
        for name in ("upAxis", "metersPerUnit", "timeCodesPerSecond", "framesPerSecond"):
            layer.pseudoRoot.SetInfo(name, self._cache.pseudoRoot.GetInfo(name))
        return _Clip(path=path, layer=layer, first=first)

    def _finish(self, clip: _Clip) -> None:
        """Publish a clip and list it in the cache."""
        clip.layer.startTimeCode, clip.layer.endTimeCode = clip.times[0], clip.times[-1]
        save(clip.layer)
        # publish renames the file under the layer: nothing may touch it afterwards
        clip.layer = self._moving
        publish(clip.path)
        refresh(clip.path)
        self._done.append(clip)
        self._list()

    def _list(self) -> None:
        """List the complete clips in the cache."""
        folder = Path(self._cache.realPath).parent
        paths = [Sdf.AssetPath(asset_path(done.path, folder)) for done in self._done]
        active = [Gf.Vec2d(done.first, k) for k, done in enumerate(self._done)]
        manifest = Sdf.AssetPath(asset_path(self.folder / MANIFEST, folder))
        for root in self._roots:
            metadata = {
                "assetPaths": Sdf.AssetPathArray(paths),
                "active": Vt.Vec2dArray(active),
                "manifestAssetPath": manifest,
                "primPath": str(root),
            }
            # a name of our own: clip sets of one name are merged with those of the source
            self._cache.GetPrimAtPath(root).SetInfo("clips", {VARIANT_SET: metadata})
        self._cache.endTimeCode = self._done[-1].times[-1]
        save(self._cache)

    def _write_manifest(self) -> None:
        """Declare every attribute that has a sample, which are those of the first frame."""
        path = self.folder / MANIFEST
        layer = new_layer(path, path)
        for attribute in _attributes(self._moving):
            _declare(layer, self._moving.GetAttributeAtPath(attribute))
        self._roots = sorted({p.GetPrefixes()[0] for p in _attributes(self._moving)})
        save(layer)
        del layer
        publish(path)


def moving_layer(cache: Sdf.Layer) -> Sdf.Layer:
    """A layer in memory for the samples of a frame, with the time codes per second of the cache."""
    layer = Sdf.Layer.CreateAnonymous("moving.usda")
    layer.timeCodesPerSecond = cache.timeCodesPerSecond
    return layer


def folder_of(cache: Path) -> Path:
    """``duck.rubber.cache.usdc`` -> ``duck.rubber.clips``, next to it."""
    return cache.with_name(f"{cache.stem.removesuffix('.cache')}.clips")


def clips_of(cache: Path) -> Path | None:
    """The folder with the clips of a cache; None where it has none, or is no file."""
    if not cache.is_file():
        return None
    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(cache), metadataOnly=True)
    except Tf.ErrorException:
        return None
    metadata = layer.customLayerData.get(VARIANT_SET, {}) if layer else {}
    return cache.parent / metadata[FOLDER] if FOLDER in metadata else None


def remove_clips(folder: Path) -> None:
    """Delete the clips in a folder, and the folder unless it has other files."""
    if not folder.is_dir():
        return
    for path in sorted(folder.iterdir()):
        if OURS.fullmatch(path.name):
            path.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()


def _free(folder: Path) -> Path:
    path, count = folder, 1
    while path.exists():
        count += 1
        path = folder.with_name(f"{folder.name}-{count}")
    return path


def _attributes(layer: Sdf.Layer) -> list[Sdf.Path]:
    sites: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, sites.append)
    return [site for site in sites if site.IsPropertyPath()]


def _values(layer: Sdf.Layer, time_code: float) -> dict[Sdf.Path, object]:
    """The attributes that have a sample at this time code, with their values."""
    found = {path: layer.QueryTimeSample(path, time_code) for path in _attributes(layer)}
    return {path: value for path, value in found.items() if value is not None}


def _open_complete(path: Path) -> Sdf.Layer:
    try:
        return Sdf.Layer.FindOrOpen(str(path.absolute()))
    except Tf.ErrorException as error:
        raise BakeError(
            f"{path} cannot be read, but the bake has to continue from it",
            "bake without --resume, which starts over",
        ) from error


def _declare(layer: Sdf.Layer, spec: Sdf.AttributeSpec) -> None:
    prim = Sdf.CreatePrimInLayer(layer, spec.path.GetPrimPath())
    Sdf.AttributeSpec(prim, spec.name, spec.typeName, spec.variability, spec.custom)
