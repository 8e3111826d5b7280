"""One word, one meaning over all commands; former spellings work, with a note."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
import typer
from previews import FALLING_BOX

import gf_usd as gf_usd_api
from gf_usd.cli.main import COMMANDS, program
from gf_usd.cli.renamed import RENAMED, present
from gf_usd.core.errors import UsageError

# Flags whose value one command takes in another form, and why that is the same word.
FORMS = {
    "--output": {"PATH", "FOLDER"},  # a batch writes many files
    "--seed": {"N", "N,..."},  # a batch makes a job of each
    "--splats": {None, "WHICH"},  # a page shows them, or not
}
# Types of the parser, which say nothing of what to write.
TYPES = ("<", "INTEGER", "FLOAT", "TEXT", "RANGE")


def commands() -> dict[str, Any]:
    group: Any = typer.main.get_command(program([name for name in COMMANDS if name != "worker"]))
    return group.commands


def flags() -> dict[str, dict[str, Any]]:
    """By flag: what takes it, by command."""
    found: dict[str, dict[str, Any]] = defaultdict(dict)
    for name, command in commands().items():
        for param in command.params:
            for flag in (*param.opts, *param.secondary_opts):
                if flag.startswith("--"):
                    found[flag][name] = param
    return found


def test_a_flag_takes_the_same_value_in_every_command() -> None:
    for flag, takers in flags().items():
        forms = {None if p.is_flag else p.metavar for p in takers.values()}
        assert len(forms) == 1 or forms == FORMS.get(flag), (flag, takers.keys(), forms)


def test_values_are_named_by_what_they_are() -> None:
    for flag, takers in flags().items():
        for command, param in takers.items():
            assert param.is_flag or not param.metavar.startswith(TYPES), (command, flag)


def test_former_spellings_are_no_options_any_more() -> None:
    known = flags()
    for (command, former), now in RENAMED.items():
        assert command in known[now]
        assert command not in known.get(former, {})


def test_the_guide_lists_them() -> None:
    docs = Path(__file__).resolve().parents[2] / "docs"
    page = (docs / "guide" / "commands.md").read_text(encoding="utf-8")
    table = page.partition("| command | former name | current name |\n|---|---|---|\n")[2]
    rows = [row.split("|")[1:4] for row in table.partition("\n\n")[0].splitlines()]
    listed = {
        (command.strip(), old.strip(" `")): new.strip(" `")
        for commands_of, old, new in rows
        for command in commands_of.split(",")
    }
    assert listed == RENAMED


@pytest.mark.parametrize(("command", "former"), RENAMED)
def test_a_former_spelling_works_with_a_note(command: str, former: str, capfd) -> None:
    now = RENAMED[command, former]
    assert present(command, [former, "1", f"{former}=2", now, "3"]) == [
        now,
        "1",
        f"{now}=2",
        now,
        "3",
    ]
    note = f"note: {former} is now called {now}; the old name works until 1.0\n"
    assert capfd.readouterr().err == 2 * note
    assert present(command, [former, "1", "-q"]) == [now, "1", "-q"]
    assert capfd.readouterr().err == ""


def test_what_follows_two_dashes_is_no_option() -> None:
    assert present("batch", ["--", "--out"]) == ["--", "--out"]


def test_other_commands_keep_their_words() -> None:
    assert present("bake", ["--only", "mesh", "--frames", "3"]) == [
        "--only",
        "mesh",
        "--frames",
        "3",
    ]


def test_a_batch_by_its_former_options(gf_usd, here: Path, block: Path) -> None:
    arguments = ("batch", block, "-m", "rubber,jelly", "--frames", "rest:40", "--dry-run")
    done = gf_usd(*arguments, "--out", "out", "--only", "block.jelly")
    assert (done.status, done.out) == (
        0,
        gf_usd(*arguments, "-o", "out", "--select", "*.jelly").out,
    )
    assert "--frames rest:40" in done.out
    assert "block.rubber" not in done.out
    assert "note: --out is now called --output" in done.err


@pytest.mark.slow
def test_a_picture_by_the_former_options(gf_usd, here: Path) -> None:
    (here / "box.usda").write_text(FALLING_BOX, encoding="utf-8")
    arguments = ("preview", "box.usda", "--size", "60x40")
    old = gf_usd(*arguments, "-o", "a.gif", "--frames", "1:3", "--colour", "none")
    new = gf_usd(*arguments, "-o", "b.gif", "--time-codes", "1:3")
    assert (old.status, new.status) == (0, 0), old.err + new.err
    assert (here / "a.gif").read_bytes() == (here / "b.gif").read_bytes()
    assert "note: --colour is now called --color" in old.err


def test_a_picture_by_the_former_keywords(here: Path) -> None:
    (here / "box.usda").write_text(FALLING_BOX, encoding="utf-8")
    small = {"sheet": 2, "size": (60, 40)}
    with pytest.warns(FutureWarning, match="frames is now called time_codes"):
        old = gf_usd_api.preview("box.usda", frames=(1, 3), **small)
    new = gf_usd_api.preview("box.usda", time_codes=(1, 3), **small)
    assert old.pixels is not None
    assert new.pixels is not None
    assert (old.pixels == new.pixels).all()
    with pytest.raises(UsageError, match="color_range and range mean the same"):
        gf_usd_api.preview("box.usda", color="strain", color_range=(0, 1), range=(0, 1))


def test_help_of_a_command_by_its_name(gf_usd) -> None:
    assert gf_usd("help", "preview").out == gf_usd("preview", "--help").out
    assert gf_usd("help", "materials").out.startswith("materials: "), "a topic has priority"
    assert "gf-usd COMMAND --help" in gf_usd("help", "cook").err


def test_the_list_of_commands_has_whole_sentences(gf_usd) -> None:
    listed = gf_usd("--help").out.partition("\nCommands:\n")[2].splitlines()
    assert len(listed) == sum("hidden" not in settings for _, settings in COMMANDS.values())
    assert all(line.endswith(".") and not line.endswith("...") for line in listed)
