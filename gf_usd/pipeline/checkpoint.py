"""The file from which a bake goes on: ``NAME.checkpoint.npz``, beside the cache.

    about       JSON: `Checkpoint` without its arrays
    solver.*    the solver's state, as `Solver.save` gives it
    track.*     the axes of the Gaussians, as `GaussianTrack.state` gives them

It is written when a value clip is full, and speaks of the moment of that clip's last sample.  The
samples up to there are in the clips, so it does not grow with them.

Going on with a bake that ended early: when its checkpoints fit, and when they are written.

Every look of a bake has a checkpoint of its own, beside its cache.  A look that was done when the
bake ended is taken up again at its last full clip, as the others are: only the frames after it are
simulated a second time, and give the same bits.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.errors import BakeError, Unfinished, UsageError
from gf_usd.core.frames import sampled
from gf_usd.core.materials import Material
from gf_usd.pipeline.health import health_of
from gf_usd.prepare.outputs import Outputs
from gf_usd.prepare.plan import Checkpoint, Plan
from gf_usd.system.atomic_files import partial_path, publish
from gf_usd.system.fingerprint import program

FORMAT = 2
ABOUT = "about"


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write it under its final name in one step; raises BakeError where the disk refuses."""
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
    partial = partial_path(path)
    try:
        with partial.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
    except OSError as error:
        raise BakeError(
            f"{partial} could not be written: {error.strerror}.",
            f"check that {path.absolute().parent} is writable and has space left; the bake then"
            " goes on with --resume",
        ) from error
    publish(path)


def read_checkpoint(path: Path) -> Checkpoint:
    """What `write_checkpoint` wrote; raises UsageError for a file that it did not write."""
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


def drop(path: Path) -> None:
    """Remove a checkpoint and what was written of the next; raises UsageError where it stays."""
    for file in (path, partial_path(path)):
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise UsageError(
                f"{file} of an earlier bake cannot be removed: {error.strerror}",
                "remove it, or choose another -o",
            ) from error


def _part(arrays: Mapping[str, Any], part: str) -> dict[str, Any]:
    return {k.removeprefix(f"{part}."): v for k, v in arrays.items() if k.startswith(f"{part}.")}


def _unreadable(path: Path, why: str) -> UsageError:
    return UsageError(
        f"{path} is no checkpoint that this program can read: {why}",
        "bake without --resume, which begins anew",
    )


# the result is the same whatever they are
INDIFFERENT = re.compile(r" --threads \S+")


def identity(plan: Plan, material: Material) -> dict[str, str]:
    """Hashes of all that decides what a look's clips hold, each under a name for people.

    Raises InputError where a file of the asset cannot be read any more.
    """
    settings = asdict(plan.settings_of(material))
    del settings["threads"]
    options = {
        "settings": settings,
        "materials": [m.values for m in plan.table(material)],
        "choices": asdict(plan.choices),
        "command": INDIFFERENT.sub("", plan.command),
    }
    body = hashlib.sha256()
    for array in (plan.particles.X, plan.particles.V0, plan.particles.material):
        body.update(np.ascontiguousarray(array).tobytes())
    return {
        "program": _hash(program()),
        "asset": _hash(_files(plan.asset.facts.path)),
        "options": _hash(options),
        "particles": body.hexdigest(),
    }


def _files(asset: Path) -> Any:
    from gf_usd.readers.inputs import read_inputs

    found = read_inputs(asset)
    return [list(found.files), list(found.missing)]


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def going_on(plan: Plan, *, overwrite: bool) -> Plan:
    """The plan with the checkpoints of its looks, and a note of where each goes on.

    overwrite : begin anew, with a note, where a checkpoint does not fit.

    Raises UsageError for a checkpoint that is of another bake, or without its clips.
    """
    found: list[Checkpoint | None] = []
    notes: list[str] = []
    for material, cache_path, path in zip(
        plan.materials, plan.outputs.caches, plan.outputs.checkpoints
    ):
        if not path.exists():
            found.append(None)
            continue
        try:
            found.append(_fitting(plan, material, cache_path, path))
        except UsageError as error:
            if not overwrite:
                raise
            return replace(
                plan,
                notes=(*plan.notes, f"{error.message}; with --overwrite the bake begins anew"),
            )
        frame = found[-1].index // plan.settings.samples_per_frame if found[-1] else 0
        notes.append(f"{material.name} goes on after frame {frame}, from {path}")
    if not any(found):
        clips = "" if plan.choices.clip_frames else ", and there will be none without --clip-frames"
        notes.append(f"--resume: there is no {plan.outputs.checkpoints[0]}{clips}; it begins anew")
    return replace(plan, standing=tuple(found), notes=(*plan.notes, *notes))


