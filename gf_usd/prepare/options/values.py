"""Converts Python values of options to texts of the command line.

A bake records the command that repeats it, so every value has a text: ``drop=3.0`` is 3.0,
``gravity=(0, -9.81, 0)`` is 0.0,-9.81,0.0.  Texts are passed unchanged.
"""

from __future__ import annotations

import inspect
import math
import numbers
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import PurePath
from typing import Any, TypeAlias

from gf_usd.core.errors import UsageError

Vector: TypeAlias = Iterable[float]  # three numbers: a tuple, a list or an array
Corners: TypeAlias = tuple[Vector, Vector]  # two opposite corners of a box
SHOWN = 60  # characters of a value in a message

# (name of the option, value) -> its text; raises UsageError for what it cannot be.
Write = Callable[[str, Any], str]


def refuse(name: str, value: Any, wanted: str) -> UsageError:
    """The error for an invalid value of an option."""
    shown = repr(value)
    if len(shown) > SHOWN:
        shown = f"{shown[:SHOWN]}..."
    return UsageError(f"{name} is {shown}, of type {type(value).__name__}", f"give {wanted}")


def is_number(value: Any) -> bool:
    """Whether a value is a real number of Python or NumPy; True and False are not."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def real(name: str, value: Any, wanted: str = "a number") -> float:
    """A number.  Raises UsageError for anything else, texts with digits included."""
    if is_number(value):
        return float(value)
    if isinstance(value, str) and _reads_as_number(value):
        raise refuse(name, value, f"{wanted}, without quotes: {name}={value.strip()}")
    raise refuse(name, value, wanted)


def _reads_as_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def whole(name: str, value: Any) -> int:
    """A whole number; 4e3 is one.  Raises UsageError for anything else."""
    number = real(name, value, "a whole number")
    if not number.is_integer():
        raise refuse(name, value, "a whole number")
    return int(value)


def positive(name: str, value: Any) -> int:
    """A whole number of at least 1.  Raises UsageError for anything else."""
    number = whole(name, value)
    if number < 1:
        raise UsageError(f"{name} is {number}", "give 1 or more")
    return number


def choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """One of the choices.  Raises UsageError for anything else."""
    if not isinstance(value, str):
        raise refuse(name, value, f"one of {', '.join(map(repr, choices))}")
    if value not in choices:
        raise UsageError(f"{name} is {value!r}", f"choose one of {', '.join(choices)}")
    return value


def switch(name: str, value: Any) -> bool:
    """True or False, of Python or NumPy.  Raises UsageError for anything else."""
    if isinstance(value, bool) or type(value).__name__ == "bool":
        return bool(value)
    raise refuse(name, value, f"True or False: {name}=True")


def text(name: str, value: Any, wanted: str = "a text") -> str:
    """A text.  Raises UsageError for anything else, and for an empty one."""
    if isinstance(value, str) and value.strip():
        return str(value)
    raise refuse(name, value, wanted)


def digits(value: float) -> str:
    """The shortest decimal representation of a number."""
    return repr(float(value)).removesuffix(".0")


def items(name: str, value: Any, wanted: str) -> tuple[Any, ...]:
    """The members of a list, tuple, set or array; not the letters of a text."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise refuse(name, value, wanted)
    return tuple(value)


def triple(name: str, value: Any, wanted: str) -> str:
    """Three numbers as x,y,z."""
    parts = items(name, value, wanted)
    if len(parts) != 3 or not all(is_number(part) for part in parts):
        raise refuse(name, value, wanted)
    return ",".join(digits(part) for part in parts)


def _is_triple(value: Any) -> bool:
    listed = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
    return listed and all(is_number(part) for part in value)


def path(name: str, value: Any) -> str:
    """A path of `pathlib`, or a text.  A path object without a suffix is a folder."""
    if isinstance(value, str | os.PathLike):
        found = os.fspath(value)
        if isinstance(found, str) and found:
            folder = isinstance(value, PurePath) and not value.suffix
            return f"{found}/" if folder and not found.endswith("/") else found
    raise refuse(name, value, "a path: a text, or an object of pathlib")


def variant(name: str, value: Any) -> str | None:
    """The name of a variant; None: none is chosen."""
    wanted = "the name of a variant, such as 'rubber'"
    return None if value is None else text(name, value, wanted)


