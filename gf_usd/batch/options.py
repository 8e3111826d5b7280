"""The options that a manifest may give: those of `gf_usd.bake`, each of its type."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gf_usd import materials as presets
from gf_usd.advice import AUTO
from gf_usd.advising import parse_auto
from gf_usd.errors import UsageError
from gf_usd.isolation import parse_limits
from gf_usd.output_files import USD
from gf_usd.planning import Request

# of `bake` itself, beside those of `Request`
OWN = {
    "material": "str",
    "law": "str",
    "prims": "list",
    "meters_per_unit": "float",
    "up_axis": "str",
    "repair": "bool",
    "strict": "bool",
    "max_hours": "float",
    "limits": "str",
}
# they decide how long a bake takes and how it is judged, not what it writes
INDIFFERENT = ("strict", "max_hours", "threads", "limits")
TYPES = {"int": (int,), "float": (int, float), "bool": (bool,), "str": (str, int, float)}


def known() -> dict[str, str]:
    """Every option and its type: str, int, float, bool or list."""
    fields = Request.__dataclass_fields__
    types = {name: str(field.type).partition(" ")[0] for name, field in fields.items()}
    lists = {name: "list" for name, kind in types.items() if kind.startswith("tuple")}
    return {**types, **lists, **OWN}


def clean(given: Mapping[str, Any], where: str, folder: Path) -> dict[str, Any]:
    """Options of one job, checked without reading any asset.

    Parameters
    ----------
    where : what to name in an error.
    folder : that paths of material files are relative to.

    Raises UsageError for an unknown option, a value of the wrong type or out of range.
    """
    types, out = known(), {}
    for key, value in given.items():
        name = key.replace("-", "_")
        if name not in types:
            close = difflib.get_close_matches(name, types, n=1)
            guess = f"did you mean {close[0]}? " if close else ""
            raise UsageError(
                f"{where}: there is no option {key!r}",
                f"{guess}the options are {', '.join(sorted(types))}",
            )
        out[name] = _typed(name, value, types[name], where)
    fields = Request.__dataclass_fields__
    asked: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in out.items()
        if name in fields
    }
    try:
        Request(**asked).check()
        if "law" in out:
            presets.check_law(out["law"])
        parse_limits(out.get("limits"))
        if "material" in out:
            out["material"] = _materials(out["material"], folder)
    except UsageError as error:
        raise UsageError(f"{where}: {error.message}", error.hint) from error
    return out


def _typed(name: str, value: Any, kind: str, where: str) -> Any:
    """The value as the command line will read it."""
    if kind == "list":
        rows = [value] if isinstance(value, str) else value
        if isinstance(rows, list | tuple) and all(isinstance(row, str) for row in rows):
            return list(rows)
    elif isinstance(value, TYPES[kind]) and not (isinstance(value, bool) and kind != "bool"):
        if kind == "str":
            return str(value)
        if kind == "bool" or name == "filter_rate" or math.isfinite(value):
            return value
    wanted = {"list": "a list of texts", "str": "a text", "bool": "true or false"}
    raise UsageError(f"{where}: {name} is {value!r}", f"give {wanted.get(kind, f'one {kind}')}")


def parse(name: str, text: str, where: str) -> Any:
    """A value out of NAME=VALUE on the command line.  Raises UsageError for what is none."""
    kind = known().get(name.replace("-", "_"), "str")
    if kind == "bool" and text in ("true", "false"):
        return text == "true"
    if kind in ("int", "float"):
        try:
            return int(text) if kind == "int" else float(text)
        except ValueError:
            raise UsageError(f"{where}: {text!r} is no {kind}", "give a number") from None
    return text


def _materials(text: str, folder: Path) -> str:
    """Presets by name, auto, and material files by their absolute path."""
    auto = parse_auto(text, None)
    if auto is not None and auto.advisor:
        raise UsageError(
            f"--material {text}: a batch asks no advisor, whose answers may change between jobs",
            f"use {AUTO}, or bake the assets one by one",
        )
    if auto is not None:
        return AUTO
    parts = []
    for part in text.split(","):
        part = part.strip()
        if Path(part).suffix.lower() in USD:
            parts.append(str((folder / part).resolve()))
        else:
            parts.append(presets.find_preset(part).name)
    return ",".join(parts)


def material_files(options: Mapping[str, Any]) -> tuple[Path, ...]:
    """The material files among a job's materials."""
    parts = str(options.get("material", "")).split(",")
    return tuple(Path(part) for part in parts if Path(part).suffix.lower() in USD)


def decisive(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that decide what is written."""
    kept = {name: value for name, value in options.items() if name not in INDIFFERENT}
    return {"material": "rubber", **kept}
