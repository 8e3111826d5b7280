"""Options of the command line out of the table of options."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from gf_usd.prepare.options.option import Option
from gf_usd.prepare.options.table import OPTIONS, PLANNED


def _spoken(option: Option) -> Any:
    """What typer is told of an option."""
    flag = option.flag
    if option.two_way:
        flag = f"{flag}/--no-{flag[2:]}"
    # `Request.check` refuses its numbers itself, in the same words from Python
    low = None if option.name in PLANNED else option.low
    return typer.Option(
        *((flag, option.short) if option.short else (flag,)),
        help=option.help,
        show_default=option.shown or True,
        min=low,
    )


def _parameter(option: Option) -> inspect.Parameter:
    kind: Any = list[option.kind] if option.repeated else option.kind | None
    return inspect.Parameter(
        option.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=list(option.default) if option.repeated else option.default,
        annotation=Annotated[kind, _spoken(option)],
    )


def signed(command: str, function: Callable[..., None]) -> Callable[..., None]:
    """The function of a command, with the options of that command in the place of ``**options``."""
    open_ended = function.__code__.co_flags & inspect.CO_VARKEYWORDS
    if not open_ended or hasattr(function, "__signature__"):  # signed before
        return function
    own = inspect.signature(function, eval_str=True)
    asset, *others = (p for p in own.parameters.values() if p.kind != p.VAR_KEYWORD)
    asked = [_parameter(o) for o in OPTIONS.values() if command in o.commands]
    function.__signature__ = own.replace(  # type: ignore[attr-defined]
        parameters=[asset, *asked, *others]
    )
    return function


LimitsOf = Annotated[str | None, _spoken(OPTIONS["limits"])]
