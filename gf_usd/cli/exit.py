"""Ends the program without freeing its memory first, and reports what an interrupt leaves behind."""

from __future__ import annotations

import atexit
import glob
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

_status: list[int] = []  # asked for by `leave`


def leave(status: int) -> NoReturn:
    """End the process with an exit status, quickly where `prepare_to_leave` was called."""
    _status[:] = [status]
    sys.exit(status)


def prepare_to_leave() -> None:
    """Call it first of all: exit handlers run in the order opposite to that of their making.

    Threads are then waited for as ever, the handlers made later run, and what is still to be
    printed is.  What is left out is to free modules, stages and kernels one by one, which takes a
    fifth of a CPU second after a bake: the system takes all memory at once.
    """
    atexit.register(_end)


def _end() -> None:
    if not _status:  # nobody asked to leave: an error that was not foreseen
        return
    if taichi := sys.modules.get("taichi"):
        taichi.reset()  # it is then that the kernels that were compiled go to the cache on disk
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):
        return  # the ordinary end has words and a status for it
    os._exit(_status[0])


_checkpoints: list[Path] = []
_roots: list[Path] = []


def watch(checkpoints: Sequence[Path], root: Path | None = None) -> None:
    """From here on an interrupt ends the bake that has these checkpoints and this root layer."""
    _checkpoints[:] = checkpoints
    _roots[:] = [] if root is None else [root]


def message() -> str:
    """What is left, and how to go on with it where that can be done; "" where nothing is."""
    kept = [str(path) for path in _checkpoints if path.exists()]
    if not kept:
        return "only *.partial.* files remain" if any(map(_is_begun, _roots)) else ""
    return (
        f"{', '.join(kept)} and the full clips are kept: the same command with --resume continues"
    )


def _is_begun(root: Path) -> bool:
    """Whether a part of a bake is there, next to its root layer or in a folder of clips."""
    stem = glob.escape(root.stem)
    return any(any(root.parent.glob(f"{stem}{form}")) for form in ("*.partial.*", "*/*.partial.*"))
