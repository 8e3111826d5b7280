"""Options that were renamed, so that an option has the same meaning in every command.

The old name works until 1.0, and a note gives the new one.
"""

from __future__ import annotations

from collections.abc import Sequence

import typer

# (command, former spelling) to the present one
RENAMED = {
    ("batch", "--out"): "--output",
    ("batch", "--only"): "--select",  # of `bake`: the shapes that are written
    ("preview", "--frames"): "--time-codes",  # of `bake`: how many frames
    ("preview", "--range"): "--color-range",  # of `bake`: the time codes that are written
    ("preview", "--colour"): "--color",
    ("report", "--look"): "--variant",
    ("view", "--look"): "--variant",
}
QUIET = {"-q", "--quiet"}


def present(command: str, arguments: Sequence[str]) -> list[str]:
    """The arguments of a command with the present spelling of each option.

    Prints a note on stderr for each that has another now, unless --quiet is among them.
    """
    end = arguments.index("--") if "--" in arguments else len(arguments)
    quiet = bool(QUIET & {*arguments[:end]})
    out: list[str] = []
    for argument in arguments[:end]:
        flag, sign, value = argument.partition("=")
        now = RENAMED.get((command, flag))
        if now is not None and not quiet:
            typer.echo(f"note: {flag} is now called {now}; the old name works until 1.0", err=True)
        out.append(argument if now is None else f"{now}{sign}{value}")
    return [*out, *arguments[end:]]