def prim(
    name: str,
    value: Any,
    wanted: str = "the path of a prim, such as '/World/Duck', or a list of them",
) -> str:
    """The path of a prim: a text, an Sdf.Path, or a prim."""
    found = value.GetPath() if hasattr(value, "GetPath") else value
    if hasattr(found, "pathString"):
        found = found.pathString
    return text(name, found, wanted)


def length(name: str, value: Any) -> str:
    """A length in stage units, or in radii as "3r"."""
    wanted = "a length such as 2.5 (stage units), or the text '3r' (radii of the body)"
    return value if isinstance(value, str) else digits(real(name, value, wanted))


def frames(name: str, value: Any) -> str:
    """A number of frames, "rest", or "rest:480"."""
    return value if isinstance(value, str) else str(whole(name, value))


def repeats(name: str, value: Any) -> str | None:
    """A number of times, or "auto" for True; None, which is once, for False."""
    if isinstance(value, bool):
        return "auto" if value else None
    return value if isinstance(value, str) else str(whole(name, value))


def rate(name: str, value: Any) -> str:
    """A factor, or "auto"."""
    return value if isinstance(value, str) else digits(real(name, value, "a number, or 'auto'"))


def edge(name: str, value: Any) -> str:
    """A length in stage units, or "auto"."""
    wanted = "a length such as 0.1 (stage units), or 'auto'"
    return value if isinstance(value, str) else digits(real(name, value, wanted))


def gravity(name: str, value: Any) -> str:
    """A number along minus up, or a vector."""
    wanted = "9.81 (m/s^2, downward), or three numbers: (0, -9.81, 0)"
    if isinstance(value, str):
        return value
    return digits(value) if is_number(value) else triple(name, value, wanted)


def vector(name: str, value: Any) -> str:
    """Three numbers."""
    if isinstance(value, str):
        return text(name, value)
    return triple(name, value, "three numbers: (0, 2, 0)")


def paths(name: str, value: Any) -> tuple[str, ...]:
    """Paths of files, of a list or a single one."""
    if isinstance(value, str | os.PathLike):
        return (os.fspath(text(name, os.fspath(value))),)
    wanted = "the path of a file, or a list of them"
    return tuple(
        text(name, os.fspath(path(name, one)), wanted) for one in items(name, value, wanted)
    )


def floor(name: str, value: Any) -> str:
    """A height, a normal, (height, normal), or "none" for False."""
    wanted = "a height such as 0.5, a normal (0.2, 1, 0), both as (0.5, (0.2, 1, 0)), or False"
    if isinstance(value, str):
        return value
    if value is False:
        return "none"
    if is_number(value):
        return digits(value)
    if _is_triple(value):
        return triple(name, value, wanted)
    parts = items(name, value, wanted)
    if len(parts) != 2 or not is_number(parts[0]):
        raise refuse(name, value, wanted)
    return f"{digits(parts[0])}:{triple(name, parts[1], wanted)}"


def span(name: str, value: Any) -> str:
    """Two time codes, None where the range is open."""
    wanted = "two time codes such as (1, 24), or (10, None) where it is open"
    if isinstance(value, str):
        return value
    if isinstance(value, range | slice):
        raise refuse(name, value, f"{wanted}: the last one is included")
    return _pair(name, value, wanted, lambda end: end is None or is_number(end))


def sweep(name: str, value: Any) -> str:
    """A property with its range, as (NAME, LOW, HIGH, COUNT)."""
    wanted = "a text such as 'youngs=1e4:1e6:5', or a tuple such as ('youngs', 1e4, 1e6, 5)"
    if isinstance(value, str):
        return value
    parts = items(name, value, wanted)
    if len(parts) != 4 or not isinstance(parts[0], str) or not all(map(is_number, parts[1:])):
        raise refuse(name, value, wanted)
    return f"{parts[0]}={':'.join(digits(part) for part in parts[1:])}"


def stretches(name: str, value: Any) -> str:
    """Two limits of stretch, or "none" for False."""
    wanted = "two stretches about 1 such as (0.2, 5), or False"
    if isinstance(value, str):
        return value
    if value is False:
        return "none"
    return _pair(name, value, wanted, is_number)


def _pair(name: str, value: Any, wanted: str, fits: Callable[[Any], bool]) -> str:
    """Two ends as a:b, nothing for None."""
    ends = items(name, value, wanted)
    if len(ends) != 2 or not all(fits(end) for end in ends):
        raise refuse(name, value, wanted)
    return ":".join("" if end is None else digits(end) for end in ends)


