"""The checkpoint of an interrupted bake: ``NAME.checkpoint.npz``, next to the cache.

    about       JSON: `Checkpoint` without its arrays
    solver.*    the solver's state, as `FrameBuilder.state` gives it
    track.*     the axes of the Gaussians, likewise

A checkpoint is written when a value clip is complete, and holds the state at the clip's last
sample. The samples before it are in the clips, so the size of a checkpoint does not grow with their
number.

This module also decides which checkpoints a bake resumes from, and when they are written. Each
variant has its own checkpoint. A variant that was complete when the bake was interrupted resumes at
its last complete clip like the others: only the frames after that clip are simulated again, with
bit-identical results.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import BakeError, Unfinished, UsageError, counted
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import Health
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Collider
from gf_usd.pipeline.health.log import health_of
from gf_usd.prepare.outputs.outputs import Outputs, remove_stale
from gf_usd.prepare.plan import Variant
from gf_usd.system.atomic_files import dropped_on_failure, partial_path, publish
from gf_usd.system.fingerprint import program

FORMAT = 2
ABOUT = "about"


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """The state of one variant at the end of a complete clip."""

    identity: Mapping[str, str]  # hashes that must match to resume: see `identity`
    index: int  # of the sample
    last: Health  # of the sample
    log: Mapping[str, Any]  # `HealthLog.state`
    cache: Mapping[str, Any]  # `CacheWriter.state`
    solver: Mapping[str, Any]
    track: Mapping[str, Floats]


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint atomically; raises BakeError where the file cannot be written."""
    about = {
        "format": FORMAT,
        "identity": dict(checkpoint.identity),
        "index": checkpoint.index,
        "last": asdict(checkpoint.last),
        "log": checkpoint.log,
        "cache": checkpoint.cache,
    }
    arrays = {ABOUT: np.array(json.dumps(about))}
    for part in ("solver", "track"):
        arrays |= {f"{part}.{k}": np.asarray(v) for k, v in getattr(checkpoint, part).items()}
    with dropped_on_failure(path) as partial:
        try:
            with partial.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
        except OSError as error:
            raise BakeError(
                f"{partial} could not be written: {error.strerror}",
                f"check that {path.absolute().parent} is writable and has space left; --resume"
                " then continues the bake",
            ) from error
        publish(path)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint; raises UsageError for a file that `write_checkpoint` did not write."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(str(arrays.pop(ABOUT)))
        if about["format"] != FORMAT:
            raise _unreadable(path, f"it has format {about['format']}, this program has {FORMAT}")
        return Checkpoint(
            identity=about["identity"],
            index=about["index"],
            last=health_of(about["last"]),
            log=about["log"],
            cache=about["cache"],
            solver=_part(arrays, "solver"),
            track=_part(arrays, "track"),
        )
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise _unreadable(path, f"{type(error).__name__}: {error}") from error


def remove_checkpoint(path: Path) -> None:
    """Remove a checkpoint and its partial file; raises UsageError where one of them cannot be
    removed.
    """
    for file in (path, partial_path(path)):
        remove_stale(file)


def _part(arrays: Mapping[str, Any], part: str) -> dict[str, Any]:
    return {k.removeprefix(f"{part}."): v for k, v in arrays.items() if k.startswith(f"{part}.")}


def _unreadable(path: Path, why: str) -> UsageError:
    return UsageError(
        f"{path} is not a checkpoint that this program can read: {why}",
        "bake without --resume, which starts over",
    )


# options that do not change the result
WITHOUT_EFFECT = re.compile(r" --threads \S+")


def identity(
    settings: Settings,
    table: Sequence[Material],
    choices: Choices,
    particles: Particles,
    colliders: Sequence[Collider] = (),
    *,
    asset: Path,
    command: str,
) -> dict[str, str]:
    """Hashes of everything that determines the contents of a variant's clips, by a readable name.

    colliders : obstacles, of the asset or of separate files (`--collider`).
    Raises InputError where a file of the asset cannot be read any more.
    """
    of_settings = asdict(settings)
    del of_settings["threads"]
    options = {
        "settings": of_settings,
        "materials": [m.values for m in table],
        "choices": asdict(choices),
        "command": WITHOUT_EFFECT.sub("", command),
    }
    body = hashlib.sha256()
    for array in (particles.X, particles.V0, particles.material):
        body.update(np.ascontiguousarray(array).tobytes())
    return {
        "program": _hash(program()),
        "asset": _hash(_files(asset)),
        "obstacles": _obstacles(colliders),
        "options": _hash(options),
        "particles": body.hexdigest(),
    }


def _obstacles(colliders: Sequence[Collider]) -> str:
    """Hash of the shape, motion and physics material of each obstacle, from any file."""
    found = hashlib.sha256()
    for one in colliders:
        found.update(_hash([one.shape, one.approximation, one.role, asdict(one.spec)]).encode())
        for array in (one.points, one.triangles, one.linear, one.offset, one.deformed):
            values = np.ascontiguousarray(() if array is None else array)
            found.update(repr((values.dtype.str, values.shape)).encode())
            found.update(values.tobytes())
    return found.hexdigest()


