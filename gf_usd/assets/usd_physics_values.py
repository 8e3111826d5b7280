"""Attributes of physics as checked numbers."""

from __future__ import annotations

import difflib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd

from gf_usd.errors import InputError
from gf_usd.model import Floats


def authored(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> Any:
    """The authored value of an attribute; None where there is none."""
    attribute = prim.GetAttribute(name)
    return attribute.Get(time) if attribute and attribute.HasAuthoredValue() else None


def number(path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float | None:
    """An authored number that is 0 or more; None where none is.

    path : the file, for messages.  Raises InputError for anything else.
    """
    value = authored(prim, name, time)
    if value is None:
        return None
    if not isinstance(value, float | int) or not 0.0 <= value < np.inf:
        raise refuse(path, prim, name, value, "author a number of 0 or more (0: not stated)")
    return float(value)


def count(path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode) -> int | None:
    """An authored whole number, 0 or more; None where none is.  Raises InputError for another."""
    value = authored(prim, name, time)
    if value is not None and not (isinstance(value, int) and value >= 0):
        raise refuse(path, prim, name, value, "author a whole number of 0 or more")
    return value


def flag(path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode) -> bool | None:
    """An authored truth; None where there is none.  Raises InputError for what is no bool."""
    value = authored(prim, name, time)
    if value is not None and not isinstance(value, bool):
        raise refuse(path, prim, name, value, "author it as a bool")
    return value


def word(
    path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode, known: Collection[str]
) -> str | None:
    """An authored token, one of those known; None where there is none.

    Raises InputError for another, with the nearest in the hint.
    """
    value = authored(prim, name, time)
    if value is None or (isinstance(value, str) and value in known):
        return value
    close = difflib.get_close_matches(str(value), known, n=1)
    guess = f"did you mean {close[0]}? " if close else ""
    shown = ", ".join(one for one in known if one)
    raise refuse(path, prim, name, value, f"{guess}author one of {shown}")


def vector(
    path: Path,
    prim: Usd.Prim,
    name: str,
    time: Usd.TimeCode,
    *,
    unstated: float | None = None,
) -> Floats | None:
    """An authored vector (3,), finite; None where none is, or all three say `unstated`.

    Raises InputError for another.
    """
    value = authored(prim, name, time)
    if value is None:
        return None
    try:
        made = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        made = np.zeros(0)
    if unstated is not None and made.shape == (3,) and (made == unstated).all():
        return None
    if made.shape != (3,) or not np.isfinite(made).all():
        raise refuse(path, prim, name, value, "author three finite numbers")
    return made


def refuse(path: Path, prim: Usd.Prim, name: str, value: object, hint: str) -> InputError:
    """The error for a value that makes no sense."""
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return InputError(f"{path}: <{prim.GetPath()}>: {name} is {shown}", hint)
