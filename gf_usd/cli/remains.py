"""What an interrupt leaves, in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

_checkpoints: list[Path] = []


def watch(checkpoints: Sequence[Path]) -> None:
    """From here on an interrupt ends the bake that has these checkpoints."""
    _checkpoints[:] = checkpoints


def words() -> str:
    """What is left, and how to go on with it where that can be done."""
    kept = [str(path) for path in _checkpoints if path.exists()]
    if not kept:
        return "only *.partial.* files remain"
    return (
        f"{', '.join(kept)} and the full clips are kept: the same command with --resume continues"
    )
