"""The cache layer: one bake's frames, streamed into ``NAME.partial.usdc``.

The layer contains overs on the source's prim paths and the particle prims, and is a payload over
the source.  Its samples are in the layer itself, or in value clips (see `clips`).  The layer is
saved during the bake, in the background: memory does not grow with the number of frames, and a
readable file remains if the process is killed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from pxr import Sdf, Usd

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import BakedFrame, BakeInfo
from gf_usd.core.frames.particles import Particles, TetAttachment, TetLattice
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.units import code_text
from gf_usd.layers.clips import ClipStore, moving_layer
from gf_usd.layers.stage import (
    Home,
    author_facts,
    clock,
    find_home,
    freeze_at_last_sample,
    freeze_source,
    new_layer,
    open_source,
    require_prim,
    roots_of,
    save,
    show,
    visibility,
)
from gf_usd.layers.tracks.bounds import SkelBound, block_hints, skel_bounds
from gf_usd.layers.tracks.captured import SplatTrack
from gf_usd.layers.tracks.health import HealthTrack, bake_root
from gf_usd.layers.tracks.meshes import MeshTrack, end_instancing
from gf_usd.layers.tracks.particles import ParticleTrack
from gf_usd.layers.tracks.sparse import Saved
from gf_usd.layers.tracks.storage import (
    ROUNDING,
    AdaptiveSamples,
    Sample,
    Storage,
    Tolerance,
    errors_of,
    sample_groups,
    take_samples,
)
from gf_usd.system.atomic_files import partial_path
from gf_usd.system.background import BackgroundWriter

SAVE = 64e6  # [bytes] of unsaved samples, at most


@dataclass(frozen=True, kw_only=True)
class CacheSummary:
    """A finished cache, not yet published."""

    path: Path  # final name; the file is at ``partial_path(path)``
    partial: Path
    bytes: int
    frames: int
    clips: tuple[Path, ...] = ()  # published already
    notes: tuple[str, ...] = ()  # notes on omitted samples
    storage: Storage | None = None  # the saved space; None: not requested


class CacheWriter:
    """Write baked frames, one at a time, in order.

    A context manager: after the block the file is complete under its partial name; after an
    exception it holds the frames up to there.  Publish it with ``publish(path)``.

    Parameters
    ----------
    path : final name, for example ``duck.rubber.cache.usdc``.
    asset : what was baked.
    particles : its particles.
    info : variant, materials and settings of the bake.
    source : the USD file to lie over; default the asset's own.
    choices : which shapes are written, and whether in clips; default all in one file.
    tets : tetrahedra that are written; none: no TetMesh.
    attachments : of their points.
    since : the `state` of a writer of the same bake, to continue from; its clips are kept.
    save_every : samples between two saves; default about SAVE bytes, 24 at most.

    Raises
    ------
    InputError, UsageError, BakeError : see ``open_source``, ``new_layer``, ``Space``.
    """

    def __init__(
        self,
        path: Path,
        asset: Asset,
        particles: Particles,
        info: BakeInfo,
        *,
        source: Path | None = None,
        choices: Choices | None = None,
        tets: Sequence[TetLattice] = (),
        attachments: Sequence[TetAttachment] = (),
        save_every: int | None = None,
        since: Mapping[str, Any] | None = None,
    ) -> None:
        self.path = Path(path)
        choices = choices or Choices()
        self._every = save_every or _samples_in(SAVE, asset, particles)
        self._frames = 0  # number of written samples
        self._per_frame = info.settings.samples_per_frame
        self._time_code = float("-inf")
        self._summary: CacheSummary | None = None
        self._lost: BakeError | None = None
        self._known = None  # the layer with the specs of all attributes
        self._saving = BackgroundWriter()  # while it is busy, no other code uses the layers
        source_path = source or asset.facts.path
        stage = open_source(source_path)
        self._clock = clock(stage, info.settings)
        home = find_home(stage, asset, choices)
        prims = [require_prim(stage, source_path, s.path) for s in asset.surfaces]
        self._layer = _new_layer(
            self.path, source_path, stage, asset, info, home, start=self._clock.start
        )
        self._settled, self._held = choices.settled, ()
        self._choices, self._look, self._unit = choices, info.look, asset.facts.units.length
        self._tolerance = None
        if choices.precision is not None:
            self._tolerance = Tolerance(choices.precision, particles, self._unit)
        self._stage, self._clips, self._moving = self._open_stage(since)
        for prim in prims:
            end_instancing(self._stage, prim)
        self._meshes, self._splats = self._surface_tracks(asset, prims)
        self._converting = self._converting_prims()
        # every root prim that a display hides something of has its payload
        self._roots = roots_of(asset, home)
        for path in self._roots:
            self._stage.OverridePrim(path)
        self._particles = None
        if choices.particles:
            root = stage.GetPrimAtPath(home.root)
            self._particles = ParticleTrack(
                self._stage, root, home, asset, particles, info, self._clock, choices, tets,
                self._rounding(), attachments,
            )  # fmt: skip
        if tets:
            for track in self._meshes.values():
                track.write_bind_pose(self._clock.start)
        self._bounds = self._bound_tracks(stage)
        flows = any(LAWS[one.law].flows for one in info.materials)
        self._health = HealthTrack(
            self._stage, bake_root(asset, home), asset.facts.units,
            flows=flows, settles=info.settings.settles,
        )  # fmt: skip
        self._source = stage  # the tracks read its transforms frame by frame
        self._adaptive = (
            self._adaptive_samples(asset, particles, info) if choices.adaptive else None
        )
        save(self._layer)
        if self._clips:
            self._clips.adaptive = self._adaptive
            self._clips.begin()
        elif self._moving is not None:
            self._stage.SetEditTarget(self._moving)
        if since:
            self._restore(since)

    def _open_stage(
        self, since: Mapping[str, Any] | None
    ) -> tuple[Usd.Stage, ClipStore | None, Sdf.Layer | None]:
        """The stage to author, and where samples go instead of its layer: clips, or a layer of
        moving samples.
        """
        if self._choices.clip_frames:
            length = self._choices.clip_frames * self._per_frame
            clips = ClipStore(self.path, self._layer, length, since)
            return clips.stage, clips, None
        if self._choices.adaptive:
            moving = moving_layer(self._layer)
            stage = Usd.Stage.Open(self._layer, moving)
            stage.SetEditTarget(self._layer)
            return stage, None, moving
        return Usd.Stage.Open(self._layer), None, None

    def _surface_tracks(
        self, asset: Asset, prims: Sequence[Usd.Prim]
    ) -> tuple[dict[str, MeshTrack], dict[str, SplatTrack]]:
        """The tracks of the surfaces that are written, by prim path; prims : of all surfaces."""
        choices, time, unit = self._choices, self._clock, self._unit
        clips = bool(choices.clip_frames)
        meshes: dict[str, MeshTrack] = {}
        splats: dict[str, SplatTrack] = {}
        for surface, prim in zip(asset.surfaces, prims):
            if choices.drawn(surface.path) and surface.splats is None:
                meshes[surface.path] = MeshTrack(
                    self._stage, prim, surface, time, unit,
                    velocities=choices.velocities, clips=clips,
                )  # fmt: skip
        for surface, prim in zip(asset.surfaces, prims):
            if choices.drawn(surface.path) and surface.splats is not None:
                splats[surface.path] = SplatTrack(self._stage, prim, surface, time, unit)
        return meshes, splats

    def _converting_prims(self) -> list[tuple[Usd.Prim, int]]:
        """Prims that flowing particles replace later, and the body of each; they get a
        visibility.
        """
        converting = [
            (self._stage.GetPrimAtPath(path), body)
            for path, body in self._choices.converting
            if path in self._meshes or path in self._splats
        ]
        for prim, _ in converting:
            visibility(prim)
        return converting

    def _bound_tracks(self, stage: Usd.Stage) -> list[SkelBound]:
        """The tracks of bounds that the source authors above the baked prims."""
        moving = [*self._meshes.values(), *self._splats.values()]
        tracks = [*moving, *([self._particles] if self._particles else [])]
        block_hints(self._stage, stage, tracks)
        # the particles of a mesh are inside its box
        margin = self._tolerance.most if self._tolerance and self._choices.adaptive else 0.0
        return skel_bounds(self._stage, stage, moving or tracks, self._clock, margin)

    def _adaptive_samples(
        self, asset: Asset, particles: Particles, info: BakeInfo
    ) -> AdaptiveSamples:
        """The choice of the samples that are written."""
        assert self._tolerance is not None
        found = [self._meshes.get(s.path) or self._splats.get(s.path) for s in asset.surfaces]
        groups = sample_groups(self._tolerance, info.settings, found, self._particles)
        if self._clips:  # each begins and ends with a sample of every attribute
            groups = [replace(group, rest=None) for group in groups]
        return AdaptiveSamples(groups, _samples_in(SAVE, asset, particles))

    @property
    def full(self) -> bool:
        """Whether the last sample completed a value clip."""
        return self._clips is not None and self._clips.full

    @property
    def unsaved(self) -> int:
        """Samples that are held in memory until the next save."""
        return self._frames % self._every + (self._every if self._saving.busy else 0)

    def state(self) -> dict[str, Any]:
        """The state from which another writer continues, if this one is `full`; plain values."""
        assert self._clips is not None
        return {
            **self._clips.state(),
            "samples": self._frames,
            "particles": self._particles.state() if self._particles else {},
            "meshes": {path: vars(track.saved) for path, track in self._meshes.items()},
            "adaptive": self._adaptive.state() if self._adaptive else {},
        }

    def _restore(self, since: Mapping[str, Any]) -> None:
        self._frames, self._time_code = int(since["samples"]), since["clips"][-1][-1]
        if self._particles:
            self._particles.restore(since["particles"])
        for path, saved in since["meshes"].items():
            self._meshes[path].saved = Saved(**saved)
        if self._adaptive:
            self._adaptive.restore(since["adaptive"])

    def _rounding(self) -> Floats | None:
        """(N,) [stage units] tolerance of shapes for rounding; None: not requested."""
        if self._tolerance is None:
            return None
        return self._tolerance.particles * (ROUNDING if self._choices.adaptive else 1.0)

    def write(self, frame: BakedFrame) -> None:
        """Add one frame.

        Raises
        ------
        BakeError : a mesh is missing or is not of this asset, an array has the wrong length or
            values that are not finite, time decreases, or the disk is full.
        """
        self._settle()
        time_code = float(frame.time_code)
        if not time_code > self._time_code:
            raise BakeError(
                f"frame {frame.index} has time code {code_text(time_code)}, after"
                f" {code_text(self._time_code)}",
                "this is a bug in gf-usd, not a fault of the asset: please report it",
            )
        for what, poses, tracks in (
            ("meshes", frame.meshes, self._meshes),
            ("Gaussians", frame.splats, self._splats),
        ):
            if set(poses) != set(tracks):
                raise BakeError(
                    f"frame {frame.index} has {what} {_list(poses)}, but the asset has "
                    f"{_list(tracks)}",
                    "this is a bug in gf-usd, not a fault of the asset: please report it",
                )
        layer = self._stage.GetEditTarget().GetLayer()
        # One notice per frame, except where attributes get their specs in a new layer.
        with Sdf.ChangeBlock() if layer == self._known else contextlib.nullcontext():
            self._write_tracks(frame, time_code)
        self._known = layer
        if self._clips:
            self._guarded(partial(self._clips.keep, time_code))
        elif self._moving is not None and self._adaptive is not None:
            self._put(self._adaptive.take(time_code, take_samples(self._moving, time_code)))
        self._time_code = time_code
        self._frames += 1
        if self._frames % self._every == 0:
            self._layer.endTimeCode = time_code
            self._saving.start(self._save_layers)

    def _put(self, samples: Iterable[Sample]) -> None:
        with Sdf.ChangeBlock():
            for path, code, value in samples:
                self._layer.SetTimeSample(path, code, value)

    def _write_tracks(self, frame: BakedFrame, time_code: float) -> None:
        for path, pose in frame.meshes.items():
            self._meshes[path].write(pose, time_code)
        for path, pose in frame.splats.items():
            self._splats[path].write(pose, time_code)
        if self._particles:
            self._particles.write(
                frame.gaussians, time_code, frame.tets, frame.flows, frame.converted
            )
        for prim, body in self._converting:
            show(prim, body not in frame.converted, time_code)
        for bound in self._bounds:
            bound.write(time_code)
        self._health.write(frame.health, time_code)

    def close(self) -> CacheSummary:
        """Save unsaved samples and close the file under its partial name; further calls return the
        summary.
        """
        if self._summary is None:
            self._save()
            if self._clips:
                self._clips.close()
            partial = partial_path(self.path)
            files = [partial, *(self._clips.files if self._clips else ())]
            size = sum(file.stat().st_size for file in files)
            # with clips the cache grows with each save, and a resumed bake has fewer saves
            storage = self._storage(sum(f.stat().st_size for f in files[2:]) or size)
            self._summary = CacheSummary(
                path=self.path,
                partial=partial,
                bytes=size,
                frames=-(-self._frames // self._per_frame),
                clips=tuple(files[1:]),
                notes=(*self._notes(), *((f"{self._look}: {storage.text}",) if storage else ())),
                storage=storage,
            )
            self._release()
        return self._summary

    def __enter__(self) -> CacheWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        elif self._summary is None:
            # report the first error
            with contextlib.suppress(BakeError):
                self._save()
            self._release()

    def _save(self) -> None:
        self._settle()
        if self._adaptive and not self._clips:
            self._put(self._adaptive.close())
        if self._frames:
            self._layer.endTimeCode = self._time_code
            if self._settled:
                freeze_at_last_sample(self._layer)
                at = self._clock.source_time(self._time_code)
                self._held = freeze_source(self._layer, self._source, self._roots, at)
        self._guarded(self._save_layers)

    def _save_layers(self) -> None:
        save(self._layer)
        if self._clips:
            self._clips.save()

    def _settle(self) -> None:
        """Wait for the last save.  USD crashes if a layer is used after its disk was full."""
        if self._lost is not None:
            raise self._lost
        self._guarded(self._saving.settle)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BakeError as error:
            self._lost = error
            raise

    def _notes(self) -> tuple[str, ...]:
        of_meshes = [note for track in self._meshes.values() for note in track.notes]
        return (*of_meshes, *self._held, *(self._particles.notes if self._particles else ()))

    def _storage(self, size: int) -> Storage | None:
        """The saved space; None where all samples are stored in full."""
        chosen = self._choices
        if chosen.precision is None and chosen.velocities:
            return None
        halves, rates = self._particles.saved if self._particles else (0, 0)
        rates += sum(track.saved.bytes for track in self._meshes.values())
        tallies = self._adaptive.tallies if self._adaptive else {}
        rounding = None
        if self._particles is not None and self._particles.rounded:
            rounding = self._particles.shape_error
        return Storage(
            precision=chosen.precision,
            bytes=size,
            samples_left_out=sum(one.bytes - one.written for one in tallies.values()),
            half_precision=halves,
            velocities_left_out=rates,
            samples={path: (one.kept, one.samples) for path, one in tallies.items()},
            errors=errors_of(list(tallies.values()), rounding, self._unit),
            radius=self._tolerance.radius if self._tolerance else 0.0,
        )

    def _release(self) -> None:
        del self._meshes, self._splats, self._bounds, self._particles, self._health
        del self._stage, self._source, self._layer, self._known, self._clips, self._moving
        del self._adaptive, self._converting


def _new_layer(
    path: Path,
    source_path: Path,
    source: Usd.Stage,
    asset: Asset,
    info: BakeInfo,
    home: Home,
    *,
    start: float,
) -> Sdf.Layer:
    """A new layer over a source, with its metadata; start : time code."""
    layer = new_layer(path, source_path)
    author_facts(layer, asset.facts, info.settings, source)
    layer.startTimeCode = start
    layer.endTimeCode = start
    layer.defaultPrim = (home.root if home.inside else home.scope).name
    return layer


def _samples_in(size: float, asset: Asset, particles: Particles) -> int:
    """Number of samples of about `size` bytes: 1 to 24."""
    each = 76 * len(particles)
    for s in asset.surfaces:
        each += 24 * len(s.points) if s.splats is None else s.splats.frame_bytes
    return int(min(24, max(1, size // each)))


def _list(paths: Iterable[str]) -> str:
    return ", ".join(f"<{path}>" for path in sorted(paths)) or "none"
