"""The value ``default`` of an option of a bake: it removes what a gf-usd.toml or an earlier
occurrence of the option has set.
"""

from __future__ import annotations

from collections.abc import Sequence

from gf_usd.prepare.options.option import DEFAULT
from gf_usd.prepare.options.table import options_of

COMMANDS = ("bake", "inspect", "fit")


def without_reset_options(command: str, arguments: Sequence[str]) -> tuple[list[str], set[str]]:
    """The arguments of a command without each option whose value is ``default``, and the names of
    these options.

    What is set later on the command line counts again.
    """
    if command not in COMMANDS:
        return list(arguments), set()
    rows = [row for row in options_of(command) if row.takes_default]
    named = {spelling: row for row in rows for spelling in (row.flag, row.short) if spelling}
    kept: list[tuple[str, list[str]]] = []  # the option, or "", and its arguments
    reset: set[str] = set()
    left = list(arguments)
    while left:
        argument = left.pop(0)
        if argument == "--":
            kept.append(("", [argument, *left]))
            break
        flag, sign, value = argument.partition("=")
        row = named.get(argument[:2])
        if row is not None and row.short == argument[:2] and not (row.kind is bool or row.bare):
            flag, sign, value = argument[:2], argument[2:], argument[2:]  # as in -mrubber
        row = named.get(flag)
        if row is None:
            kept.append(("", [argument]))
            continue
        given = [argument]
        if not sign and left and (left[0] == DEFAULT or not (row.kind is bool or row.bare)):
            value = left.pop(0)
            given.append(value)
        if value == DEFAULT:
            reset.add(row.name)
            kept = [(name, words) for name, words in kept if name != row.name]
        else:
            kept.append((row.name, given))
    return [word for _, words in kept for word in words], reset
