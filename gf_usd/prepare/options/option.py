"""One option of a bake, and how a table of options is read.

A table is a dataclass.  A field with an `Option` in its annotation is a row: the field gives the
name, the type and the default, the `Option` gives the rest.

    friction: Annotated[float | None, Option(MATERIAL, "Coulomb's.", low=0.0, high=100.0)] = None
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, Field, dataclass, fields, replace
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args, get_origin

from gf_usd.core.errors import UsageError, did_you_mean
from gf_usd.core.units import positive
from gf_usd.prepare.options import values

BAKE = ("bake",)
BATCH = ("bake", "batch")  # a manifest may give it, too
PLAN = ("bake", "batch", "inspect")  # what decides the plan, which an inspection shows
DEFAULT = "default"  # as a value: the default, whatever else is set
PLAIN: tuple[type, ...] = (int, float, bool, str)  # what an argument becomes

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Option:
    """A row of a table of options."""

    group: str  # heading that it is listed under
    help: str  # one or two sentences, with the unit in brackets
    _: KW_ONLY
    shown: str = ""  # default in the help, where the value is None
    short: str = ""  # "-m"
    low: float | None = None  # smallest value, included
    high: float = math.inf  # largest value, included
    above_zero: bool = False  # instead of low and high
    noun: str = "number"  # what the value is, for the hint
    choices: tuple[str, ...] = ()
    bare: str = ""  # value of the flag alone; "": it needs a value
    parse: Callable[[str], Any] | None = None  # a text to its value; raises UsageError
    # (name, value of Python) to the text, or to the texts of a list; raises UsageError
    write: Callable[[str, Any], Any] | None = None
    commands: tuple[str, ...] = PLAN
    decides: bool = True  # it affects what is written
    # read from the field
    name: str = ""  # in Python
    kind: type = str  # one of PLAIN, of each item where it is repeated
    default: Any = None
    repeated: bool = False

    @property
    def two_way(self) -> bool:
        """Whether a flag has a negative form, which overrides a preset."""
        return self.kind is bool and self.default is None

    @property
    def takes_default(self) -> bool:
        """Whether the text DEFAULT is no value of its own: an output may have that name."""
        return self.name != "output"

    @property
    def flag(self) -> str:
        """The option's name on the command line; for a list, it is given once per item."""
        name = self.name
        if self.repeated:
            name = name.removesuffix("es") if name.endswith("xes") else name.removesuffix("s")
        return f"--{name.replace('_', '-')}"

    def value(self, text: str | None) -> Any:
        """The value of a text; None where the option is not set.  Raises UsageError."""
        return None if text is None or self.parse is None else self.parse(text)

    def take(self, value: Any) -> Any:
        """The command-line value of a Python value; None and DEFAULT: the default.

        Raises UsageError for an invalid value.
        """
        if value is None or (isinstance(value, str) and value == DEFAULT and self.takes_default):
            return self.default
        if self.write is not None:
            return self.write(self.name, value)
        if self.choices and isinstance(value, str):
            return value
        wanted = f"one of {', '.join(map(repr, self.choices))}" if self.choices else "a text"
        take: dict[type, Callable[[], Any]] = {
            bool: lambda: values.switch(self.name, value),
            int: lambda: values.whole(self.name, value),
            float: lambda: values.real(self.name, value),
            str: lambda: values.text(self.name, value, wanted),
        }
        return take[self.kind]()

    def check(self, value: Any) -> None:
        """Raise UsageError for a number out of range, or a text that is none of the choices."""
        if value is None:
            return
        if self.parse is not None:
            self.value(value)
        if self.choices and value not in self.choices:
            raise UsageError(f"there is no {self.name} {value!r}", _choose(self, str(value)))
        if self.above_zero:
            positive(self.flag, value)
        elif self.low is not None and not self.low <= value <= self.high:
            whole = self.kind is int
            ends = math.isfinite(self.high)
            most = str(self.high) if whole else f"{self.high:g}"
            to = f"to {most}" if ends else "or more"
            verb = "from" if ends else "of"
            shown = str(value) if whole else f"{value:g}"
            raise UsageError(
                f"{self.flag} is {shown}", f"give a {self.noun} {verb} {self.low:g} {to}"
            )
        elif self.kind is float and self.low is None and not math.isfinite(value):
            raise UsageError(f"{self.flag} is {value}", f"give a finite {self.noun}")


def _choose(option: Option, value: str) -> str:
    if option.choices[2:] and (guess := did_you_mean(value, option.choices)):
        return f"{guess}choose one of {', '.join(option.choices)}"
    *others, last = option.choices
    if not others:
        return f"the only {option.name} is {last}"
    if not others[1:]:
        return f"choose {others[0]} or {last}"
    return f"choose {', '.join(option.choices)}"


@dataclass_transform(kw_only_default=True, frozen_default=True)
def table(made: type[T]) -> type[T]:
    """Make a dataclass for reading only, without its generated methods, which take long to
    compile.
    """
    bare = dataclass(frozen=True, kw_only=True, init=False, repr=False, eq=False)
    return bare(made)


def rows(table: type) -> dict[str, Option]:
    """The options of a dataclass by their names, in its order."""
    found = (_row(field) for field in fields(table))
    return {row.name: row for row in found if row is not None}


def _row(field: Field[Any]) -> Option | None:
    if get_origin(field.type) is not Annotated:
        return None
    hint, option = get_args(field.type)
    repeated = isinstance(field.default, tuple)
    kinds = [kind for kind in (*get_args(hint), hint) if kind in PLAIN]
    # what may be a text is one on the command line
    kind = str if repeated or str in kinds or not kinds else kinds[0]
    return replace(option, name=field.name, kind=kind, default=field.default, repeated=repeated)


def command_arguments(options: Mapping[str, Option], given: Mapping[str, Any]) -> list[str]:
    """The command-line arguments for these values; None and False are omitted."""
    out: list[str] = []
    for name, value in given.items():
        flag = options[name].flag
        if value is None:
            continue
        if value is True:
            out.append(flag)
        elif value is False:
            out += [f"--no-{flag[2:]}"] if options[name].two_way else []
        elif isinstance(value, float):
            out += [flag, str(value).removesuffix(".0")]
        else:
            items = value if isinstance(value, list | tuple) else (value,)
            out += [argument for item in items for argument in (flag, str(item))]
    return out