def cap(name: str, value: Any) -> str:
    """A stress, or "none" for False."""
    if isinstance(value, str):
        return value
    return "none" if value is False else digits(real(name, value, "a stress [Pa], or False"))


def precision(name: str, value: Any) -> str:
    """A length [m], or a text such as "0.5%" or "0.2mm"."""
    wanted = "a length [m], or a text such as '0.5%' (of the radius) or '0.2mm'"
    return value if isinstance(value, str) else f"{digits(real(name, value, wanted))}m"


def comma_separated(name: str, value: Any) -> str:
    """Several words with commas between."""
    wanted = "a word, or a list of words"
    if isinstance(value, str):
        return text(name, value, wanted)
    found = items(name, value, wanted)
    if not found:
        raise refuse(name, value, wanted)
    return ",".join(text(name, one, wanted) for one in found)


def pin(name: str, value: Any) -> str:
    """The path of a prim, or the two corners of a box."""
    if _is_box(value):
        return f"box:{_corners(name, value)}"
    if hasattr(value, "GetPath") or hasattr(value, "pathString"):
        return prim(name, value)
    wanted = "the path of a prim, or two corners of a box: ((-1, 0, -1), (1, 0.2, 1))"
    return text(name, value, wanted)


def _is_box(value: Any) -> bool:
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        return False
    ends = tuple(value)
    return len(ends) == 2 and all(_is_triple(end) for end in ends)


def _corners(name: str, value: Any) -> str:
    wanted = "two corners of a box: ((-1, 0, -1), (1, 0.2, 1))"
    return ",".join(triple(name, corner, wanted) for corner in value)


def boxes(name: str, value: Any) -> tuple[str, ...]:
    """Presets of boxes: {preset: (corner, corner)}, or with a list of boxes; or texts."""
    wanted = "presets with boxes: {'metal': ((-1, 0, -1), (1, 0.2, 1))}"
    if not isinstance(value, Mapping):
        return texts(name, value, wanted)
    found: list[str] = []
    for preset, regions in value.items():
        each = (regions,) if _is_box(regions) else items(name, regions, wanted)
        if not all(map(_is_box, each)):
            raise refuse(name, value, wanted)
        found += [f"{text(name, preset, wanted)}:{_corners(name, one)}" for one in each]
    return tuple(found)


def fields(name: str, value: Any) -> tuple[str, ...]:
    """Texts, of a list or a single one."""
    wanted = "a field such as 'wind:3,0,0', or a list of them"
    return (value,) if isinstance(value, str) else texts(name, value, wanted)


def conversions(name: str, value: Any) -> tuple[str, ...]:
    """Texts, of a list or a single one."""
    return texts(name, value, "a material and limit such as 'honey@time:48', or a list of them")


def labels(name: str, value: Any) -> tuple[str, ...]:
    """Presets of labels: {property: {value: preset}}; or texts."""
    wanted = "presets of labels: {'label': {3: 'metal'}}"
    if not isinstance(value, Mapping):
        return texts(name, value, wanted)
    found: list[str] = []
    for label, presets in value.items():
        if not isinstance(presets, Mapping) or not all(map(is_number, presets)):
            raise refuse(name, value, wanted)
        found += [
            f"{text(name, label, wanted)}={whole(name, number)}:{text(name, preset, wanted)}"
            for number, preset in presets.items()
        ]
    return tuple(found)


def texts(name: str, value: Any, wanted: str) -> tuple[str, ...]:
    """Texts, of a list or a single one."""
    if isinstance(value, str):
        return (text(name, value, wanted),)
    return tuple(text(name, one, wanted) for one in items(name, value, wanted))


def prims(name: str, value: Any) -> tuple[str, ...]:
    """Paths of prims, of a list or a single one."""
    wanted = "the path of a prim, such as '/World/Duck', or a list of them"
    if isinstance(value, str) or hasattr(value, "GetPath") or hasattr(value, "pathString"):
        return (prim(name, value),)
    return tuple(prim(name, one) for one in items(name, value, wanted))


