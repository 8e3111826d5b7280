"""Calls from Python of functions that take an asset: their keywords are the table of options.

Type checkers and editors get the keywords from the types; ``help()`` and notebooks get them at run
time.
"""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, fields, replace
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, ParamSpec, Protocol, TypeVar, cast, get_args, get_origin

from gf_usd.core.errors import GfUsdError, UsageError
from gf_usd.prepare.options.table import OPTIONS, nearest, taken
from gf_usd.prepare.options.values import refuse
from gf_usd.system.atomic_files import require_working_folder

P = ParamSpec("P")
R = TypeVar("R", covariant=True)
Q = ParamSpec("Q")
S = TypeVar("S")


class OfAsset(Protocol[P, R]):
    """A function of an asset, with the parameters P."""

    def __call__(self, path: str | os.PathLike[str], *args: P.args, **options: P.kwargs) -> R: ...


def takes(table: Callable[P, Any]) -> Callable[[Callable[..., R]], OfAsset[P, R]]:
    """Give a function ``(path, **options)`` the fields of a table of options for its keywords.

    The function gets values in the form of the command line; see `option.Option.take`.  What it
    raises names keywords instead of the options of the command line.
    """

    def decorate(function: Callable[..., R]) -> OfAsset[P, R]:
        name = function.__name__

        @wraps(function)
        def call(*args: Any, **options: Any) -> R:
            path = options.pop("path", None) if not args else args[0]
            with naming(replace(BAKE, kept=_file_names(path, options.get("output")))):
                require_working_folder()
                if args[1:]:
                    raise UsageError(
                        f"{name}() takes the asset and keyword arguments, but {args[1]!r} has "
                        f"no keyword",
                        f"give its keyword: {name}({args[0]!r}, material={args[1]!r})",
                    )
                return function(asset_path(path), **taken(options, name))

        own, made = inspect.signature(function), cast(Any, table)
        path = inspect.Parameter(
            "path", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation="str | os.PathLike[str]"
        )
        parameters = [
            path.replace(
                name=field.name,
                kind=path.KEYWORD_ONLY,
                default=field.default,
                annotation=get_args(field.type)[0] if _is_row(field.type) else field.type,
            )
            for field in fields(made)
        ]
        signature = own.replace(parameters=[path, *parameters])
        call.__signature__ = signature  # type: ignore[attr-defined]
        return call

    return decorate


def named(function: Callable[Q, S]) -> Callable[Q, S]:
    """Make a function refuse unknown keywords with the same message as functions of `takes`."""
    name, known = function.__name__, inspect.signature(function).parameters

    @wraps(function)
    def call(*args: Q.args, **options: Q.kwargs) -> S:
        for one in options:
            if one not in known:
                hint = f"{nearest(one, known)}its options are {', '.join(sorted(known))}"
                raise UsageError(f"{name}() has no option {one!r}", hint)
        return function(*args, **options)

    return call


def _file_names(*paths: Any) -> tuple[str, ...]:
    """Texts of paths, and their last parts, as messages have them."""
    texts = [os.fspath(path) for path in paths if isinstance(path, str | os.PathLike)]
    given = [Path(text) for text in texts if isinstance(text, str)]
    return tuple(dict.fromkeys(text for path in given for text in (str(path), path.name) if text))


def _is_row(hint: Any) -> bool:
    return get_origin(hint) is Annotated


def asset_path(path: Any) -> Path:
    """The path of an asset.  Raises UsageError for other values."""
    if isinstance(path, str | os.PathLike) and isinstance(os.fspath(path), str) and str(path):
        return Path(path)
    if hasattr(path, "GetRootLayer"):
        raise UsageError(
            "the asset is a stage, but it is read from a file",
            "export it first with stage.Export('asset.usda') and give the path of that file",
        )
    if isinstance(path, Sequence) and not isinstance(path, str | bytes):
        raise refuse("the asset", path, "one path; a loop, or gf-usd batch, bakes several")
    raise refuse("the asset", path, "the path of a file, such as 'duck.usda'")


