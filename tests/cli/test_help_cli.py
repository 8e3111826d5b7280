"""Help: groups, expert options on request, topics; and the options of a folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gf_usd.cli.help import EXAMPLES, EXPERT, GROUP_OF, GROUPS, METAVARS
from gf_usd.cli.topics import TOPICS
from gf_usd.prepare.options.table import OPTIONS


def test_help_is_in_groups_with_examples_first(gf_usd) -> None:
    text = gf_usd("bake", "--help").out
    at = [text.index(f"\n{group}:\n") for group in ("Examples", *GROUPS)]
    assert at == sorted(at)
    assert "--procrustes X" not in text
    assert "--procrustes" in text[text.index(EXPERT) :]
    assert len(EXAMPLES["bake"]) == 5
    assert "--device cpu|cuda" in text
    assert "<str>" not in text
    assert "<int>" not in text
    assert "<float>" not in text


def test_all_of_it_explains_every_option(gf_usd) -> None:
    text = gf_usd("bake", "--help-all").out
    for option in OPTIONS.values():
        if "bake" in option.commands:
            assert option.flag in text
    assert "--procrustes X" in text


def test_groups_name_options_that_exist() -> None:
    own = {"asset", "dry_run", "quiet", "verbose", "as_json", "help", "help_all"}
    assert set(GROUP_OF) <= {*OPTIONS} | own
    assert set(METAVARS) <= {*OPTIONS}
    assert sum(map(len, GROUPS.values())) == len(GROUP_OF), "each stands in one group"


@pytest.mark.parametrize("name", TOPICS)
def test_topics(gf_usd, name: str) -> None:
    done = gf_usd("help", name)
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith(f"{name}: {TOPICS[name][0]}\n")


def test_without_a_topic_they_are_listed(gf_usd) -> None:
    done = gf_usd("help")
    assert done.status == 0
    assert all(f"  {name} " in done.out for name in TOPICS)


def test_the_options_of_a_folder_hold_below_it(
    gf_usd, here: Path, block: Path, monkeypatch
) -> None:
    file = here / "gf-usd.toml"
    file.write_text('[bake]\nmaterial = "jelly"\nparticles = 200\ndrop = 2.5\nframes = 3\n')
    below = here / "shots"
    below.mkdir()
    monkeypatch.chdir(below)
    done = gf_usd("bake", block, "--frames", "4", "--dry-run", "--json")
    assert done.status == 0, done.err
    assert done.err.startswith(f"note: {file}: material = 'jelly', particles = 200, drop = '2.5'")
    report = json.loads(done.out)
    assert report["frames"] == 4, "the command line has priority"
    assert list(report["substeps_per_frame"]) == ["jelly"]
    assert report["outputs"][0] == "block.jelly.usda"


def test_the_command_line_takes_back_an_option_of_a_folder(gf_usd, here: Path, block: Path) -> None:
    (here / "gf-usd.toml").write_text(
        '[bake]\nmaterial = "jelly"\nfloor = "none"\nfriction = 0.9\ncombine = true\n'
        'pins = ["box:0,0,0,1,1,1"]\nframes = 3\n'
    )
    taken_back = (
        "-mdefault", "--floor", "default", "--friction=default", "--combine", "default",
        "--pin", "default",
    )  # fmt: skip
    for command in ("bake", "inspect"):
        given = ("--dry-run",) if command == "bake" else ()
        plain = gf_usd(command, block, "--particles", "100", "--json", *given, *taken_back)
        assert plain.status == 0, plain.err
        (here / "gf-usd.toml").rename(here / "other.toml")
        wanted = gf_usd(command, block, "--particles", "100", "--frames", "3", "--json", *given)
        (here / "other.toml").rename(here / "gf-usd.toml")
        assert json.loads(plain.out) == json.loads(wanted.out)


@pytest.mark.slow
def test_what_follows_the_default_counts_and_what_was_before_does_not(gf_usd, block: Path) -> None:
    def frames(*arguments: str) -> int:
        done = gf_usd("bake", block, "--particles", "100", "--dry-run", "--json", *arguments)
        assert done.status == 0, done.err
        return json.loads(done.out)["frames"]

    given = frames()
    assert frames("--frames", "4", "--frames", "default") == given != 4
    assert frames("-m", "default") == frames("-m", "clay", "-mdefault") == given
    assert frames("--frames", "default", "--frames", "4") == 4
    # an output may have this name
    done = gf_usd("bake", block, "--dry-run", "--json", "-o", "default.usda", "--frames", "4")
    assert json.loads(done.out)["outputs"][0] == "default.usda"
    done = gf_usd("bake", block, "--dry-run", "--json", "-o", "default", "--frames", "4")
    assert "default" in done.out + done.err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[bake]\npartikles = 4\n", "partikles is not an option of gf-usd bake"),
        ("[bake]\npin = '/A'\n", "hint: did you mean pins? "),
        ("[bkae]\n", "bkae is not a table of this file"),
        ("bake = 3\n", "bake is 3"),
        ("[bake]\nframes = 'ten'\n", "frames"),
        ("[bake]\nframes = 0\n", "--frames is 0"),
        ("[bake\n", "cannot be read"),
    ],
)
def test_a_wrong_file_is_refused(gf_usd, here: Path, block: Path, text: str, message: str) -> None:
    (here / "gf-usd.toml").write_text(text)
    done = gf_usd("bake", block, "--dry-run")
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith(f"error: {here / 'gf-usd.toml'}: ") or message == "cannot be read"
    assert message in done.err
    assert "\n\nhint: " in done.err


def test_bakes_that_a_program_follows_do_not_read_it(gf_usd, here: Path, block: Path) -> None:
    (here / "gf-usd.toml").write_text("[bake]\npartikles = 4\n")
    done = gf_usd("bake", block, "--dry-run", "--particles", "100", "--events", "-")
    assert done.status == 0, done.err


def test_a_shell_completes_the_values_of_a_choice(gf_usd, monkeypatch) -> None:
    monkeypatch.setenv("_GF_USD_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "gf-usd bake x.usda --device c")
    monkeypatch.setenv("COMP_CWORD", "4")
    assert gf_usd().out.split() == ["cpu", "cuda"]


def test_an_empty_file_takes_back_the_options_of_a_folder_above(
    gf_usd, here: Path, block: Path, monkeypatch
) -> None:
    (here / "gf-usd.toml").write_text("[bake]\nparticles = 200\n")
    below = here / "shots"
    below.mkdir()
    (below / "gf-usd.toml").touch()
    monkeypatch.chdir(below)
    done = gf_usd("bake", block, "--dry-run", "--json", "--particles", "100")
    assert done.status == 0, done.err
    assert done.err.startswith(f"note: {below / 'gf-usd.toml'}: no options")
