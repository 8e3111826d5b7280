"""Options that may stand without a value."""

from __future__ import annotations

import pytest

from gf_usd.cli.help import with_bare_values

KNOWN = {"--loop", "--flesh"}


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("--loop", "--loop auto"),
        ("--loop 4 hero.usda", "--loop 4 hero.usda"),
        ("--loop auto hero.usda", "--loop auto hero.usda"),
        ("--loop hero.usda", "--loop auto hero.usda"),
        ("--loop --flesh hero.usda", "--loop auto --flesh hero.usda"),
        ("--loop=3 hero.usda", "--loop=3 hero.usda"),
        ("--flesh -- --loop", "--flesh -- --loop"),
    ],
)
def test_a_number_belongs_to_the_option_and_a_file_does_not(written: str, read: str) -> None:
    assert " ".join(with_bare_values(written.split(), KNOWN)) == read


def test_a_command_without_the_option_is_left_alone() -> None:
    assert with_bare_values(["--loop"], set()) == ["--loop"]
