"""Commands and the functions of Python have the same options, with the same defaults.

What differs is listed here, each with its reason; a difference that is not listed fails.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest
import typer.main

import gf_usd
from gf_usd.cli.main import COMMANDS, program
from gf_usd.prepare.options.table import FITTED, OPTIONS

# Commands that start or serve other commands, or print what Python reads as values.
ALONE = {
    "batch": "runs commands: Python has loops",
    "serve": "runs bakes of other programs: a Python process stays warm by itself",
    "view": "opens a window",
    "verify": "runs tests of the solver",
    "inputs": "lists files for scripts of a farm",
    "schema-path": "prints a folder for a shell",
    "help": "prints texts",
    "thumbnails": "draws the pictures of a batch",
    "worker": "bakes the jobs of a batch",
}
# Functions that give arrays or take them: a command has files.
ARRAYS = {"read", "simulate"}
# Of every command: what is printed, and how much of it.
PRINTED = {"as_json", "help", "help_all", "quiet", "verbose"}
# Of functions: who is told how far it is.
LISTENERS = {"progress"}

# Other options of commands, with the reason why a function lacks them.
OF_COMMANDS: dict[str, dict[str, str]] = {
    "bake": {
        "dry_run": "gf_usd.inspect",
        "events": "progress, and the result",
        "serve": "a Python process stays warm by itself",
    },
}
# Other parameters of functions, with the reason why a command lacks them.
OF_FUNCTIONS: dict[str, dict[str, str]] = {
    "inspect": dict.fromkeys(
        (
            "output",
            "overwrite",
            "export_ply",
            "export_spz",
            "resume",
            "slice",
            "until",
            "strict",
            "max_hours",
        ),
        "concerns files that inspect does not write: Python takes the keywords of bake",
    ),
    "preview": {
        "frames": "former name of time_codes",
        "range": "former name of color_range",
    },
}
# Keywords of Python, by the names of the command line.
RENAMED = {("deliver", "as"): "kind", ("fit", "target"): "targets"}
# Defaults that differ: (of the command, of the function), and why.
DEFAULTS: dict[tuple[str, str], tuple[Any, Any, str]] = {
    ("compare", "output"): (None, (), "a list of none"),
    ("deliver", "error"): ("0.5%", 0.005, "the same"),
    ("fit", "bounds"): (None, None, "none"),
    ("fit", "targets"): (None, inspect.Parameter.empty, "the command says what is missing"),
    ("fit", "unknowns"): (None, (), "a list of none"),
    ("preview", "color"): ("none", None, "the same"),
}


def of_command(name: str) -> dict[str, Any]:
    """The options of a command with their defaults, called as in Python."""
    rows = {row.flag: row.name for row in OPTIONS.values()}
    command: Any = typer.main.get_command(program([name, "help"]))
    found = {}
    for param in command.commands[name].params:
        if param.param_type_name == "argument":
            continue
        flag = next(flag for flag in param.opts if flag.startswith("--"))
        word = rows.get(flag) if param.name in OPTIONS else None
        word = word or (param.name if param.name in PRINTED else flag[2:].replace("-", "_"))
        default = inspect.Parameter.empty if param.required else param.default
        found[RENAMED.get((name, word), word)] = default
    return found


def of_function(name: str) -> dict[str, Any]:
    """The keywords of a function with their defaults."""
    parameters = inspect.signature(getattr(gf_usd, name)).parameters.values()
    given = [p for p in parameters if p.name not in ("path", "other")]
    found = {p.name: p.default for p in given if p.kind != p.VAR_KEYWORD}
    if name == "fit":
        found |= {option: OPTIONS[option].default for option in FITTED}
    return found


BOTH = [name for name in COMMANDS if name not in ALONE]


def test_every_command_and_function_has_a_place() -> None:
    functions = {name for name in gf_usd.__all__ if inspect.isfunction(getattr(gf_usd, name))}
    assert {*BOTH} == functions - ARRAYS
    assert {*ALONE} < {*COMMANDS}


@pytest.mark.parametrize("name", BOTH)
def test_a_command_has_the_options_of_its_function(name: str) -> None:
    command, function = of_command(name), of_function(name)
    only_command = command.keys() - function.keys() - PRINTED
    only_function = function.keys() - command.keys() - LISTENERS
    assert only_command == OF_COMMANDS.get(name, {}).keys()
    assert only_function == OF_FUNCTIONS.get(name, {}).keys()


@pytest.mark.parametrize("name", BOTH)
def test_their_defaults_are_the_same(name: str) -> None:
    command, function = of_command(name), of_function(name)
    for option in command.keys() & function.keys():
        mine, theirs = command[option], function[option]
        if (name, option) in DEFAULTS:
            assert (mine, theirs) == DEFAULTS[name, option][:2]
        else:
            assert mine == theirs or (mine in (None, [], ()) and theirs in (None, ())), option


def test_an_inspection_takes_what_decides_a_bake(gf_usd: Callable[..., Any], block: Any) -> None:
    done = gf_usd(
        "inspect", block, "--particles", "100", "--floor", "none", "--gravity", "1.6",
        "--frames", "4", "--friction", "0.2", "--json",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert '"first_contact_frame": null' in done.out


def test_keywords_that_concern_the_files_have_no_effect_on_an_inspection(block: Any) -> None:
    given = {"until": "2%", "strict": True, "overwrite": True, "export_ply": "plies"}
    seen = gf_usd.inspect(block, particles=100, **given)
    assert seen.refusal is None
    assert seen.plan is not None
    assert seen.plan.outputs == gf_usd.inspect(block, particles=100).plan.outputs  # type: ignore[union-attr]


def test_the_options_of_a_folder_hold_for_an_inspection(
    gf_usd: Callable[..., Any], here: Any, block: Any
) -> None:
    (here / "gf-usd.toml").write_text('[bake]\nparticles = 100\nfloor = "none"\noverwrite = true\n')
    done = gf_usd("inspect", block, "--json")
    assert done.status == 0, done.err
    assert '"first_contact_frame": null' in done.out
