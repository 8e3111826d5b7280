"""Errors of the command-line parser, in the form of all errors: the fault and a hint."""

from __future__ import annotations

import re
from typing import Any

import typer

from gf_usd.core.errors import did_you_mean, meant

# The base class of the parser's errors, of a value or of a command line.
WrongUsage: Any = typer.BadParameter.__mro__[1]
KINDS = {"int": "whole number", "float": "number"}
OUTSIDE = re.compile(r"is not in the range x>=(\S+)$")
WITHOUT = re.compile(r"(requires (?:an|\d+) arguments?|does not take a value)$")
# Words after the last argument: often the rest of a path with spaces.
EXTRA = re.compile(r"unexpected extra arguments?(?:\(s\))? \((.*)\)$")


def usage_message(error: Any, command: str = "gf-usd") -> str:
    """A fault of usage with its hint; without an argument the help of the command is all.

    command : that was called, where the parser's error does not contain it.
    """
    context = error.ctx
    command = context.command_path if context is not None else command
    parameter = getattr(error, "param", None)
    option = getattr(error, "option_name", None)
    message = error.format_message().rstrip(".")
    if option is not None and type(error).__name__ == "NoSuchOption":
        close = _of_bake(option, context) or _nearest(option, context)
        message = f"{command} has no option {option}"
        return f"{message}\n\nhint: {close}{command} --help lists its options"
    if parameter is not None and type(error).__name__ == "MissingParameter":
        wanted = _word(parameter)
        needed = [p for p in context.command.params if p.required] if context else [parameter]
        line = " ".join((command, *map(_word, needed)))
        return f"{command} needs {wanted}\n\nhint: give {line}; {command} --help"
    if parameter is not None:
        is_option = parameter.param_type_name == "option"
        name = _longest(parameter) if is_option else parameter.name
        hint = parameter.help or f"{command} --help"
        for kind, noun in KINDS.items():
            if (wrong := f"is not a valid {kind}") in message:
                message = message.replace(wrong, f"is not a {noun}")
                hint = f"give a {noun}. {hint}"
        reason = message.partition(": ")[2] or message
        if (outside := OUTSIDE.search(reason)) is not None:
            hint = f"give a number of {outside[1]} or more. {hint}"
        if "is not readable" in reason:
            hint = "change the permissions of the file"
        return f"{name}: {reason}\n\nhint: {hint}"
    if option is not None and (kind := WITHOUT.search(message)) is not None:
        needs = "takes no value" if kind[1] == "does not take a value" else "needs a value"
        return f"{option} {needs}\n\nhint: {command} --help shows its form"
    if (extra := EXTRA.search(message)) is not None:
        return f"{command} does not take {extra[1]} as well\n\nhint: {_fewer(context)}"
    message, _, one = message.partition(" Did you mean ")
    guess = meant([one.strip(chr(39) + "?")] if one else [])
    message = f"{message[:1].lower()}{message[1:].rstrip('.')}"
    return f"{message}\n\nhint: {guess}see {command} --help"


def _word(parameter: Any) -> str:
    """An argument, or an option with its value, as the help shows them."""
    if parameter.param_type_name == "argument":
        return (parameter.metavar or parameter.name).upper()
    return f"{_longest(parameter)} {parameter.metavar or parameter.name.upper()}"


def _longest(option: Any) -> str:
    """The flag of an option, rather than its letter."""
    return max(option.opts, key=len)


def _fewer(context: Any) -> str:
    """What to do about words that are no arguments of a command."""
    command = context.command_path
    several = "gf-usd batch bakes several assets; " if context.command.name == "bake" else ""
    return f"quote a path that contains spaces; {several}{command} --help"


def _of_bake(option: str, context: Any) -> str:
    """What to do about an option of bake in a batch or an inspection; "" for any other."""
    if context.command.name == "inspect" and option in _flags_of_bake():
        return "leave it out: inspect writes no results; "
    if context.command.name != "batch":
        return ""
    if option == "--resume":
        return "leave it out: a batch continues by itself; "
    from gf_usd.batch.manifest import KNOWN

    row = next((row for row in KNOWN.values() if row.flag == option), None)
    if row is None:
        return ""
    return f"give it to every job: --set {row.name}={'true' if row.kind is bool else 'VALUE'}; "


def _flags_of_bake() -> set[str]:
    from gf_usd.prepare.options.table import OPTIONS

    return {flag for row in OPTIONS.values() for flag in (row.flag, row.short)}


def _nearest(option: str, context: Any) -> str:
    known = [flag for p in context.command.params for flag in (*p.opts, *p.secondary_opts)]
    return did_you_mean(option, known)