def _files(asset: Path) -> Any:
    from gf_usd.readers.inputs import read_inputs

    found = read_inputs(asset)
    return [list(found.files), list(found.missing)]


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class Resume:
    """The checkpoints from which the variants of a bake resume, with notes."""

    checkpoints: tuple[Checkpoint | None, ...] = ()  # of each variant; (): all start over
    notes: tuple[str, ...] = ()

    def of(self, number: int) -> Checkpoint | None:
        """The checkpoint of a variant; None: it starts from its first frame."""
        return self.checkpoints[number] if self.checkpoints else None

    def folders(self, files: Outputs) -> set[Path]:
        """Folders of the clips that the resumed bake continues."""
        pairs = zip(self.checkpoints, files.caches)
        return {cache.parent / found.cache["folder"] for found, cache in pairs if found}


def find_resume(
    variants: Sequence[Variant],
    identify: Callable[[Variant], Mapping[str, str]],
    *,
    clips: bool,
    overwrite: bool,
) -> Resume:
    """The checkpoints of the variants, with a note on the frame after which each resumes.

    identify : gives the `identity` of a variant.
    clips : the bake has value clips.
    overwrite : start over, with a note, where a checkpoint does not match.

    Raises UsageError for a checkpoint of another bake, or one whose clips are missing.
    """
    found: list[Checkpoint | None] = []
    notes: list[str] = []
    for variant in variants:
        if not variant.checkpoint.exists():
            found.append(None)
            continue
        try:
            checkpoint = _checked_checkpoint(identify(variant), variant.cache, variant.checkpoint)
        except UsageError as error:
            if not overwrite:
                raise
            return Resume(notes=(f"{error.message}; with --overwrite the bake starts over",))
        found.append(checkpoint)
        frame = checkpoint.index // variant.settings.samples_per_frame
        notes.append(f"{variant.name} continues after frame {frame}, from {variant.checkpoint}")
    if not any(found):
        none = "" if clips else ", and there will be none without --clip-frames"
        notes.append(f"--resume: there is no {variants[0].checkpoint}{none}; the bake starts over")
    return Resume(checkpoints=tuple(found), notes=tuple(notes))


def _checked_checkpoint(now: Mapping[str, str], cache_path: Path, path: Path) -> Checkpoint:
    """The checkpoint in a file, which must match this bake; now : `identity` of this bake."""
    checkpoint = read_checkpoint(path)
    other = [name for name, value in now.items() if checkpoint.identity.get(name) != value]
    if other:
        raise UsageError(
            f"{path} is of another bake: its {' and '.join(other)} differed",
            "repeat the command that was interrupted, with unchanged files, or bake without"
            " --resume, which starts over",
        )
    clips = [cache_path.parent / name for name in clip_files(checkpoint.cache)]
    missing = [clip for clip in clips if not clip.is_file()]
    if missing:
        raise UsageError(
            f"{missing[0]} is missing, and {path} needs it to continue",
            "restore it, or bake without --resume, which starts over",
        )
    return checkpoint


def clip_files(state: Mapping[str, Any]) -> list[str]:
    """Names, relative to the cache, of the files that a `CacheWriter.state` needs to resume."""
    clips = [f"{count:04d}.usdc" for count in range(1, len(state["clips"]) + 1)]
    return [f"{state['folder']}/{name}" for name in ("manifest.usda", *clips)]


class CheckpointWriter:
    """Writes the checkpoints of a run, and counts them.

    paths, identities : of each variant.
    slice : number of checkpoints after which the run ends; None: it runs to its end.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        identities: Sequence[Mapping[str, str]],
        slice: int | None = None,
    ) -> None:
        self._paths, self._identities = paths, identities
        self._slice, self._written = slice, 0

    def write(self, number: int, index: int, state: Mapping[str, Any]) -> None:
        """Write the checkpoint of a variant after the sample that completed a clip.

        state : the fields of the `Checkpoint` except its identity and index.

        Raises BakeError where the file cannot be written.
        """
        found = Checkpoint(identity=self._identities[number], index=index, **state)
        write_checkpoint(self._paths[number], found)
        self._written += 1

    @property
    def slice_done(self) -> bool:
        """Whether all clips of the slice are written."""
        return self._written == self._slice

    def unfinished(self, number: int, variant: str, done: int, frames: int) -> Unfinished:
        """The exception that reports the end of a slice, with the number of frames done."""
        return Unfinished(
            f"{variant}: {done} of {frames} frames are done, and the slice of"
            f" {counted(self._slice or 0, 'clip')} ends here; {self._paths[number]} is kept",
            "the same command with --resume continues",
            variant=variant,
            done=done,
            frames=frames,
        )


def remove_checkpoints(files: Outputs) -> None:
    """Remove the checkpoints of a complete bake."""
    for path in files.checkpoints:
        remove_checkpoint(path)


def discard_checkpoints(files: Outputs) -> set[Path]:
    """Remove checkpoints that are not resumed; returns the folders of their clips."""
    left: set[Path] = set()
    for cache_path, path in zip(files.caches, files.checkpoints):
        if path.exists():
            with contextlib.suppress(UsageError):  # an unreadable checkpoint lists no clips
                left.add(cache_path.parent / read_checkpoint(path).cache["folder"])
        remove_checkpoint(path)
    return left
