"""Ends the program without freeing its memory first, and reports what an interrupt leaves."""

from __future__ import annotations

import atexit
import glob
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

_status: list[int] = []  # given to `leave`


def leave(status: int) -> NoReturn:
    """End the process with an exit status, quickly where `prepare_to_leave` was called."""
    _status[:] = [status]
    sys.exit(status)


def prepare_to_leave() -> None:
    """Call it before anything else: exit handlers run in the reverse order of their registration.

    At the end, threads are joined, later handlers run and the output is flushed, as usual.
    Modules, stages and kernels are not freed one by one, which would take a fifth of a CPU second
    after a bake: the system frees all memory at once.
    """
    atexit.register(_end)


def _end() -> None:
    if not _status:  # `leave` was not called: an unexpected error
        return
    if taichi := sys.modules.get("taichi"):
        taichi.reset()  # writes the compiled kernels to the cache on disk
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):
        return  # the ordinary end reports it, with its status
    os._exit(_status[0])


_checkpoints: list[Path] = []
_roots: list[Path] = []


def watch(checkpoints: Sequence[Path], root: Path | None = None) -> None:
    """An interrupt from now on ends the bake with these checkpoints and this root layer."""
    _checkpoints[:] = checkpoints
    _roots[:] = [] if root is None else [root]


def message() -> str:
    """The files that remain, and how to resume if that is possible; "" if there are none."""
    kept = [str(path) for path in _checkpoints if path.exists()]
    if not kept:
        return "only *.partial.* files remain" if any(map(_is_begun, _roots)) else ""
    return (
        f"{', '.join(kept)} and the full clips are kept: the same command with --resume continues"
    )


def _is_begun(root: Path) -> bool:
    """Whether a part of a bake exists, next to its root layer or in a folder of clips."""
    stem = glob.escape(root.stem)
    return any(any(root.parent.glob(f"{stem}{form}")) for form in ("*.partial.*", "*/*.partial.*"))
