"""The file from which a bake goes on: ``NAME.checkpoint.npz``, beside the cache.

    about       JSON: `Checkpoint` without its arrays
    solver.*    the solver's state, as `Marcher.standing` gives it
    track.*     the axes of the Gaussians, as `GaussianTrack.state` gives them

It is written when a value clip is full, and speaks of the moment of that clip's last sample.  The
samples up to there are in the clips, so it does not grow with them.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.errors import BakeError, UsageError
from gf_usd.model import Floats, Health
from gf_usd.publish import partial_path, publish
from gf_usd.summary import health_of

FORMAT = 1
ABOUT = "about"


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """One look at the end of a full clip."""

    identity: Mapping[str, str]  # what has to be the same, by its name: see `resuming.identity`
    index: int  # of the sample
    last: Health  # of the sample
    log: Mapping[str, Any]  # `HealthLog.state`
    cache: Mapping[str, Any]  # `CacheWriter.state`
    solver: Mapping[str, Any]
    track: Mapping[str, Floats]


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
