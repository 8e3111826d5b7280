"""Calls from Python of functions that take an asset: their keywords are the table of options.

Type checkers and editors get the keywords from the types; ``help()`` and notebooks get them at run
time.
"""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
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
            with keywords():
                require_working_folder()
                path = options.pop("path", None) if not args else args[0]
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
        asked = [
            path.replace(
                name=field.name,
                kind=path.KEYWORD_ONLY,
                default=field.default,
                annotation=get_args(field.type)[0] if _is_row(field.type) else field.type,
            )
            for field in fields(made)
        ]
        signature = own.replace(parameters=[path, *asked])
        call.__signature__ = signature  # type: ignore[attr-defined]
        return call

    return decorate


def named(function: Callable[Q, S]) -> Callable[Q, S]:
    """Have a function refuse a keyword that it does not have in the words of `takes`."""
    name, known = function.__name__, inspect.signature(function).parameters

    @wraps(function)
    def call(*args: Q.args, **options: Q.kwargs) -> S:
        for one in options:
            if one not in known:
                hint = f"{nearest(one, known)}its options are {', '.join(sorted(known))}"
                raise UsageError(f"{name}() has no option {one!r}", hint)
        return function(*args, **options)

    return call


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


SHORT = {option.short: name for name, option in OPTIONS.items() if option.short}
OPTION = re.compile(r"(?<![\w-])--?[a-z][a-z-]*")


@contextmanager
def keywords(*own: str, **renamed: str) -> Iterator[None]:
    """Have errors name the keywords of Python: ``--max-hours`` is max_hours.

    own : keywords of the function that are called as on the command line; renamed : others, by
    their names there; none: the options of a bake.
    """
    mine = {**{name: name for name in own}, **renamed}
    known = {f"--{name.replace('_', '-')}": word for name, word in mine.items()} or _KEYWORDS
    known = {**known, "-o": "output"}
    try:
        yield
    except GfUsdError as error:
        in_python(error, known)
        raise


def in_python(error: GfUsdError, known: Mapping[str, str] | None = None) -> None:
    """Have an error name keywords; known : as of `in_keywords`."""
    error.message = in_keywords(error.message, known)
    error.hint = in_keywords(error.hint, known)
    error.args = (error.message,)


def in_keywords(text: str, known: Mapping[str, str] | None = None) -> str:
    """A text with keywords instead of options of the command line; known : by their names there,
    None: those of a bake.
    """
    words = _KEYWORDS if known is None else known
    return OPTION.sub(lambda found: words.get(found[0], found[0]), text)


def _spellings() -> dict[str, str]:
    found: dict[str, str] = dict(SHORT)
    for name, option in OPTIONS.items():
        found[option.flag] = f"{name}=True" if option.kind is bool else name
        if option.two_way:
            found[f"--no-{option.flag[2:]}"] = f"{name}=False"
    return found


_KEYWORDS = _spellings()
