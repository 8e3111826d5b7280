"""Options of a folder: the file gf-usd.toml in it, or in the nearest folder above it."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gf_usd.core.errors import UsageError
from gf_usd.prepare.options.table import OPTIONS, nearest

NAME = "gf-usd.toml"
TABLES = ("bake",)
READERS = ("bake", "inspect")  # commands that take their defaults from the file

HELP = {"-h", "--help", "--help-all"}


@dataclass(frozen=True, kw_only=True)
class FolderOptions:
    """The options in a file, in the form of the command line."""

    path: Path
    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def note(self) -> str:
        """Text on the options that were read."""
        options = ", ".join(f"{name} = {value!r}" for name, value in self.values.items())
        return f"{self.path}: {options or 'no options'}; the command line has priority"

    def of(self, command: str) -> dict[str, Any]:
        """The options that a command has."""
        return {k: v for k, v in self.values.items() if command in OPTIONS[k].commands}


def wanted(arguments: Sequence[str]) -> bool:
    """Whether a command reads the file.  With --events it does not: a program sets all options."""
    if not arguments or arguments[0] not in READERS or HELP & {*arguments}:
        return False
    return not any(one == "--events" or one.startswith("--events=") for one in arguments)


def find(folder: Path) -> FolderOptions | None:
    """The options of a folder; None where there is no file in it or above.

    Raises UsageError for a file that is no TOML, and for a name or a value that is no option's.
    """
    path = next((p / NAME for p in (folder, *folder.parents) if (p / NAME).is_file()), None)
    if path is None:
        return None
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise UsageError(f"{path} cannot be read: {error}", "correct the file") from error
    _require(path, content, TABLES, "a table of this file")
    table = content.get("bake", {})
    if not isinstance(table, dict):
        raise UsageError(f"{path}: bake is {table!r}", "write bake as a table: [bake]")
    _require(path, table, OPTIONS, "an option of gf-usd bake")
    values = {}
    for name, value in table.items():
        try:
            values[name] = OPTIONS[name].take(value)
            OPTIONS[name].check(values[name])
        except UsageError as error:
            raise UsageError(f"{path}: {error.message}", error.hint) from error
    return FolderOptions(path=path, values=values)


def _require(path: Path, content: Mapping[str, Any], known: Collection[str], what: str) -> None:
    for name in content:
        if name not in known:
            raise UsageError(
                f"{path}: {name} is not {what}",
                f"{nearest(name, known)}gf-usd help config shows the form",
            )
