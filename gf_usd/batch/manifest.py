"""The manifest of a batch: a TOML or JSON file, or assets on the command line.

The options that a manifest may give: those of `gf_usd.bake`, each of its type.
"""

from __future__ import annotations

import glob
import json
import math
import os
import threading
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gf_usd.core import USD_SUFFIXES
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.materials.laws import check_law
from gf_usd.core.materials.presets import find_preset
from gf_usd.prepare.advice import AUTO
from gf_usd.prepare.advice.advise import parse_auto
from gf_usd.prepare.options.option import DEFAULT, Option
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.table import OPTIONS, nearest
from gf_usd.readers.formats import SUFFIXES as READABLE
from gf_usd.system.sandbox import parse_limits

SUFFIXES = (".toml", ".json")
OUT = "baked"
RETRIES = 1
SHORTEST = 0.1  # [s] of a time limit
UNSET = DEFAULT  # as a value: that of the asset or of bake, whatever else is set
TOP = ("out", "name", "timeout", "retries", "settings", "matrix", "assets")
GROUP = ("files", "name", "settings", "matrix")


@dataclass(frozen=True, kw_only=True)
class Group:
    """Assets that are baked with the same options."""

    files: tuple[Path, ...]  # absolute, sorted, each once
    settings: Mapping[str, Any]  # the same for every job
    matrix: Mapping[str, Sequence[Any]]  # option -> values; every combination is a job
    name: str | None = None  # template; None: from what differs
    where: str = "the command line"  # name in errors
    notes: tuple[str, ...] = ()  # on matches of its patterns that are not baked


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """A batch as specified by the user."""

    groups: tuple[Group, ...]
    folder: Path  # of relative paths
    title: str
    out: Path = Path(OUT)  # absolute
    timeout: float | None = None  # [s] of one attempt
    retries: int = RETRIES  # of jobs whose process crashed or timed out
    arguments: tuple[str, ...] = field(default=())  # of the command line of the batch


def read_manifest(path: Path) -> Manifest:
    """Read a manifest; patterns and paths are relative to its folder.

    Raises InputError where the file cannot be read, UsageError for unknown keys, options or files.
    """
    tree = read_tree(path)
    folder, where = path.absolute().parent, str(path)
    _only(tree, TOP, where)
    rows = tree.get("assets", [])
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise UsageError(
            f"{where} lists no assets", 'add [[assets]] with files = ["models/*.usda"]'
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
                # an option set by the group is no axis of the group, even if it is one of the batch
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
        timeout=_number(tree, "timeout", where, SHORTEST),
        retries=_whole(tree, "retries", where, RETRIES),
    )


