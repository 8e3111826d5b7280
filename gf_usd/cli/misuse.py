"""Errors of the command-line parser, in the form of all errors: the fault and a hint."""

from __future__ import annotations

import difflib
from typing import Any

import typer

# The base class of the parser's errors, of a value or of a command line.
WrongUsage: Any = typer.BadParameter.__mro__[1]
KINDS = {"int": "whole number", "float": "number"}


def usage_message(error: Any) -> str:
    """A fault of usage with its hint; without an argument the help of the command is all."""
    context = error.ctx
    command = context.command_path if context is not None else "gf-usd"
    parameter = getattr(error, "param", None)
    option = getattr(error, "option_name", None)
    message = error.format_message().rstrip(".")
    if option is not None and getattr(error, "possibilities", None) is not None:
        close = _of_bake(option, context) or _nearest(option, context)
        message = f"{command} has no option {option}"
        return f"{message}\n\nhint: {close}{command} --help lists its options"
    if parameter is not None and type(error).__name__ == "MissingParameter":
        wanted = (parameter.metavar or parameter.name).upper()
        return f"{command} needs {wanted}\n\nhint: give {command} {wanted}; {command} --help"
    if parameter is not None:
        name = parameter.opts[-1] if parameter.param_type_name == "option" else parameter.name
        hint = parameter.help or f"{command} --help"
        for kind, noun in KINDS.items():
            if (wrong := f"is not a valid {kind}") in message:
                message = message.replace(wrong, f"is not a {noun}")
                hint = f"give a {noun}. {hint}"
        reason = message.partition(": ")[2] or message
        if "is not readable" in reason:
            hint = "change the permissions of the file"
        return f"{name}: {reason}\n\nhint: {hint}"
    message, _, meant = message.partition(" Did you mean ")
    meant = f"did you mean {meant.strip(chr(39) + '?')}? " if meant else ""
    message = f"{message[:1].lower()}{message[1:].rstrip('.')}"
    return f"{message}\n\nhint: {meant}see {command} --help"


def _of_bake(option: str, context: Any) -> str:
    """How a batch takes an option of bake; "" for another command or option."""
    if context.command.name != "batch":
        return ""
    if option == "--resume":
        return "leave it out: a batch continues by itself; "
    from gf_usd.batch.manifest import KNOWN

    row = next((row for row in KNOWN.values() if row.flag == option), None)
    if row is None:
        return ""
    return f"give it to every job: --set {row.name}={'true' if row.kind is bool else 'VALUE'}; "


def _nearest(option: str, context: Any) -> str:
    known = [flag for p in context.command.params for flag in (*p.opts, *p.secondary_opts)]
    close = difflib.get_close_matches(option, known, n=1)
    return f"did you mean {close[0]}? " if close else ""
