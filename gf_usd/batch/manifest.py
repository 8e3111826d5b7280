"""What a batch is asked for: a TOML or JSON file, or assets on the command line."""

from __future__ import annotations

import glob
import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gf_usd.batch.options import clean, known
from gf_usd.errors import InputError, UsageError

SUFFIXES = (".toml", ".json")
OUT = "baked"
RETRIES = 1
TOP = ("out", "name", "timeout", "retries", "settings", "matrix", "assets")
GROUP = ("files", "name", "settings", "matrix")


@dataclass(frozen=True, kw_only=True)
class Group:
    """Assets that are baked alike."""

    files: tuple[Path, ...]  # absolute, sorted, each once
    settings: Mapping[str, Any]  # the same for every job
    matrix: Mapping[str, Sequence[Any]]  # option -> values; every combination is a job
    name: str | None = None  # template; None: from what differs
    where: str = "the command line"  # what an error names


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """A batch as asked for."""

    groups: tuple[Group, ...]
    folder: Path  # that relative paths are meant from
    title: str
    out: Path = Path(OUT)  # absolute
    timeout: float | None = None  # [s] of one attempt
    retries: int = RETRIES  # of jobs whose process died or took too long
    words: tuple[str, ...] = field(default=())  # of the command line that asked for it


def read_manifest(path: Path) -> Manifest:
    """The batch of a manifest; patterns and paths are relative to its folder.

    Raises InputError where the file cannot be read, UsageError where it asks for what is not there.
    """
    tree = read_tree(path)
    folder, where = path.absolute().parent, str(path)
    _only(tree, TOP, where)
    rows = tree.get("assets", [])
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise UsageError(
            f"{where} names no assets", 'add [[assets]] with files = ["models/*.usda"]'
        )
    settings = _table(tree, "settings", where)
    matrix = _table(tree, "matrix", where)
    groups = []
    for number, row in enumerate(rows, start=1):
        place = f"{where}, assets {number}"
        _only(row, GROUP, place)
        own = {**settings, **_table(row, "settings", place)}
        axes = {**matrix, **_table(row, "matrix", place)}
        patterns = row.get("files", [])
        groups.append(
            make_group(
                [patterns] if isinstance(patterns, str) else patterns,
                # what a group sets is no axis for it, though the whole batch has one
                settings=own,
                matrix={k: v for k, v in axes.items() if k not in row.get("settings", {})},
                name=_text(row, "name", place) or _text(tree, "name", where),
                folder=folder,
                where=place,
            )
        )
    return Manifest(
        groups=tuple(groups),
        folder=folder,
        title=path.stem,
        out=absolute(folder / (_text(tree, "out", where) or OUT)),
        timeout=_number(tree, "timeout", where),
        retries=int(_number(tree, "retries", where) or 0) if "retries" in tree else RETRIES,
    )


def read_tree(path: Path) -> dict[str, Any]:
    """The table that a TOML or JSON file holds.  Raises InputError where there is none."""
    try:
        text = path.read_text(encoding="utf-8")
        tree = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(
            f"{path} cannot be read: {why}", "give a TOML or JSON manifest, as docs/farm.md shows"
        ) from error
    if not isinstance(tree, dict):
        raise InputError(f"{path} holds no table", "give a manifest, as docs/farm.md shows")
    return tree


def make_group(
    patterns: Sequence[str],
    *,
    settings: Mapping[str, Any],
    matrix: Mapping[str, Any],
    name: str | None,
    folder: Path,
    where: str,
) -> Group:
    """A group with its files found and its options checked.  Raises UsageError."""
    axes = {key.replace("-", "_"): values for key, values in matrix.items()}
    types = known()
    for key, values in axes.items():
        # one list is one value of an option that is itself a list
        whole = types.get(key) == "list" and not all(isinstance(v, list) for v in values)
        if not isinstance(values, list) or not values or whole:
            raise UsageError(
                f"{where}: the matrix has {key} = {values!r}", f"give a list: {key} = [...]"
            )
        for value in values:
            clean({**settings, key: value}, where, folder)
    fixed = {k: v for k, v in clean(settings, where, folder).items() if k not in axes}
    cleaned = {key: [clean({key: v}, where, folder)[key] for v in vs] for key, vs in axes.items()}
    return Group(
        files=find_files(patterns, folder, where),
        settings=fixed,
        matrix=cleaned,
        name=name,
        where=where,
    )


def find_files(patterns: Sequence[str], folder: Path, where: str) -> tuple[Path, ...]:
    """The files that paths and patterns name, each once, those of a pattern sorted.

    A path without a wildcard is taken as it is: where it is not there, its job will say so.
    Raises UsageError for a pattern without a file.
    """
    if not isinstance(patterns, Sequence) or not patterns:
        raise UsageError(f"{where} names no files", 'give files = ["models/*.usda"]')
    found: dict[Path, None] = {}
    for pattern in patterns:
        path = folder / Path(pattern).expanduser()
        if path.exists() or not glob.has_magic(str(pattern)):
            found.setdefault(absolute(path))
            continue
        matches = sorted(glob.glob(str(path), recursive=True))
        files = [Path(match) for match in matches if Path(match).is_file()]
        if not files:
            raise UsageError(f"{where}: no file is called {pattern}", f"look into {folder}")
        found.update(dict.fromkeys(absolute(file) for file in files))
    return tuple(found)


def absolute(path: Path) -> Path:
    """The path from the root, without ``..``; links stay."""
    return Path(os.path.abspath(path))


def _only(tree: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    unknown = [key for key in tree if key not in keys]
    if unknown:
        raise UsageError(
            f"{where}: there is no key {unknown[0]!r}", f"the keys are {', '.join(keys)}"
        )


def _table(tree: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    value = tree.get(key, {})
    if not isinstance(value, dict):
        raise UsageError(f"{where}: {key} is {value!r}", "give a table: option = value")
    return value


def _text(tree: Mapping[str, Any], key: str, where: str) -> str | None:
    value = tree.get(key)
    if value is not None and not isinstance(value, str):
        raise UsageError(f"{where}: {key} is {value!r}", "give a text")
    return value


def _number(tree: Mapping[str, Any], key: str, where: str) -> float | None:
    value = tree.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or value < 0:
        raise UsageError(f"{where}: {key} is {value!r}", "give a number of 0 or more")
    return float(value)
