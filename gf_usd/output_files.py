"""Where a bake writes, and whether it may."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gf_usd.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Where a bake writes."""

    root: Path
    caches: tuple[Path, ...]  # one for each look
    report: Path

    @property
    def all(self) -> tuple[Path, ...]:
        return (self.root, *self.caches, self.report)


def outputs(source: Path, looks: Sequence[str], output: str | None) -> Outputs:
    """Names of the results; looks are the names of the variants.

    `-o` names the root layer, or a folder if it ends in / or is one; default: the current folder.
    One look: duck.rubber.usda and duck.rubber.cache.usdc.  Several: duck.rubber-jelly.usda with
    duck.rubber-jelly.rubber.cache.usdc and so on.
    """
    name = f"{source.stem}.{'-'.join(looks)}.usda"
    if output is None:
        root = Path(name)
    elif output.endswith("/") or Path(output).is_dir():
        root = Path(output) / name
    else:
        root = Path(output)
        if root.suffix not in (".usda", ".usd", ".usdc"):
            raise UsageError(
                f"-o {output}: a root layer ends in .usda, .usd or .usdc",
                f"name it {root.name}.usda, or end a folder's name in /",
            )
    stem = root.name[: -len(root.suffix)]
    parts = ("",) if len(looks) == 1 else tuple(f".{look}" for look in looks)
    return Outputs(
        root=root,
        caches=tuple(root.with_name(f"{stem}{part}.cache.usdc") for part in parts),
        report=root.with_name(f"{stem}.report.json"),
    )


def require_free(files: Outputs, overwrite: bool) -> None:
    """Raise UsageError where a result is there already, or no folder could hold one."""
    there = [p for p in files.all if p.exists()]
    if there and not overwrite:
        raise UsageError(
            f"{there[0]} exists already", "add --overwrite to replace it, or choose another -o"
        )
    parent = files.root.parent
    while not parent.exists() and parent != parent.parent:
        parent = parent.parent
    if not parent.is_dir():
        raise UsageError(f"{parent} is no folder", "choose a folder to write to with -o")
    try:
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise UsageError(
            f"{parent} cannot be written to: {error.strerror}",
            "choose another folder with -o, or change its permissions",
        ) from error


def claim(files: Outputs) -> None:
    """Make the folder of the results."""
    files.root.parent.mkdir(parents=True, exist_ok=True)