def _fitting(plan: Plan, material: Material, cache_path: Path, path: Path) -> Checkpoint:
    checkpoint = read_checkpoint(path)
    now = identity(plan, material)
    other = [name for name, value in now.items() if checkpoint.identity.get(name) != value]
    if other:
        raise UsageError(
            f"{path} is of another bake: its {' and '.join(other)} differed",
            "repeat the command that was interrupted, or bake without --resume, which begins anew",
        )
    clips = [cache_path.parent / name for name in clip_files(checkpoint.cache)]
    missing = [clip for clip in clips if not clip.is_file()]
    if missing:
        raise UsageError(
            f"{missing[0]} is gone, which {path} goes on from",
            "put it back, or bake without --resume, which begins anew",
        )
    return checkpoint


def clip_files(state: Mapping[str, Any]) -> list[str]:
    """Names, beside the cache, of the files that a `CacheWriter.state` goes on from."""
    clips = [f"{count:04d}.usdc" for count in range(1, len(state["clips"]) + 1)]
    return [f"{state['folder']}/{name}" for name in ("manifest.usda", *clips)]


class Keeper:
    """Writes the checkpoints of a run, and ends it where its slice does.

    slice : full clips after which the run ends; None: never.

    Raises UsageError for a slice of a bake without clips.
    """

    def __init__(self, plan: Plan, slice: int | None = None) -> None:
        if slice and not plan.choices.clip_frames:
            raise UsageError(
                f"--slice {slice} counts value clips, and this bake has none",
                "add --clip-frames, the frames of a clip",
            )
        self._plan, self._slice, self._full = plan, slice, 0
        looks = plan.materials if plan.choices.clip_frames else ()
        # read before the first frame: a file that changes meanwhile is found by who resumes
        self._identities = [identity(plan, look) for look in looks]

    def keep(self, number: int, index: int, state: Mapping[str, Any]) -> None:
        """Write the checkpoint of a look whose clip became full with this sample.

        state : the fields of the `Checkpoint` but its identity and index.

        Raises Unfinished at the end of the slice, BakeError where the disk refuses.
        """
        plan, material = self._plan, self._plan.materials[number]
        path = plan.outputs.checkpoints[number]
        found = Checkpoint(identity=self._identities[number], index=index, **state)
        write_checkpoint(path, found)
        self._full += 1
        done = index == sampled(plan.settings).frames - 1 and number == len(plan.materials) - 1
        if self._full == self._slice and not done:
            frame = index // plan.settings.samples_per_frame + 1
            raise Unfinished(
                f"{material.name}: {frame} of {plan.settings.frames} frames are done, and the slice"
                f" of {self._slice} clips ends here; {path} is kept",
                "the same command with --resume continues",
            )


def finished(files: Outputs) -> None:
    """Remove the checkpoints: there is nothing left to go on with."""
    for path in files.checkpoints:
        drop(path)


def folders(standing: Sequence[Checkpoint | None], files: Outputs) -> set[Path]:
    """Folders of the clips that checkpoints go on from."""
    pairs = zip(standing, files.caches)
    return {cache.parent / found.cache["folder"] for found, cache in pairs if found}


def abandoned(files: Outputs) -> set[Path]:
    """Folders of clips of checkpoints that nobody goes on from; removes the checkpoints."""
    left: set[Path] = set()
    for cache_path, path in zip(files.caches, files.checkpoints):
        if path.exists():
            with contextlib.suppress(UsageError):  # what cannot be read names no clips
                left.add(cache_path.parent / read_checkpoint(path).cache["folder"])
        drop(path)
    return left
