"""Options for fields: body forces in addition to gravity, and gravity keys in a file."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from gf_usd.core.errors import UsageError
from gf_usd.core.units import STRONGEST, code_text, number

if TYPE_CHECKING:
    from gf_usd.core.frames.settings import Field

FORM = (
    "wind:X,Y,Z, radial:A:at=X,Y,Z or noise:A:length=L:rate=R, in m/s^2, with :at=X,Y,Z:radius=R"
    " for a falloff"
)
KINDS: dict[str, tuple[str, ...]] = {
    "wind": (),
    "radial": ("at",),
    "noise": ("length",),
}  # and the values that each requires
KEYS = ("at", "radius", "length", "rate")
KEY_FILES = (".csv", ".txt")

Triple = tuple[float, float, float]


def parse_field(text: str, option: str = "--field") -> Field:
    """The field of a text, with lengths in stage units.

    option : what messages call it.  Raises UsageError for what is none.
    """
    from gf_usd.core.frames.settings import Field

    where = f"{option} {text or repr(text)}"
    kind, _, rest = text.partition(":")
    first, *pairs = rest.split(":")
    parts = {key: value for key, _, value in (pair.partition("=") for pair in pairs)}
    if kind not in KINDS or len(parts) < len(pairs) or not set(parts) <= set(KEYS):
        raise UsageError(f"{where} is not a field", f"give {FORM}")
    missing = [key for key in KINDS[kind] if key not in parts]
    if missing or ("radius" in parts and "at" not in parts):
        raise UsageError(f"{where} does not give {missing[0] if missing else 'at'}", f"give {FORM}")
    there = Field(
        kind=kind,
        center=_triple(where, parts["at"]) if "at" in parts else (0.0, 0.0, 0.0),
        radius=_positive(where, parts["radius"]) if "radius" in parts else None,
        length=_positive(where, parts["length"]) if "length" in parts else 1.0,
        rate=_positive(where, parts["rate"]) if "rate" in parts else 0.0,
    )
    if kind == "wind":
        return replace(there, vector=_strong(where, _triple(where, first)))
    (strength,) = _strong(where, (number(where, first, FORM),))
    return replace(there, strength=strength)


def in_meters(field: Field, unit: float) -> Field:
    """A field with lengths in stage units converted to meters."""
    x, y, z = field.center
    return replace(
        field,
        center=(x * unit, y * unit, z * unit),
        radius=None if field.radius is None else field.radius * unit,
        length=field.length * unit,
    )


def _positive(where: str, part: str) -> float:
    value = number(where, part, FORM)
    if not value > 0.0:
        raise UsageError(f"{where} has {part} instead of a number above 0", f"give {FORM}")
    return value


def _triple(where: str, part: str) -> Triple:
    values = [number(where, one, FORM) for one in part.split(",")]
    if len(values) != 3:
        raise UsageError(f"{where} has {len(values)} numbers and not three", f"give {FORM}")
    x, y, z = values
    return x, y, z


T = TypeVar("T", bound=tuple[float, ...])


def _strong(where: str, values: T) -> T:
    if max(map(abs, values)) > STRONGEST:
        raise UsageError(f"{where} is too strong", f"give at most {STRONGEST:g} m/s^2")
    return values


@dataclass(frozen=True, kw_only=True)
class GravityKeys:
    """Gravity at some time codes; linear in between, constant before and after."""

    times: tuple[float, ...]  # time codes, ascending
    values: tuple[float | Triple, ...]  # [m/s^2] along minus up, or a vector


def is_key_file(text: str) -> bool:
    """Whether a text is the path of a file of keys."""
    return text.lower().endswith(KEY_FILES)


def upward_note(value: object) -> tuple[str, ...]:
    """A note on a negative number, which in other programs points down; none on keys."""
    if not isinstance(value, float) or value >= 0.0:
        return ()
    return (f"gravity of {value:g} m/s^2 points up: numbers above 0 point down",)


def read_gravity_keys(path: Path) -> GravityKeys:
    """The keys of a file with lines `time code, g` or `time code, x, y, z` [m/s^2].

    Empty lines and comments after # are ignored.  Raises UsageError for an invalid file.
    """
    hint = "give lines such as 1,9.81 or 1,0,-9.81,0: a time code and m/s^2"
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"--gravity {path} cannot be read: {error}", hint) from error
    times: list[float] = []
    values: list[float | Triple] = []
    for line, row in enumerate(csv.reader(one.partition("#")[0] for one in lines), 1):
        if not any(part.strip() for part in row):
            continue
        if len(row) not in (2, 4):
            raise UsageError(f"--gravity {path}: line {line} has {len(row)} numbers", hint)
        where = f"--gravity {path}: line {line}"
        code, *given = (number(where, part.strip(), hint) for part in row)
        if times and code <= times[-1]:
            raise UsageError(
                f"{where}: time code {code_text(code)} follows {code_text(times[-1])}",
                "sort the lines",
            )
        if max(map(abs, given)) > STRONGEST:
            most = max(map(abs, given))
            raise UsageError(f"{where} has {most:g}", f"give at most {STRONGEST:g} m/s^2")
        times.append(code)
        values.append(given[0] if len(given) == 1 else (given[0], given[1], given[2]))
    if not times:
        raise UsageError(f"--gravity {path} has no line", hint)
    return GravityKeys(times=tuple(times), values=tuple(values))