def pins(name: str, value: Any) -> tuple[str, ...]:
    """Regions, of a list or a single one."""
    wanted = "the path of a prim, two corners of a box, or a list of them"
    named = isinstance(value, str) or hasattr(value, "GetPath") or hasattr(value, "pathString")
    if named or _is_box(value):
        return (pin(name, value),)
    return tuple(pin(name, one) for one in items(name, value, wanted))


def material(name: str, value: Any) -> Any:
    """Presets and material files with commas between; a tuple where a `Material` is among them."""
    from gf_usd.core.materials.material import Material

    wanted = "a preset such as 'rubber', a USD file, a gf_usd.Material, or a list of them"
    single = isinstance(value, str | os.PathLike | Material)
    if isinstance(value, Mapping):
        raise refuse(
            name, value, f"{wanted}; material_boxes and material_labels give regions their own"
        )
    if hasattr(value, "material") and not isinstance(value, Material):
        raise refuse(name, value, "the name of a preset, or what its method material(radius) makes")
    found: list[Any] = []
    for one in (value,) if single else items(name, value, wanted):
        if isinstance(one, Material):
            found.append(checked_material(one))
        elif isinstance(one, os.PathLike):
            found.append(os.fspath(one))
        else:
            found.append(text(name, one, wanted))
    if not found:
        raise refuse(name, value, wanted)
    return tuple(found) if any(isinstance(one, Material) for one in found) else ",".join(found)


def checked_material(given: Any) -> Any:
    """A `Material` with valid values.  Raises UsageError for an invalid one."""
    from gf_usd.core.materials.laws import LAWS, check_law, law_parameters

    where = f"material {given.name!r}"
    if not isinstance(given.name, str) or not given.name.replace("-", "_").isidentifier():
        raise UsageError(
            f"a material is named {given.name!r}",
            "give it a name of letters, digits, _ and -: files and variants are called after it",
        )
    check_law(given.law)
    for key, low, high, open_ in (
        ("density", 0.0, math.inf, True),
        ("youngs_modulus", 0.0, math.inf, True),
        ("poissons_ratio", -1.0, 0.5, True),
        ("damping_time", 0.0, 1e6, False),
        ("friction", 0.0, 100.0, False),
        ("restitution", 0.0, 1.0, False),
    ):
        value = real(f"{where}: {key}", getattr(given, key))
        inside = low < value < high if open_ else low <= value <= high
        if not inside:
            between = f"between {low:g} and {high:g}, without these"
            bounds = between if open_ else f"from {low:g} to {high:g}"
            bounds = f"above {low:g}" if high == math.inf else bounds
            raise UsageError(f"{where}: {key} is {value:g}", f"give a number {bounds}")
    known = {p.name: p for p in law_parameters([given.law])}
    for key, value in given.parameters.items():
        if key not in known:
            others = ", ".join(known) or "none"
            raise UsageError(
                f"{where}: the law {given.law} has no parameter {key!r}",
                f"its parameters are: {others}; the laws are {', '.join(LAWS)}",
            )
        low, high = known[key].low, known[key].high
        if not low <= real(f"{where}: {key}", value) <= high:
            raise UsageError(
                f"{where}: {key} is {value:g}", f"give a number from {low:g} to {high:g}"
            )
    return given


def progress_callback(name: str, value: Any) -> Any:
    """A function of two numbers; None: no listener."""
    if value is None:
        return None
    wanted = "a function of (frames done, total frames)"
    if not callable(value):
        raise refuse(name, value, wanted)
    try:
        inspect.signature(value).bind(1, 2)
    except TypeError:
        raise refuse(name, value, wanted) from None
    except ValueError:  # of a function in C, nothing is known
        return value
    return value


def limits(name: str, value: Any) -> Any:
    """Limits of the reading process: the text of the command line, a dict, or `Limits`.

    False : no separate process.
    """
    from gf_usd.system.sandbox import Limits, parse_limits

    wanted = "limits such as {'time': 600, 'memory': 32e9}, or False for none"
    if value is False:
        return None
    if isinstance(value, Limits):
        return value
    if isinstance(value, Mapping):
        known = asdict(Limits())
        for key, most in value.items():
            if key not in known or not is_number(most) or not 0.0 < most < math.inf:
                raise UsageError(
                    f"{name}: {key!r} is {most!r}",
                    f"give numbers above 0 for {', '.join(known)}: {name}={{'time': 600}}",
                )
        return Limits(**{key: float(most) for key, most in value.items()})
    return parse_limits(text(name, value, wanted))
