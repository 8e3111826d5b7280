"""Makes the options of the command line from the table of options."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from gf_usd.cli.help import metavar
from gf_usd.prepare.options.option import Option
from gf_usd.prepare.options.table import OPTIONS, PLANNED, options_of


def _completion(option: Option) -> Callable[[str], list[str]] | None:
    """The completions of the value of an option in a shell."""
    choices = option.choices
    if option.name == "only":
        choices = ("mesh", "gaussians", "points")
    if option.name == "material":
        # loads NumPy, which a command that is not being completed does not need here
        return _presets
    return (
        (lambda incomplete: [w for w in choices if w.startswith(incomplete)]) if choices else None
    )


def _presets(incomplete: str) -> list[str]:
    from gf_usd.core.materials.presets import presets

    return [name for name in ("auto", *presets()) if name.startswith(incomplete)]


def _spoken(option: Option) -> Any:
    """The arguments of an option for typer."""
    flag = option.flag
    if option.two_way:
        flag = f"{flag}/--no-{flag[2:]}"
    # `Request.check` refuses its numbers itself, with the same message from Python
    low = None if option.name in PLANNED else option.low
    return typer.Option(
        *((flag, option.short) if option.short else (flag,)),
        help=option.help,
        show_default=option.shown or True,
        metavar=metavar(option.name, option.kind, option.choices),
        autocompletion=_completion(option),
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
    parameters = [_parameter(o) for o in options_of(command)]
    function.__signature__ = own.replace(  # type: ignore[attr-defined]
        parameters=[asset, *parameters, *others]
    )
    return function


LimitsOf = Annotated[str | None, _spoken(OPTIONS["limits"])]