OPTION = re.compile(r"(?<![\w/.~-])--?[a-z][a-z-]*(?![\w/]|\.\w)")
# Names, which are not changed: quoted, prim paths, and paths of files, which may have spaces.
NAME = (
    r"(?<!\w)'[^'\n]*'(?!\w)",
    r'"[^"\n]*"',
    r"<[^<>\n]*>",
    r"@[^@\n]*@",
    r"(?<!\S)[./~]*/(?:(?! or |, |; |: )[^\n'\"<>])*?"
    r"\.(?:usd[acz]?|ply|obj|stl|off|gltf|glb|json)\b",
)
# An option with a value that Python can be given in its place.
GIVEN = re.compile(
    rf"({OPTION.pattern})(?: (auto|none|-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)(?![\w:%/]|[.,]\s?-?\d))?"
)
WITHOUT = ("floor", "clamp", "stress_cap", "limits")  # are False where the command line has "none"
# Where a hint can be cut: text in parentheses, and alternatives.
ASIDE = re.compile(r"\s*\([^()]*\)")
CLAUSES = re.compile(r"(; |, or |, )")


@dataclass(frozen=True, kw_only=True)
class Keywords:
    """How a function of Python calls the options of the command line."""

    known: Mapping[str, str]  # keywords, by the options with their dashes
    absent: frozenset[str] = frozenset()  # options that it has no counterpart of
    kept: tuple[str, ...] = ()  # names of files, which are not changed

    def text(self, text: str) -> str:
        """A message, with keywords in place of options."""
        names = "|".join((*map(re.escape, self.kept), *NAME))
        return re.sub(f"{names}|{GIVEN.pattern}", self._keyword, text)

    def _keyword(self, found: re.Match[str]) -> str:
        option, value = found.groups()
        if option is None:  # a name
            return found[0]
        keyword = self.known.get(option)
        if value == "none" and keyword in WITHOUT:
            return f"{keyword}=False"
        if keyword is None or value in (None, "none") or not keyword.isidentifier():
            return found[0] if keyword is None else keyword + found[0][len(option) :]
        return f"{keyword}={value!r}" if value == "auto" else f"{keyword}={value}"

    def in_notes(self, result: Any) -> Any:
        """A result whose notes have keywords in place of options."""
        return replace(result, notes=tuple(map(self.text, result.notes)))

    def hint(self, text: str) -> str:
        """A hint or a note, with keywords, and without the clauses on what cannot be given.

        A clause that all others depend on stays.
        """
        if not self._impossible(text):
            return self.text(text)
        short = ASIDE.sub(lambda found: "" if self._impossible(found[0]) else found[0], text)
        first, *rest = CLAUSES.split(short)
        clauses = [("", first), *zip(rest[::2], rest[1::2], strict=True)]
        kept = [(join, one) for join, one in clauses if not self._impossible(one)] or clauses
        return self.text(kept[0][1] + "".join(join + one for join, one in kept[1:]))

    def _impossible(self, text: str) -> bool:
        return any(found in self.absent for found in OPTION.findall(text))


@contextmanager
def naming(names: Keywords) -> Iterator[Keywords]:
    """Have errors name the keywords of a function."""
    try:
        yield names
    except GfUsdError as error:
        in_python(error, names)
        raise


def keywords(*own: str, **renamed: str) -> AbstractContextManager[Keywords]:
    """Have errors name the keywords of Python: ``--max-hours`` is max_hours.

    Yields them, for the notes of a result.

    own : keywords of the function that are called as on the command line; renamed : others, by
    their names there.  All other options are those of a bake.
    """
    mine = {**{name: name for name in own}, **renamed}
    more = {f"--{name.replace('_', '-')}": keyword for name, keyword in mine.items()}
    return naming(Keywords(known={**BAKE.known, **more}))


def in_python(error: GfUsdError, names: Keywords) -> None:
    """Have an error name keywords."""
    error.message = names.text(error.message)
    error.hint = names.hint(error.hint)
    error.args = (error.message,)


def _spellings(names: Iterable[str] = OPTIONS) -> dict[str, str]:
    """Keywords of options of a bake, by what the command line calls them."""
    found: dict[str, str] = {}
    for name in names:
        option = OPTIONS[name]
        found[option.flag] = f"{name}=True" if option.kind is bool else name
        if option.short:
            found[option.short] = name
        if option.two_way:
            found[f"--no-{option.flag[2:]}"] = f"{name}=False"
    return found


BAKE = Keywords(known={**_spellings(), "-o": "output"})


def keywords_of(*names: str, **renamed: str) -> Keywords:
    """Of a function that has some options of a bake; renamed : others, which it calls otherwise."""
    known = {
        **_spellings(names),
        **{OPTIONS[name].flag: keyword for name, keyword in renamed.items()},
    }
    return Keywords(known=known, absent=frozenset(BAKE.known) - frozenset(known))