def read_tree(path: Path) -> dict[str, Any]:
    """The contents of a TOML or JSON file.  Raises InputError where it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8")
        tree = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(
            f"{path} cannot be read: {why}", "give a TOML or JSON manifest, as docs/farm.md shows"
        ) from error
    if not isinstance(tree, dict):
        raise InputError(f"{path} contains no table", "give a manifest, as docs/farm.md shows")
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
    """A group, with its files found and its options checked.  Raises UsageError."""
    axes = {key.replace("-", "_"): values for key, values in matrix.items()}
    for key, values in axes.items():
        # a single list is one value of an option whose values are lists
        listed = key in KNOWN and KNOWN[key].repeated
        whole = listed and not all(isinstance(v, list) for v in values)
        if not isinstance(values, list) or not values or whole:
            raise UsageError(
                f"{where}: the matrix has {key} = {values!r}", f"give a list: {key} = [...]"
            )
        for value in values:
            clean({**settings, key: value}, where, folder)
    fixed = {k: v for k, v in clean(settings, where, folder).items() if k not in axes}
    cleaned = {key: [clean_value(key, v, where, folder) for v in vs] for key, vs in axes.items()}
    return Group(
        files=find_files(patterns, folder, where),
        settings=fixed,
        matrix=cleaned,
        name=name,
        where=where,
        notes=skipped_files(patterns, folder),
    )


def find_files(patterns: Sequence[str], folder: Path, where: str) -> tuple[Path, ...]:
    """The files that paths and patterns match, without duplicates, those of a pattern sorted.

    A path without a wildcard is returned even if there is no such file: its job reports that.
    Raises UsageError for a pattern without a match.
    """
    if not isinstance(patterns, Sequence) or not patterns:
        raise UsageError(f"{where} lists no files", 'give files = ["models/*.usda"]')
    for pattern in patterns:
        if not isinstance(pattern, str) or not pattern:
            raise UsageError(
                f"{where}: {pattern!r} is not a file", 'give paths or patterns: ["models/*.usda"]'
            )
    found: dict[Path, None] = {}
    for pattern in patterns:
        path = folder / Path(pattern).expanduser()
        if path.exists() or not glob.has_magic(str(pattern)):
            found.setdefault(absolute(path))
            continue
        matches = sorted(glob.glob(str(path), recursive=True))
        files = [Path(match) for match in matches if Path(match).is_file()]
        if not files:
            raise UsageError(
                f"{where}: no file matches {pattern}",
                f"check the pattern; it refers to the folder {folder}",
            )
        found.update(dict.fromkeys(absolute(file) for file in files))
    return tuple(found)


def skipped_files(patterns: Sequence[str], folder: Path) -> tuple[str, ...]:
    """Notes on the matches that `find_files` skips: missing files, and folders.

    Folders are only named if they have the suffix of an asset.
    """
    notes = []
    for pattern in patterns:
        path = folder / Path(pattern).expanduser()
        if path.exists() or not glob.has_magic(str(pattern)):
            continue
        for match in sorted(map(Path, glob.glob(str(path), recursive=True))):
            asset = match.suffix.lower() in READABLE
            if not match.is_file() and (asset or not match.is_dir()):
                what = "a folder" if match.is_dir() else "no regular file"
                why = what if match.exists() else "a link to a file that does not exist"
                notes.append(f"{match} is skipped: it is {why}")
    return tuple(dict.fromkeys(notes))


def absolute(path: Path) -> Path:
    """The absolute path without ``..``; symbolic links are kept."""
    return Path(os.path.abspath(path))


def _only(tree: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    unknown = [key for key in tree if key not in keys]
    if unknown:
        raise UsageError(f"{where}: unknown key {unknown[0]!r}", f"the keys are {', '.join(keys)}")


def _table(tree: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    value = tree.get(key, {})
    if not isinstance(value, dict):
        raise UsageError(f"{where}: {key} is {value!r}", "give a table: option = value")
    return value


def _text(tree: Mapping[str, Any], key: str, where: str) -> str | None:
    value = tree.get(key)
    if value is not None and not isinstance(value, str):
        raise UsageError(f"{where}: {key} is {value!r}", "give a string")
    return value


def _number(tree: Mapping[str, Any], key: str, where: str, low: float) -> float | None:
    value = tree.get(key)
    if value is None:
        return None
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not low <= value <= threading.TIMEOUT_MAX:
        most = f"{threading.TIMEOUT_MAX:.2g}"
        raise UsageError(f"{where}: {key} is {value!r}", f"give a number from {low:g} to {most}")
    return float(value)


def _whole(tree: Mapping[str, Any], key: str, where: str, default: int) -> int:
    value = tree.get(key)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise UsageError(f"{where}: {key} is {value!r}", "give a whole number of 0 or more")
    return value


KNOWN = {name: option for name, option in OPTIONS.items() if "batch" in option.commands}
TYPES = {int: (int,), float: (int, float), bool: (bool,), str: (str, int, float)}


def clean(given: Mapping[str, Any], where: str, folder: Path) -> dict[str, Any]:
    """The checked options of one job, without reading any asset.

    Parameters
    ----------
    where : what to name in an error.
    folder : the folder of relative paths of material files and obstacles.

    Raises UsageError as `checked`, and for an unknown material.
    """
    out = checked(given, where)
    try:
        if "material" in out:
            out["material"] = _materials(out["material"], folder)
    except UsageError as error:
        raise UsageError(f"{where}: {error.message}", error.hint) from error
    if "colliders" in out:
        out["colliders"] = [os.path.realpath(folder / name) for name in out["colliders"]]
    return out


def clean_value(key: str, value: Any, where: str, folder: Path) -> Any:
    """The checked value of an axis, or UNSET; see `clean`."""
    return clean({key: value}, where, folder).get(key, UNSET)


def checked(
    given: Mapping[str, Any], where: str, known: Mapping[str, Option] = KNOWN
) -> dict[str, Any]:
    """Options with the names and values of the command line; paths are unchanged.

    An option that is UNSET, or null in JSON, is left out.

    known : the allowed options.

    Raises UsageError for an unknown option, a value of the wrong type or out of range.
    """
    out = {}
    for key, value in given.items():
        name = key.replace("-", "_")
        if name not in known:
            raise UsageError(
                f"{where}: unknown option {key!r}",
                f"{nearest(name, known)}the options are {', '.join(sorted(known))}",
            )
        if is_unset(value):
            out.pop(name, None)  # which may be there by its other spelling
        else:
            out[name] = _typed(known[name], value, where)
    fields = Request.__dataclass_fields__
    try:
        Request.of({name: value for name, value in out.items() if name in fields}).check()
        if "law" in out:
            check_law(out["law"])
        parse_limits(out.get("limits"))
    except UsageError as error:
        raise UsageError(f"{where}: {error.message}", error.hint) from error
    return out


def is_unset(value: Any) -> bool:
    """Whether a value stands for the default."""
    return value is None or value == UNSET


def _as_in_python(option: Option, value: Any, where: str) -> Any:
    """The text of a value that `gf_usd.bake` takes too: false, three numbers, a list of shapes."""
    try:
        taken = option.take(value)
    except UsageError as error:
        raise UsageError(f"{where}: {error.message}", error.hint) from error
    if not isinstance(taken, str):  # a list of materials, which is an axis; limits
        raise UsageError(f"{where}: {option.name} is {value!r}", "give a text")
    return taken


def _typed(option: Option, value: Any, where: str) -> Any:
    """The value in the format of the command line."""
    kind = option.kind
    if option.repeated:
        rows = [value] if isinstance(value, str) else value
        if isinstance(rows, list | tuple) and all(isinstance(row, str) for row in rows):
            return list(rows)
    elif isinstance(value, TYPES[kind]) and not (isinstance(value, bool) and kind is not bool):
        if kind is str:
            return str(value)
        if kind is bool or math.isfinite(value) or option.name == "filter_rate":
            return value
    elif option.write is not None and isinstance(value, bool | list | dict):
        return _as_in_python(option, value, where)
    names = {str: "a list of strings" if option.repeated else "a text", bool: "true or false"}
    wanted = names.get(kind, f"one {kind.__name__}")
    raise UsageError(f"{where}: {option.name} is {value!r}", f"give {wanted}")


def parse(name: str, text: str, where: str) -> Any:
    """The value of NAME=VALUE on the command line.  Raises UsageError for an invalid one."""
    if is_unset(text):
        return UNSET
    option = KNOWN.get(name.replace("-", "_"))
    kind = option.kind if option else str
    if kind is bool and text in ("true", "false"):
        return text == "true"
    if kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            raise UsageError(
                f"{where}: {text!r} is not of type {kind.__name__}", "give a number"
            ) from None
    return text


def _materials(text: str, folder: Path) -> str:
    """Presets by name, auto, and material files by their absolute path."""
    auto = parse_auto(text, None)
    if auto is not None and auto.advisor:
        raise UsageError(
            f"--material {text}: a batch does not use an advisor, because its answers may "
            f"change between jobs",
            f"use {AUTO}, or bake the assets one by one",
        )
    if auto is not None:
        return AUTO
    parts = []
    for part in text.split(","):
        part = part.strip()
        if Path(part).suffix.lower() in USD_SUFFIXES:
            parts.append(os.path.realpath(folder / part))
        else:
            parts.append(find_preset(part).name)
    return ",".join(parts)


def material_files(options: Mapping[str, Any]) -> tuple[Path, ...]:
    """The material files among a job's materials."""
    parts = str(options.get("material", "")).split(",")
    return tuple(Path(part) for part in parts if Path(part).suffix.lower() in USD_SUFFIXES)


def obstacle_files(options: Mapping[str, Any]) -> tuple[Path, ...]:
    """The files whose meshes are obstacles of a job."""
    return tuple(Path(part) for part in options.get("colliders", ()))


def result_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that affect the written files."""
    kept = {name: value for name, value in options.items() if KNOWN[name].decides}
    return {"material": "rubber", **kept}
